"""The extended unified camera model: the unified model with an ellipsoid instead of the sphere.

With `d = sqrt(beta (x² + y²) + z²)`,

    (m, n) = (x, y)/(alpha d + (1 - alpha) z),      u = f m + s n + cx,    v = f aspect n + cy.

beta = 1 is the unified model with xi = alpha/(1 - alpha) and a focal length of (1 + xi) f; alpha = 0 is a pinhole.

Back, with r² = m² + n²: direction `(m, n, (1 - beta alpha² r²)/(alpha sqrt(1 - (2 alpha - 1) beta r²) + 1 - alpha))`.

Domain: `z > -w d`. For alpha <= 1/2, w = alpha/(1 - alpha), where the radius becomes infinite; otherwise
w = (1 - alpha)/alpha, beyond which two directions share a pixel.

Source: B. Khomutenko, G. Garcia and P. Martinet, An enhanced unified camera model, RA-L 2016.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from harness.camera._pixel_kernels import from_pixel, moved_pixel, to_pixel
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models.axial import AxialModel, Domain
from harness.compiled import kernel


class ExtendedUnified(AxialModel):
    """The extended unified camera model (EUCM)."""

    title: ClassVar[str] = "extended unified camera"

    kind: Literal["eucm"] = "eucm"
    """The extended unified camera model."""
    alpha: Annotated[float, Field(ge=0, le=1)]
    """Weight of d in the denominator, no unit: 0 for a pinhole; above 0.5 the radius is bounded."""
    beta: Annotated[float, Field(ge=1e-3, le=1e3)]
    """Squared ratio of the ellipsoid's axes, no unit: 1 for a sphere."""

    def radius(self, angle_rad: float, lens: Lens) -> float:  # noqa: ARG002
        """|(m, n)|, in focal lengths."""
        sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
        return sine / (self.alpha * math.sqrt(self.beta * sine**2 + cosine**2) + (1 - self.alpha) * cosine)

    def domain(self, camera: Camera, lens: Lens) -> Domain:  # noqa: ARG002
        """The limit at which the radius becomes infinite, or folds back."""
        cosine = lowest_of(self.alpha)
        angle = math.atan2(math.sqrt((1 - cosine**2) / self.beta), cosine)
        if self.alpha <= 0.5:
            return Domain(angle, math.inf, "nothing is projected")
        return Domain(angle, 1 / math.sqrt(self.beta * (2 * self.alpha - 1)), "the image folds back on itself")

    def parameters(self, camera: Camera, lens: Lens) -> "ExtendedUnifiedCamera":  # noqa: ARG002
        """The model's parameters as the compiled functions take them."""
        return ExtendedUnifiedCamera(
            **camera.matrix,
            alpha=self.alpha,
            beta=self.beta,
            lowest=lowest_of(self.alpha),
        )


def lowest_of(alpha: float) -> float:
    """The smallest z/d in the domain, -w: where the denominator vanishes, or the radius stops growing."""
    return -alpha / (1 - alpha) if alpha <= 0.5 else -(1 - alpha) / alpha


class ExtendedUnifiedCamera(NamedTuple):
    """Model and camera as numbers: focal lengths, skew and centre in pixels."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    alpha: float
    beta: float
    lowest: float
    """The least z/d that is seen."""


@kernel
def _project(x, y, z, camera):
    alpha = camera.alpha
    d = math.sqrt(camera.beta * (x * x + y * y) + z * z)
    ahead = alpha * d + (1.0 - alpha) * z
    m, n = x / ahead, y / ahead
    u, v = to_pixel(m, n, camera)
    return u, v, z > camera.lowest * d


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    alpha, beta = camera.alpha, camera.beta
    d = math.sqrt(beta * (x * x + y * y) + z * z)
    ahead = alpha * d + (1.0 - alpha) * z
    ahead_d = alpha * (beta * (x * dx + y * dy) + z * dz) / d + (1.0 - alpha) * dz
    m, n = x / ahead, y / ahead
    m_d, n_d = (dx - m * ahead_d) / ahead, (dy - n * ahead_d) / ahead
    return moved_pixel(m, n, m_d, n_d, camera)


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    alpha, beta = camera.alpha, camera.beta
    for i in range(u.size):
        m, n = from_pixel(u[i], v[i], camera)
        r2 = beta * (m * m + n * n)
        root = math.sqrt(1.0 - (2.0 * alpha - 1.0) * r2)  # NaN outside the domain
        x_out[i] = m
        y_out[i] = n
        z_out[i] = (1.0 - alpha * alpha * r2) / (alpha * root + 1.0 - alpha)


add_compiled_model(ExtendedUnifiedCamera, CompiledModel(_project, _move, _rays))
