"""Brown-Conrady lens distortion of normalised image coordinates, and the radius up to which it can be inverted."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from harness.camera._lens_kernels import bend_all
from harness.geometry.angles import Array
from harness.spec import Coefficient, Spec


class Lens(Spec):
    """Radial and tangential coefficients in OpenCV's order and meaning; all 0 for a pinhole."""

    k1: Coefficient = 0.0
    """Radial distortion, coefficient of r², no unit."""
    k2: Coefficient = 0.0
    """Radial distortion, coefficient of r⁴, no unit."""
    p1: Coefficient = 0.0
    """Tangential distortion, first coefficient, no unit."""
    p2: Coefficient = 0.0
    """Tangential distortion, second coefficient, no unit."""
    k3: Coefficient = 0.0
    """Radial distortion, coefficient of r⁶, no unit."""

    @property
    def is_pinhole(self) -> bool:
        """True when all coefficients are 0."""
        return not any((self.k1, self.k2, self.p1, self.p2, self.k3))


def distort(lens: Lens, points: ArrayLike) -> Array:
    """Distorted normalised image coordinates `[..., 2]` of undistorted ones.

    `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and y' with p1 and p2 exchanged.
    """
    points = np.asarray(points, dtype=np.float64)
    out = np.empty(points.shape)
    flat = np.ascontiguousarray(points).reshape(-1, 2)
    bend_all(flat, lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, out.reshape(-1, 2))
    return out


@lru_cache(maxsize=64)
def fold_radius(lens: Lens) -> float:
    """The undistorted radius at which the distorted radius stops growing, beyond which distortion has no inverse.

    The first zero of `d/dr [r + k1 r³ + k2 r⁵ + k3 r⁷] - 6 hypot(p1, p2) r`, whose last term bounds the slope of the
    tangential part; infinite for a distortion that never folds.
    """
    # In w = 1/r the polynomial is monic, so that tiny coefficients do no harm.
    slope = [1.0, -6 * float(np.hypot(lens.p1, lens.p2)), 3 * lens.k1, 0.0, 5 * lens.k2, 0.0, 7 * lens.k3]
    roots = np.roots(slope)
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots.real))) & (roots.real > 0)]
    return 1 / float(real.max()) if real.size else float("inf")


def least_bent_radius(lens: Lens, radius: float) -> float:
    """The distorted radius of an undistorted one, in the azimuth where it is smallest; it grows up to the fold.

    `r + k1 r³ + k2 r⁵ + k3 r⁷ - 3 hypot(p1, p2) r²`: the tangential part moves a point at azimuth phi outwards by
    `3 (p1 sin(phi) + p2 cos(phi)) r²`.
    """
    r2 = radius * radius
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    return radius * radial - 3 * float(np.hypot(lens.p1, lens.p2)) * r2
