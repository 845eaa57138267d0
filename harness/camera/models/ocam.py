"""Scaramuzza's model (OCamCalib): the direction of a pixel is a polynomial in its distance r from the centre.

A point (p, q) of the ideal image, in pixels down and to the right of the centre, r = hypot(p, q), has the direction (in
the frame of the other models: X right, Y down, Z along the optical axis)

    (x, y, z) ~ (q, p, Z(r)),    Z(r) = -(a_0 + a_1 r + a_2 r² + ...),    v = c p + d q + cy,    u = e p + q + cx.

OCamCalib's own frame has x down, y to the right, and z out of the camera's back, which is why its a_0 is negative; its
centre (xc, yc) is (row, column), which is (cy, cx) here. Its files also have an inverse polynomial, from directions to
radii, fitted to some hundredths of a pixel: it is not used. The radius of a direction is the solution of
`rho Z(r) = z r`, rho = hypot(x, y), computed by Newton's method to 1e-12 pixels.

Domain: up to the first radius at which the ray's angle off the axis, atan2(r, Z(r)), stops growing:
`Z(r) - r Z'(r) = 0`; and up to ten times the distance of the image's farthest corner.

Source: D. Scaramuzza, A. Martinelli and R. Siegwart, A flexible technique for accurate omnidirectional camera
calibration and structure from motion, ICVS 2006.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models.axial import AxialModel, Domain
from harness.compiled import kernel
from harness.spec import Finite

MOST_COEFFICIENTS = 12

_BEYOND_ANY_IMAGE = 1e9
_FAR = 10.0
"""Limit of the polynomial's use, as a multiple of the distance of the image's farthest corner from the centre."""


class OCam(AxialModel):
    """Scaramuzza's model, as OCamCalib writes it."""

    title: ClassVar[str] = "OCamCalib camera"
    unused: ClassVar[tuple[str, ...]] = ("focal_px", "aspect", "skew_px")

    kind: Literal["ocam"] = "ocam"
    """Scaramuzza's model (OCamCalib)."""
    coefficients: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=MOST_COEFFICIENTS)]
    """a_0, a_1, a_2, ... of the direct polynomial, from the image to the ray; a_k is in pixels to the power of 1 - k.
    a_0 is below 0, a_1 is 0."""
    c: Finite = 1.0
    """Affine part of the image, no unit: rows of the image per pixel down in the ideal one."""
    d: Finite = 0.0
    """Affine part of the image, no unit: rows of the image per pixel to the right in the ideal one."""
    e: Finite = 0.0
    """Affine part of the image, no unit: columns of the image per pixel down in the ideal one."""

    @model_validator(mode="after")
    def _as_ocamcalib_writes_it(self) -> "OCam":
        a = self.coefficients
        if not a[0] < 0:
            raise ValueError(
                f"coefficients: a_0 = {a[0]:g} must be below 0, as in OCamCalib's files; if the axis points the "
                "other way (MATLAB's fisheyeIntrinsics), negate all coefficients"
            )
        if len(a) > 1 and a[1] != 0:
            raise ValueError(
                f"coefficients: a_1 must be 0, or the projection is not smooth at the centre; found {a[1]:g}"
            )
        if not self.c - self.d * self.e > 1e-3:
            raise ValueError(f"c - d e must be above 0, about 1; found {self.c - self.d * self.e:g}")
        return self

    def unit_px(self, camera: Camera) -> float:  # noqa: ARG002
        """Least number of pixels of the image per pixel of the ideal image."""
        return float(np.linalg.svd([[1, self.e], [self.d, self.c]], compute_uv=False)[-1])

    def angle(self, radius: float) -> float:
        """The angle off the axis, radians, of the ray at this radius, in pixels of the ideal image."""
        return math.atan2(radius, -float(np.polynomial.polynomial.polyval(radius, self.coefficients)))

    def radius(self, angle_rad: float, lens: Lens) -> float:  # noqa: ARG002
        """Radius of directions at this angle off the axis, in pixels of the ideal image."""
        most = self._last
        if math.isinf(most):
            most = 1.0
            while self.angle(most) < angle_rad and most < _BEYOND_ANY_IMAGE:
                most *= 2
        from scipy.optimize import brentq

        return float(brentq(lambda radius: self.angle(radius) - angle_rad, 0.0, most, xtol=1e-12))

    @property
    def _last(self) -> float:
        """The radius at which the angle stops growing; infinite where it does not."""
        slope = [(k - 1) * each for k, each in enumerate(self.coefficients)]  # of Z - r Z'
        roots = np.roots(slope[::-1])
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots.real)) & (roots.real > 0)]
        return float(real.min()) if real.size else math.inf

    def _rim(self, camera: Camera) -> float:
        """The radius at which the domain ends."""
        across = max(camera.cx_px + 0.5, camera.width_px - 0.5 - camera.cx_px)
        down = max(camera.cy_px + 0.5, camera.height_px - 0.5 - camera.cy_px)
        return min(self._last, _FAR * math.hypot(across, down) / self.unit_px(camera))

    def domain(self, camera: Camera, lens: Lens) -> Domain:  # noqa: ARG002
        """The limit at which the ray's angle stops growing."""
        rim = self._rim(camera)
        why = "the ray's angle stops growing with r" if rim == self._last else "the radius is far off the image"
        return Domain(self.angle(rim), rim, why)

    def parameters(self, camera: Camera, lens: Lens) -> "OCamCamera":  # noqa: ARG002
        """The model's parameters as the compiled functions take them."""
        height = [-each for each in self.coefficients]
        rim = self._rim(camera)
        return OCamCamera(
            cu=camera.cx_px,
            cv=camera.cy_px,
            c=self.c,
            d=self.d,
            e=self.e,
            height=tuple(height + [0.0] * (MOST_COEFFICIENTS - len(height))),
            rim=rim,
            rim_height=-float(np.polynomial.polynomial.polyval(rim, self.coefficients)),
        )


