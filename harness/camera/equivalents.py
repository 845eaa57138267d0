"""Exact conversions between camera models: the same camera in other parameters.

- A hyperboloid mirror is the unified model with 0 < xi < 1 (see `harness.camera.conversions`); its lens is rescaled.
- The unified model without a lens is EUCM with beta = 1 and the double sphere with xi = 0: dividing by 1 + xi,
  `(x, y)/(z + xi d) = (x, y)/(alpha d + (1 - alpha) z)/(1 + xi)` with `alpha = xi/(1 + xi)`. A double sphere with
  alpha = 0 is the unified model of its own xi.
- At xi = 1 it is a paraboloid, `rho = gamma tan(theta/2)`, whose ray is `(x, y, (gamma² - rho²)/(2 gamma))`:
  OCamCalib's polynomial with `a_0 = -gamma/2`, `a_2 = 1/(2 gamma)`.
"""

import math
from typing import Any

from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import MODELS, Mirror
from harness.camera.optics import Optics

_SIZE_M = Mirror().a_m
"""Semi-axis of a mirror, metres, which images do not determine."""


def equivalent(optics: Optics, kind: str) -> Optics | None:
    """The same camera in another model; None where that has no exact equivalent."""
    if _kind(optics) == kind:
        return optics
    unified = _to_unified(optics)
    if unified is None or kind == "unified":
        return unified
    xi: float = getattr(unified.model, "xi")  # noqa: B009 - any class of settings with this key
    scaled = _scaled(unified.camera, 1 / (1 + xi))
    if kind == "hyperboloid" and 0 < xi < 1:
        return _mirror(unified, xi)
    if not unified.lens.is_pinhole:
        return None
    if kind == "eucm":
        return _optics(kind, scaled, alpha=xi / (1 + xi), beta=1.0)
    if kind == "double_sphere":
        return _optics(kind, scaled, xi=0.0, alpha=xi / (1 + xi))
    if kind == "ocam" and xi == 1:
        return _paraboloid(unified.camera)
    return None


def _kind(optics: Optics) -> str:
    return str(getattr(optics.model, "kind", ""))


def _optics(kind: str, camera: Camera, lens: Lens | None = None, **keys: Any) -> Optics:
    return Optics(MODELS[kind].model_validate({"kind": kind} | keys), camera, lens or Lens())


def _scaled(camera: Camera, scale: float) -> Camera:
    return camera.model_copy(update={"focal_px": camera.focal_px * scale, "skew_px": camera.skew_px * scale})


def _to_unified(optics: Optics) -> Optics | None:
    kind, model, camera = _kind(optics), optics.model, optics.camera
    if kind == "unified":
        return optics
    if isinstance(model, Mirror):
        eps = model.e_m / model.a_m
        s = (eps * eps + 1) / (eps * eps - 1)
        return _optics("unified", _scaled(camera, 1 / s), _rescaled(optics.lens, 1 / s), xi=2 * eps / (1 + eps * eps))
    keys = model.model_dump()
    if kind == "eucm" and keys["beta"] == 1 and keys["alpha"] < 1:
        return _unified_of(keys["alpha"], camera)
    if kind == "double_sphere" and keys["xi"] == 0 and keys["alpha"] < 1:
        return _unified_of(keys["alpha"], camera)
    if kind == "double_sphere" and keys["alpha"] == 0 and keys["xi"] >= 0:
        return _optics("unified", camera, xi=keys["xi"])
    return None


def _unified_of(alpha: float, camera: Camera) -> Optics:
    return _optics("unified", _scaled(camera, 1 / (1 - alpha)), xi=alpha / (1 - alpha))


def _mirror(unified: Optics, xi: float) -> Optics:
    eps = (1 + math.sqrt(1 - xi * xi)) / xi
    s = (eps * eps + 1) / (eps * eps - 1)
    mirror = Mirror(a_m=_SIZE_M, b_m=_SIZE_M * math.sqrt(eps * eps - 1))
    return Optics(mirror, _scaled(unified.camera, s), _rescaled(unified.lens, s))


def _rescaled(lens: Lens, s: float) -> Lens:
    """The same lens for a normalised plane that is smaller by s."""
    return Lens(k1=lens.k1 * s**2, k2=lens.k2 * s**4, p1=lens.p1 * s, p2=lens.p2 * s, k3=lens.k3 * s**6)


def _paraboloid(camera: Camera) -> Optics:
    """OCamCalib's pixels are scaled by c along rows and skewed by e: (row, column) = [c d; e 1] (x, y)."""
    gamma = camera.focal_px
    plain = Camera(width_px=camera.width_px, height_px=camera.height_px, cx_px=camera.cx_px, cy_px=camera.cy_px)
    return _optics(
        "ocam",
        plain,
        coefficients=[-gamma / 2, 0.0, 1 / (2 * gamma)],
        c=camera.aspect,
        d=0.0,
        e=camera.skew_px / gamma,
    )
