"""Range errors caused by errors of a motion: to first order, and as standard deviations.

With n the unit normal of the epipolar plane, along t x x_1, and m = n x t beside t in that plane: an error omega of the
rotation (R exp([omega]x) in place of R) turns view 2's ray by -omega within the plane, an error tau of the unit t turns
t by tau · m. From `d_1 = |t| sin(alpha_2)/sin(alpha_2 - alpha_1)`:

    delta d_1 = d_2²/(|t| sin(alpha_1)) n · omega - d_1 cot(alpha_2) m · tau .

The first goes with d²/|t|, like an error of the angle; the second with the range, whatever the baseline.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from harness.display import OneLine
from harness.geometry.angles import Array, angle_between, normalise
from harness.geometry.triangulation import exact_alpha_2, sensitivity_to_alpha_2


@dataclass(frozen=True, repr=False)
class MotionError(OneLine):
    """The uncertainty of a motion."""

    covariance: Array
    """`[6, 6]`, radians squared: of omega in `R exp([omega]x)` and of the change tau of the unit t, both in v1's
    frame."""
    length_by_motion: Array
    """`[6]`: how ln |t| changes with omega and tau; 0 where it was measured by itself."""
    length_share: float = 0.0
    """Standard deviation of |t| over |t|, in addition to its part from the motion."""


def sensitivity_to_motion(directions: ArrayLike, range_m: ArrayLike, t_v1: ArrayLike) -> Array:
    """Derivatives of the range d_1 by omega and tau, `[..., 6]`, metres per radian; see this module.

    Parameters
    ----------
    directions
        `[..., 3]`, x_1 of any length.
    range_m
        `[...]`, d_1.
    """
    t = np.asarray(t_v1, dtype=np.float64)
    x, d_1 = normalise(directions), np.asarray(range_m, dtype=np.float64)
    baseline, axis = float(np.linalg.norm(t)), normalise(t)
    alpha_1, alpha_2 = angle_between(x, t), exact_alpha_2(d_1[..., None] * x, t)
    with np.errstate(invalid="ignore", divide="ignore"):
        n = np.cross(axis, x) / np.sin(alpha_1)[..., None]
        by_angle = sensitivity_to_alpha_2(alpha_1, alpha_2, baseline)
        by_turn = -by_angle[..., None] * n
        by_direction = -(d_1 / np.tan(alpha_2))[..., None] * np.cross(n, axis)
    return np.concatenate([by_turn, by_direction], axis=-1)


def range_sigma(directions: ArrayLike, range_m: ArrayLike, t_v1: ArrayLike, error: MotionError) -> Array:
    """Standard deviation of the range from the motion's, `[...]`, metres; NaN where there is no range."""
    d_1 = np.asarray(range_m, dtype=np.float64)
    j = sensitivity_to_motion(directions, d_1, t_v1) + d_1[..., None] * error.length_by_motion
    variance = np.einsum("...i,ij,...j->...", j, error.covariance, j)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + (error.length_share * d_1) ** 2))
