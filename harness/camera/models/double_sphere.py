"""The double sphere model: a direction is projected onto a unit sphere, from there onto a second one whose centre is
xi behind, and from there by a pinhole. With d = |(x, y, z)|, `z_2 = xi d + z` and `d_2 = sqrt(x² + y² + z_2²)`,

    (m, n) = (x, y)/(alpha d_2 + (1 - alpha) z_2),      u = f m + s n + cx,    v = f aspect n + cy.

xi = 0 is the unified model, whose xi is then alpha/(1 - alpha), with a focal length of (1 + xi) f.

Back, with r² = m² + n²: `z_2 = (1 - alpha² r²)/(alpha sqrt(1 - (2 alpha - 1) r²) + 1 - alpha)`,
`k = (xi z_2 + sqrt(z_2² + (1 - xi²) r²))/(z_2² + r²)`, direction (k m, k n, k z_2 - xi), of unit length.

Domain: on the second sphere as in the unified model, `z_2 > -w d_2`, w = alpha/(1 - alpha) for alpha <= 1/2 and
(1 - alpha)/alpha otherwise. In terms of z that is `z > -(xi (1 - w²) + w sqrt(1 - xi² (1 - w²))) d`. (The paper's w_2
differs from this unless w = 1: for a pinhole, alpha = 0, it admits directions behind the centre when xi < 0, and
excludes visible ones when xi > 0.) For xi >= 1 the first sphere is visible up to its outline only, z > -d/xi.

Source: V. Usenko, N. Demmel and D. Cremers, The double sphere camera model, 3DV 2018.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from harness.camera._pixel_kernels import from_pixel, moved_pixel, to_pixel
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models.axial import AxialModel, Domain
from harness.camera.models.eucm import lowest_of
from harness.compiled import kernel


class DoubleSphere(AxialModel):
    """The double sphere camera model."""

    title: ClassVar[str] = "double sphere camera"

    kind: Literal["double_sphere"] = "double_sphere"
    """The double sphere model."""
    xi: Annotated[float, Field(gt=-1, le=100)]
    """Distance between the spheres' centres, no unit; for fisheyes about -0.3 .. 0.3."""
    alpha: Annotated[float, Field(ge=0, le=1)]
    """Position of the pinhole, no unit: alpha/(1 - alpha) behind the centre of the second sphere."""

    def radius(self, angle_rad: float, lens: Lens) -> float:  # noqa: ARG002
        """|(m, n)|, in focal lengths."""
        sine, z_2 = math.sin(angle_rad), self.xi + math.cos(angle_rad)
        return sine / (self.alpha * math.hypot(sine, z_2) + (1 - self.alpha) * z_2)

    def domain(self, camera: Camera, lens: Lens) -> Domain:  # noqa: ARG002
        """The limit at which the radius becomes infinite, or folds back."""
        angle = math.acos(self._lowest)
        if self.xi >= 1:
            # The outline of the first sphere, seen from the second's centre at an angle whose sine is 1/xi.
            ahead = self.alpha + (1 - self.alpha) * math.sqrt(1 - 1 / self.xi**2)
            return Domain(angle, 1 / (self.xi * ahead) if ahead else math.inf, "the image folds back on itself")
        if self.alpha <= 0.5:
            return Domain(angle, math.inf, "nothing is projected")
        return Domain(angle, 1 / math.sqrt(2 * self.alpha - 1), "the image folds back on itself")

    @property
    def _lowest(self) -> float:
        """The cosine of the largest angle off the axis."""
        w = -lowest_of(self.alpha)
        if self.xi >= 1:
            return -1 / self.xi
        return -(self.xi * (1 - w * w) + w * math.sqrt(1 - self.xi**2 * (1 - w * w)))

    def parameters(self, camera: Camera, lens: Lens) -> "DoubleSphereCamera":  # noqa: ARG002
        """The model's parameters as the compiled functions take them."""
        return DoubleSphereCamera(
            **camera.matrix,
            xi=self.xi,
            alpha=self.alpha,
            lowest=self._lowest,
        )


class DoubleSphereCamera(NamedTuple):
    """Model and camera as numbers: focal lengths, skew and centre in pixels."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    xi: float
    alpha: float
    lowest: float
    """Cosine of the largest angle off the axis."""


@kernel
def _project(x, y, z, camera):
    alpha = camera.alpha
    d = math.sqrt(x * x + y * y + z * z)
    z_2 = camera.xi * d + z
    ahead = alpha * math.sqrt(x * x + y * y + z_2 * z_2) + (1.0 - alpha) * z_2
    m, n = x / ahead, y / ahead
    u, v = to_pixel(m, n, camera)
    return u, v, z > camera.lowest * d


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    xi, alpha = camera.xi, camera.alpha
    across_d = x * dx + y * dy
    d = math.sqrt(x * x + y * y + z * z)
    z_2, z_2_d = xi * d + z, xi * (across_d + z * dz) / d + dz
    d_2 = math.sqrt(x * x + y * y + z_2 * z_2)
    ahead = alpha * d_2 + (1.0 - alpha) * z_2
    ahead_d = alpha * (across_d + z_2 * z_2_d) / d_2 + (1.0 - alpha) * z_2_d
    m, n = x / ahead, y / ahead
    m_d, n_d = (dx - m * ahead_d) / ahead, (dy - n * ahead_d) / ahead
    return moved_pixel(m, n, m_d, n_d, camera)


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    xi, alpha = camera.xi, camera.alpha
    for i in range(u.size):
        m, n = from_pixel(u[i], v[i], camera)
        r2 = m * m + n * n
        # Either root is NaN outside the domain; for xi >= 1 every visible direction lies ahead.
        z_2 = (1.0 - alpha * alpha * r2) / (alpha * math.sqrt(1.0 - (2.0 * alpha - 1.0) * r2) + 1.0 - alpha)
        if xi >= 1.0 and not z_2 > 0.0:
            z_2 = math.nan
        k = (xi * z_2 + math.sqrt(z_2 * z_2 + (1.0 - xi * xi) * r2)) / (z_2 * z_2 + r2)
        x_out[i] = k * m
        y_out[i] = k * n
        z_out[i] = k * z_2 - xi


add_compiled_model(DoubleSphereCamera, CompiledModel(_project, _move, _rays))
