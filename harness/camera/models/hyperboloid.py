"""The hyperboloid mirror, (z + e)²/a² - r²/b² = 1 with e² = a² + b², upper sheet, viewed by a perspective camera.

The mirror's focus F0 is the origin and the effective viewpoint; the camera centre is the other focus
F1 = (0, 0, -2e) and looks up.

Projection: direction d meets the mirror at `P = lambda d`, `lambda = b²/(a |d| - e d_z)`. Its normalised coordinates
seen from F1 are `(P_x, P_y)/(P_z + 2e)`; the lens distorts them, the camera matrix maps them to pixels. The same in the
unified form, with `eps = e/a` and for |d| = 1: `(d_x, d_y)/(xi - d_z)`, `xi = 2 eps/(1 + eps²)`, focal length
`gamma = f (eps² - 1)/(1 + eps²)`; derivatives are taken of that form, which is shorter.

Domain: `a |d| > e d_z`, below the mirror's asymptote; and within the radius at which lens distortion folds back.
"""

import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from harness.camera._lens_kernels import bend, move_bent, unbend
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera, FieldEdge
from harness.camera.lens import Lens, fold_radius, least_bent_radius
from harness.camera.models.model import CameraModel
from harness.camera.mount import Looks
from harness.compiled import kernel
from harness.geometry.angles import Array
from harness.spec import Positive


class Mirror(CameraModel):
    """Semi-axes of the hyperboloid in metres.

    The paper does not state those of its mirror. The default is the mirror made for the University of Amsterdam's
    robots in the same years: a = 28.1 mm, b = 23.4 mm.
    """

    title: ClassVar[str] = "hyperboloid mirror"
    has_lens: ClassVar[bool] = True
    looks: ClassVar[Looks] = "down"
    mirrored: ClassVar[bool] = True

    kind: Literal["hyperboloid"] = "hyperboloid"
    """The camera model."""
    a_m: Positive = 0.0281
    """Semi-axis of the hyperboloid along the optical axis, metres."""
    b_m: Positive = 0.0234
    """Semi-axis of the hyperboloid across the optical axis, metres."""

    @model_validator(mode="after")
    def _hyperboloid_in_reach(self) -> "Mirror":
        if not 1e-3 < self.b_m / self.a_m < 1e3:
            raise ValueError(f"b_m / a_m is {self.b_m / self.a_m:g}, which is no usable mirror: use 0.001 to 1000")
        return self

    @property
    def e_m(self) -> float:
        """Half the distance between the foci, in metres."""
        return math.hypot(self.a_m, self.b_m)

    @property
    def asymptote_rad(self) -> float:
        """Elevation of the surface's asymptote, radians, which no point of the mirror reaches."""
        return math.asin(self.a_m / self.e_m)

    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:
        """Check that the field ends below the mirror's asymptote and before lens distortion folds back."""
        elevation_deg, asymptote_deg = edge.angle_deg - 90, math.degrees(self.asymptote_rad)
        if elevation_deg >= asymptote_deg - 0.01:
            raise ValueError(
                f"{edge.said} is beyond the mirror's asymptote, asin(a/e) = {asymptote_deg:.2f} deg; "
                f"{edge.remedy(90 + asymptote_deg - 0.01)}, or a mirror with a larger a_m / b_m"
            )
        rim, fold = rim_radius(self, elevation_deg), fold_radius(lens)
        # Some pixels more than the rim, on the image too: the corners of the outermost pixels are unprojected.
        folds = rim + 2 / camera.focal_px >= fold
        if math.isfinite(fold) and not folds:
            room = least_bent_radius(lens, fold) - least_bent_radius(lens, rim)
            folds = room * camera.focal_px * min(1.0, camera.aspect) <= 1
        if folds:
            raise ValueError(
                f"lens: the distortion folds the image over at radius {fold:.3f} of the undistorted image, "
                f"{'inside' if fold < rim else 'next to'} the mirror's rim at {rim:.3f}; use weaker coefficients or "
                "a smaller field"
            )

    def parameters(self, camera: Camera, lens: Lens) -> "HyperboloidCamera":
        """The model's parameters as the compiled functions take them."""
        eps = self.e_m / self.a_m
        scale = (eps * eps - 1) / (eps * eps + 1)
        gamma_u = camera.focal_px * scale
        # The unified model's normalised plane is larger by s: x' = x (1 + k1 r²) reads m' = m (1 + (k1/s²) |m|²).
        s = camera.focal_px / gamma_u
        return HyperboloidCamera(
            **camera.matrix,
            a=self.a_m,
            b=self.b_m,
            e=self.e_m,
            k1=lens.k1,
            k2=lens.k2,
            p1=lens.p1,
            p2=lens.p2,
            k3=lens.k3,
            fold=fold_radius(lens),
            xi=2 * eps / (1 + eps * eps),
            gamma_u=gamma_u,
            gamma_v=camera.focal_px * camera.aspect * scale,
            gamma_skew=camera.skew_px * scale,
            k1_unified=lens.k1 / s**2,
            k2_unified=lens.k2 / s**4,
            p1_unified=lens.p1 / s,
            p2_unified=lens.p2 / s,
            k3_unified=lens.k3 / s**6,
        )