class OCamCamera(NamedTuple):
    """Model and camera as numbers: lengths in pixels."""

    cu: float
    cv: float
    c: float
    d: float
    e: float
    height: tuple[float, ...]
    """Coefficients of Z(r), as many as there can be."""
    rim: float
    """The radius at which the domain ends."""
    rim_height: float
    """Z there."""


@kernel
def _height(r, camera):
    """Z(r), and its derivative."""
    value = slope = 0.0
    for k in range(len(camera.height) - 1, -1, -1):
        slope = slope * r + value
        value = value * r + camera.height[k]
    return value, slope


@kernel
def _radius(rho, z, camera):
    """The radius of a direction; NaN outside the domain.

    Within it rho Z(r) - z r changes its sign once, from positive to negative. Newton's method, safeguarded by bisection
    bounds around that root.
    """
    if not rho * camera.rim_height - z * camera.rim <= 0.0:
        return math.nan
    least, most = 0.0, camera.rim
    r = min(camera.height[0] * math.atan2(rho, z), 0.5 * most)
    for _ in range(100):
        height, slope = _height(r, camera)
        excess = rho * height - z * r
        if excess > 0.0:
            least = r
        else:
            most = r
        r_next = r - excess / (rho * slope - z)
        if not least <= r_next <= most:
            r_next = 0.5 * (least + most)
        step, r = abs(r_next - r), r_next
        if step <= 1e-12 * r:  # and the error after it is of the order of its square
            break
    return r


@kernel
def _project(x, y, z, camera):
    rho = math.sqrt(x * x + y * y)
    if rho > 0.0:
        scale = _radius(rho, z, camera) / rho
    elif z > 0.0:
        scale = camera.height[0] / z
    else:
        scale = math.nan
    p, q = scale * y, scale * x
    return camera.e * p + q + camera.cu, camera.c * p + camera.d * q + camera.cv, scale >= 0.0


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    rho = math.sqrt(x * x + y * y)
    if rho > 0.0:
        r = _radius(rho, z, camera)
        height, slope = _height(r, camera)
        rho_d = (x * dx + y * dy) / rho
        r_d = (r * dz - height * rho_d) / (rho * slope - z)
        scale = r / rho
        scale_d = (r_d - scale * rho_d) / rho
    else:
        scale, scale_d = camera.height[0] / z, 0.0
    p, q = scale * y, scale * x
    p_d, q_d = scale * dy + scale_d * y, scale * dx + scale_d * x
    return (
        camera.e * p + q + camera.cu,
        camera.c * p + camera.d * q + camera.cv,
        camera.e * p_d + q_d,
        camera.c * p_d + camera.d * q_d,
    )


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    cu, cv, c, d, e = camera.cu, camera.cv, camera.c, camera.d, camera.e
    determinant = c - d * e
    for i in range(u.size):
        down, right = v[i] - cv, u[i] - cu
        p = (down - d * right) / determinant
        q = (c * right - e * down) / determinant
        r = math.sqrt(p * p + q * q)
        x_out[i] = q
        y_out[i] = p
        z_out[i] = _height(r, camera)[0] if r <= camera.rim else math.nan


add_compiled_model(OCamCamera, CompiledModel(_project, _move, _rays))
