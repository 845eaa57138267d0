"""Range by the sine rule, and its sensitivity to errors (sections 5 and 6 of the paper)."""

import numpy as np
from numpy.typing import ArrayLike

from harness.geometry import _triangulation_kernels as _kernels
from harness.geometry.angles import Array, angle_between, normalise


def triangulate(alpha_1: ArrayLike, alpha_2: ArrayLike, baseline_m: float) -> tuple[Array, Array]:
    """Ranges d_1 and d_2 (metres) from the angles to t in the epipolar plane (eqs. 7 and 8).

    Both angles are measured in v1's orientation, so that alpha_2 > alpha_1. NaN where the rays do not meet in front
    of both viewpoints (alpha_2 <= alpha_1: parallel, or diverging).
    """
    alpha_1, alpha_2 = _broadcast(alpha_1, alpha_2)
    d_1, d_2 = np.empty(alpha_1.shape), np.empty(alpha_1.shape)
    _kernels.sine_rule(alpha_1.ravel(), alpha_2.ravel(), float(baseline_m), d_1.reshape(-1), d_2.reshape(-1))
    return d_1, d_2


def range_from_angles(alpha_1: ArrayLike, alpha_2: ArrayLike, baseline_m: float) -> Array:
    """The range d_1 alone, as from `triangulate`, metres."""
    alpha_1, alpha_2 = _broadcast(alpha_1, alpha_2)
    d_1 = np.empty(alpha_1.shape)
    _kernels.sine_rule_1(alpha_1.ravel(), alpha_2.ravel(), float(baseline_m), d_1.reshape(-1))
    return d_1


def _broadcast(alpha_1: ArrayLike, alpha_2: ArrayLike) -> tuple[Array, Array]:
    """The values broadcast to arrays of float64 of one shape."""
    a_1, a_2 = np.broadcast_arrays(np.asarray(alpha_1, dtype=np.float64), np.asarray(alpha_2, dtype=np.float64))
    return a_1, a_2


def points(directions: ArrayLike, range_m: ArrayLike) -> Array:
    """The points `[..., 3]` (metres) at a range along directions of any length (eq. 9)."""
    return normalise(directions) * np.asarray(range_m, dtype=np.float64)[..., None]


def exact_alpha_2(points_v1: ArrayLike, t_v1: ArrayLike) -> Array:
    """alpha_2 (radians, eq. 6) of points `[..., 3]` given in v1's frame."""
    t_v1 = np.asarray(t_v1, dtype=np.float64)
    return angle_between(np.asarray(points_v1, dtype=np.float64) - t_v1, t_v1)


def alpha_2_at_range(directions: ArrayLike, range_m: float, t_v1: ArrayLike) -> Array:
    """alpha_2 (radians) of points at one range along directions `[..., 3]`; at an infinite range that is alpha_1."""
    x_1 = normalise(directions)
    return angle_between(x_1, t_v1) if np.isinf(range_m) else exact_alpha_2(range_m * x_1, t_v1)


def sensitivity_to_alpha_2(alpha_1: ArrayLike, alpha_2: ArrayLike, baseline_m: float) -> Array:
    """∂d_1/∂alpha_2 = -d_2²/(|t| sin alpha_1), metres per radian.

    Exact; equal to the paper's eq. 11. At alpha_1 = 90° it is -(d_1² + |t|²)/|t|, which eq. 12 shortens to d_1²/|t|.
    """
    _, d_2 = triangulate(alpha_1, alpha_2, baseline_m)
    return -(d_2**2) / (baseline_m * np.sin(np.asarray(alpha_1, dtype=np.float64)))


def sigma_of_range(alpha_1: ArrayLike, alpha_2: ArrayLike, sigma_alpha_2: ArrayLike, baseline_m: float) -> Array:
    """Standard deviation of the range from view 1, metres, to first order, by that of alpha_2 in radians; NaN where
    there is no match.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.abs(sensitivity_to_alpha_2(alpha_1, alpha_2, baseline_m)) * sigma_alpha_2)


def sensitivity_to_baseline(d_1_m: ArrayLike, baseline_m: float) -> Array:
    """∂d_1/∂|t| = d_1/|t| (eq. 10), metres per metre."""
    return np.asarray(d_1_m, dtype=np.float64) / baseline_m


def paper_law(d_1_m: ArrayLike, baseline_m: float) -> Array:
    """The paper's short form of the sensitivity, d_1²/|t| (eq. 12), metres per radian."""
    return np.asarray(d_1_m, dtype=np.float64) ** 2 / baseline_m