def point_on_mirror(mirror: Mirror, directions: ArrayLike) -> Array:
    """The point of the mirror in each direction from F0, metres.

    `lambda d` with `lambda = b²/(a |d| - e d_z)`: the polar equation of a hyperbola about its focus, which needs no
    quadratic and no choice of a branch.

    Parameters
    ----------
    directions
        `[..., 3]`, of any length.

    Returns
    -------
    Array
        `[..., 3]`; NaN in directions above the asymptote, where there is no mirror.
    """
    d = np.asarray(directions, dtype=np.float64)
    length = np.linalg.norm(d, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = mirror.a_m * length - mirror.e_m * d[..., 2]
        scale = np.where(reach > 0, mirror.b_m**2 / reach, np.nan)
        return scale[..., None] * d


def encloses(mirror: Mirror, point_m: ArrayLike) -> bool:
    """Whether a point `[3]` in the mirror's frame, metres, is on the mirror or behind its surface."""
    x, y, z = np.asarray(point_m, dtype=np.float64).tolist()
    height = z + mirror.e_m
    return height > 0 and (height / mirror.a_m) ** 2 - (x * x + y * y) / mirror.b_m**2 >= 1


def rim_radius(mirror: Mirror, elevation_deg: float) -> float:
    """Undistorted radius of a rim at this elevation in normalised image coordinates, `r/(z + 2e)`."""
    elevation = math.radians(elevation_deg)
    x, _, z = point_on_mirror(mirror, [math.cos(elevation), 0.0, math.sin(elevation)])
    return float(x / (z + 2 * mirror.e_m))


class HyperboloidCamera(NamedTuple):
    """Mirror, lens and camera as numbers: lengths in metres, focal lengths and centre in pixels."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    a: float
    b: float
    e: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    fold: float
    """Radius at which the lens folds the image over."""
    xi: float
    gamma_u: float
    gamma_v: float
    gamma_skew: float
    k1_unified: float
    """The lens as the unified model writes it, here and below."""
    k2_unified: float
    p1_unified: float
    p2_unified: float
    k3_unified: float


@kernel
def _project(x, y, z, camera):
    a, b, e = camera.a, camera.b, camera.e
    reach = a * math.sqrt(x * x + y * y + z * z) - e * z
    if not reach > 0.0:
        return math.nan, math.nan, False
    scale = b * b / reach
    below = scale * z + 2.0 * e
    x, y = scale * x / below, scale * y / below
    inside = math.sqrt(x * x + y * y) <= camera.fold
    x, y = bend(x, y, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3)
    return x * camera.fu + camera.skew * y + camera.cu, y * camera.fv + camera.cv, inside


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    xi = camera.xi
    norm = math.sqrt(x * x + y * y + z * z)
    below = xi * norm - z
    scale = 1.0 / below
    m, n = scale * x, scale * y
    below_d = xi * (x * dx + y * dy + z * dz) / norm - dz
    m_d, n_d = scale * (dx - m * below_d), scale * (dy - n * below_d)
    m, n, m_d, n_d = move_bent(
        m, n, m_d, n_d,
        camera.k1_unified, camera.k2_unified, camera.p1_unified, camera.p2_unified, camera.k3_unified,
    )  # fmt: skip
    gamma_u, gamma_v, skew = camera.gamma_u, camera.gamma_v, camera.gamma_skew
    return (
        gamma_u * m + skew * n + camera.cu,
        gamma_v * n + camera.cv,
        gamma_u * m_d + skew * n_d,
        gamma_v * n_d,
    )


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    """A camera ray q = (x, y, 1) from F1 meets the mirror at F1 + s q with s = b²/(e - a |q|). Seen from F0 that is the
    direction (s x, s y, s - 2e). Dividing by s > 0 leaves (x, y, 1 - 2e²/b² + (2 a e/b²) |q|), in which large
    numbers cancel when b is small beside a. With |q| = 1 + r²/(1 + |q|) nothing cancels but at the horizon:
    (x, y, (2 a e/b²) r²/(1 + |q|) - b²/(a + e)²).
    """
    fu, fv, skew, cu, cv = camera.fu, camera.fv, camera.skew, camera.cu, camera.cv
    a, b, e = camera.a, camera.b, camera.e
    k1, k2, p1, p2, k3, fold = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.fold
    z_axis = -b * b / ((a + e) * (a + e))
    z_slope = 2.0 * a * e / (b * b)
    if k1 == 0.0 and k2 == 0.0 and k3 == 0.0 and p1 == 0.0 and p2 == 0.0:
        for i in range(u.size):
            y = (v[i] - cv) / fv
            x = (u[i] - cu - skew * y) / fu
            x_out[i] = x
            y_out[i] = y
            r2 = x * x + y * y
            z_out[i] = z_axis + z_slope * r2 / (1.0 + math.sqrt(1.0 + r2))
        return
    for i in range(u.size):
        y_d = (v[i] - cv) / fv
        x, y = unbend((u[i] - cu - skew * y_d) / fu, y_d, k1, k2, p1, p2, k3, fold)
        r2 = x * x + y * y
        x_out[i] = x
        y_out[i] = y
        z_out[i] = z_axis + z_slope * r2 / (1.0 + math.sqrt(1.0 + r2))


add_compiled_model(HyperboloidCamera, CompiledModel(_project, _move, _rays))
