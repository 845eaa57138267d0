"""The fisheye model of Kannala and Brandt: the radius is a polynomial in the angle theta off the optical axis.

    r = theta (1 + k1 theta² + k2 theta⁴ + k3 theta⁶ + k4 theta⁸),   (m, n) = (r/rho) (x, y),   rho = hypot(x, y),
    u = f m + s n + cx,    v = f aspect n + cy,

with theta = atan2(rho, z): OpenCV's `fisheye`, which stops at 90°; here theta may be larger. With all k = 0 it is the
equidistant lens. The inverse, theta of a radius, is computed by Newton's method within the domain.

Domain: up to the first angle at which r stops growing; short of 180°, where all azimuths are one direction.

Source: J. Kannala and S. S. Brandt, A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses, PAMI 2006, with the radial part alone.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from harness.camera._pixel_kernels import from_pixel, moved_pixel, to_pixel
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models.axial import AxialModel, Domain
from harness.compiled import kernel

OfAngle = Annotated[float, Field(ge=-1000, le=1000)]
"""Far beyond any lens, and small enough for the polynomial to stay finite."""


class KannalaBrandt(AxialModel):
    """The fisheye model of Kannala and Brandt: OpenCV's fisheye, Kalibr's equidistant distortion."""

    title: ClassVar[str] = "Kannala-Brandt fisheye"

    kind: Literal["kannala_brandt"] = "kannala_brandt"
    """The fisheye model of Kannala and Brandt."""
    k1: OfAngle = 0.0
    """Coefficient of theta³, no unit; all four 0 for the equidistant lens."""
    k2: OfAngle = 0.0
    """Coefficient of theta⁵, no unit."""
    k3: OfAngle = 0.0
    """Coefficient of theta⁷, no unit."""
    k4: OfAngle = 0.0
    """Coefficient of theta⁹, no unit."""

    def radius(self, angle_rad: float, lens: Lens) -> float:  # noqa: ARG002
        """|(m, n)|, in focal lengths."""
        t = angle_rad * angle_rad
        return angle_rad * (1 + t * (self.k1 + t * (self.k2 + t * (self.k3 + t * self.k4))))

    @property
    def _last(self) -> float:
        """The angle, in radians, at which the radius stops growing; pi where it does not."""
        # In 1/theta² the polynomial is monic, so that tiny coefficients do no harm.
        roots = np.roots([1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3, 9 * self.k4])
        real = roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots.real))) & (roots.real > 0)]
        return min(math.pi, 1 / math.sqrt(real.max())) if real.size else math.pi

    def domain(self, camera: Camera, lens: Lens) -> Domain:  # noqa: ARG002
        """The limit at which the polynomial stops growing."""
        last = self._last
        why = "r(theta) stops growing" if last < math.pi else "all azimuths are one direction"
        return Domain(last, self.radius(last, lens), why)

    def parameters(self, camera: Camera, lens: Lens) -> "KannalaBrandtCamera":
        """The model's parameters as the compiled functions take them."""
        return KannalaBrandtCamera(
            **camera.matrix,
            k1=self.k1,
            k2=self.k2,
            k3=self.k3,
            k4=self.k4,
            last=self._last,
            rim=self.radius(self._last, lens),
        )


class KannalaBrandtCamera(NamedTuple):
    """Model and camera as numbers: focal lengths, skew and centre in pixels."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    k1: float
    k2: float
    k3: float
    k4: float
    last: float
    """Largest angle off the axis, radians."""
    rim: float
    """The radius there, in focal lengths."""


@kernel
def _radius(theta, camera):
    """r(theta), and its derivative."""
    k1, k2, k3, k4 = camera.k1, camera.k2, camera.k3, camera.k4
    t = theta * theta
    return (
        theta * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4)))),
        1.0 + t * (3.0 * k1 + t * (5.0 * k2 + t * (7.0 * k3 + t * 9.0 * k4))),
    )


@kernel
def _project(x, y, z, camera):
    rho = math.sqrt(x * x + y * y)
    theta = math.atan2(rho, z)
    r, _ = _radius(theta, camera)
    scale = r / rho if rho > 0.0 else 1.0 / z
    m, n = scale * x, scale * y
    inside = theta <= camera.last and (rho > 0.0 or z > 0.0)
    u, v = to_pixel(m, n, camera)
    return u, v, inside


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    rho = math.sqrt(x * x + y * y)
    if rho > 0.0:
        r, slope = _radius(math.atan2(rho, z), camera)
        rho_d = (x * dx + y * dy) / rho
        scale = r / rho
        scale_d = (slope * (z * rho_d - rho * dz) / (rho * rho + z * z) - scale * rho_d) / rho
    else:
        scale, scale_d = 1.0 / z, 0.0
    m, n = scale * x, scale * y
    m_d, n_d = scale * dx + scale_d * x, scale * dy + scale_d * y
    return moved_pixel(m, n, m_d, n_d, camera)


@kernel
def _angle(r, camera):
    """The angle whose radius is r; NaN beyond the domain.

    Newton's method, safeguarded by bisection bounds: r(theta) grows throughout, so the solution is unique.
    """
    if not r <= camera.rim:
        return math.nan
    least, most = 0.0, camera.last
    theta = min(r, 0.5 * most)
    for _ in range(100):
        radius, slope = _radius(theta, camera)
        if radius < r:
            least = theta
        else:
            most = theta
        theta_next = theta - (radius - r) / slope
        if not least <= theta_next <= most:
            theta_next = 0.5 * (least + most)
        step, theta = abs(theta_next - theta), theta_next
        if step <= 1e-12 * theta:  # and the error after it is of the order of its square
            break
    return theta


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    for i in range(u.size):
        m, n = from_pixel(u[i], v[i], camera)
        r = math.sqrt(m * m + n * n)
        theta = _angle(r, camera)
        scale = math.sin(theta) / r if r > 0.0 else 1.0
        x_out[i] = scale * m
        y_out[i] = scale * n
        z_out[i] = math.cos(theta)


add_compiled_model(KannalaBrandtCamera, CompiledModel(_project, _move, _rays))
