"""The unified model of Geyer and Daniilidis with Mei's lens: mirrors of all conics, and fisheyes.

A direction is projected onto the unit sphere, and from there by a pinhole at distance xi behind the sphere's centre.
With d = |(x, y, z)|,

    (m, n) = (x, y)/(z + xi d),      u = f m' + s n' + cx,    v = f aspect n' + cy,

(m', n') being (m, n) after Brown-Conrady distortion. This is OpenCV's `omnidir` with K[0, 0] = f and K[0, 1] = s, which
has no k3. xi = 0 is a pinhole, xi < 1 a hyperboloid mirror, xi = 1 a paraboloid (or a stereographic lens); calibrations
of real sensors also give xi > 1.

Back, with r² = m² + n²: `k = (xi + sqrt(1 - (xi² - 1) r²))/(1 + r²)`, direction (k m, k n, k - xi), of unit length.
Here `k - xi = (1 - xi² r²)/(xi r² + sqrt(1 - (xi² - 1) r²))`, in which nothing cancels.

Domain: `z > -min(xi, 1/xi) d`, where for xi <= 1 the radius becomes infinite, and beyond which for xi > 1 two
directions share a pixel; and within the radius at which lens distortion folds back.

Source: C. Mei and P. Rives, Single view point omnidirectional camera calibration from planar grids, ICRA 2007.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from harness.camera._lens_kernels import bend, move_bent, unbend
from harness.camera._pixel_kernels import from_pixel, moved_pixel, to_pixel
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens, fold_radius, least_bent_radius
from harness.camera.models.axial import AxialModel, Domain
from harness.compiled import kernel


class Unified(AxialModel):
    """The unified (Mei) model: OpenCV's omnidir, Kalibr's omni."""

    title: ClassVar[str] = "unified (Mei) camera"
    has_lens: ClassVar[bool] = True

    kind: Literal["unified"] = "unified"
    """The unified model."""
    xi: Annotated[float, Field(ge=0, le=100)]
    """Distance of the centre of projection from that of the sphere, no unit: 0 for a pinhole, below 1 for a hyperboloid
    mirror, 1 for a paraboloid."""

    def radius(self, angle_rad: float, lens: Lens) -> float:
        """|(m', n')|, in focal lengths."""
        return least_bent_radius(lens, math.sin(angle_rad) / (math.cos(angle_rad) + self.xi))

    def domain(self, camera: Camera, lens: Lens) -> Domain:  # noqa: ARG002
        """The limit at which the radius becomes infinite or folds back, or lens distortion folds back."""
        fold = fold_radius(lens)
        last = 1 / math.sqrt(self.xi**2 - 1) if self.xi > 1 else math.inf
        if fold < last:
            along = (1 - (self.xi * fold) ** 2) / (self.xi * fold**2 + math.sqrt(1 - (self.xi**2 - 1) * fold**2))
            across = fold * (along + self.xi)
            return Domain(math.atan2(across, along), least_bent_radius(lens, fold), "the lens folds the image over")
        if math.isinf(last):
            return Domain(math.acos(_lowest(self.xi)), last, "nothing is projected")
        return Domain(math.acos(_lowest(self.xi)), least_bent_radius(lens, last), "the image folds back on itself")

    def parameters(self, camera: Camera, lens: Lens) -> "UnifiedCamera":
        """The model's parameters as the compiled functions take them."""
        return UnifiedCamera(
            **camera.matrix,
            xi=self.xi,
            lowest=_lowest(self.xi),
            k1=lens.k1,
            k2=lens.k2,
            p1=lens.p1,
            p2=lens.p2,
            k3=lens.k3,
            fold=fold_radius(lens),
        )


def _lowest(xi: float) -> float:
    """The cosine of the largest angle off the axis."""
    return -xi if xi <= 1 else -1 / xi


class UnifiedCamera(NamedTuple):
    """Model, lens and camera as numbers: focal lengths, skew and centre in pixels."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    xi: float
    lowest: float
    """Cosine of the largest angle off the axis."""
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    fold: float
    """Radius at which the lens folds the image over."""


@kernel
def _project(x, y, z, camera):
    norm = math.sqrt(x * x + y * y + z * z)
    ahead = z + camera.xi * norm
    m, n = x / ahead, y / ahead
    inside = z > camera.lowest * norm and math.sqrt(m * m + n * n) <= camera.fold
    m, n = bend(m, n, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3)
    u, v = to_pixel(m, n, camera)
    return u, v, inside


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    xi = camera.xi
    norm = math.sqrt(x * x + y * y + z * z)
    ahead = z + xi * norm
    ahead_d = dz + xi * (x * dx + y * dy + z * dz) / norm
    m, n = x / ahead, y / ahead
    m_d, n_d = (dx - m * ahead_d) / ahead, (dy - n * ahead_d) / ahead
    m, n, m_d, n_d = move_bent(m, n, m_d, n_d, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3)
    return moved_pixel(m, n, m_d, n_d, camera)


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    xi = camera.xi
    k1, k2, p1, p2, k3, fold = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.fold
    has_lens = k1 != 0.0 or k2 != 0.0 or k3 != 0.0 or p1 != 0.0 or p2 != 0.0
    for i in range(u.size):
        m, n = from_pixel(u[i], v[i], camera)
        if has_lens:
            m, n = unbend(m, n, k1, k2, p1, p2, k3, fold)
        r2 = m * m + n * n
        root = math.sqrt(1.0 - (xi * xi - 1.0) * r2)  # NaN outside the domain
        k = (xi + root) / (1.0 + r2)
        x_out[i] = k * m
        y_out[i] = k * n
        z_out[i] = (1.0 - xi * xi * r2) / (xi * r2 + root)


add_compiled_model(UnifiedCamera, CompiledModel(_project, _move, _rays))
