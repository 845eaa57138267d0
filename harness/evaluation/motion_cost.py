"""Range errors due to an estimated motion: predicted from its covariance, and measured with the true motion.

Measured is the error alone: where exact matches, along the epipolar curves of the estimated motion, would put the true
points, less where they are. What a matcher adds is the same for both motions.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from harness.geometry.angles import Array, angle_between, normalise
from harness.geometry.motion_error import MotionError, range_sigma
from harness.geometry.pose import Motion
from harness.geometry.triangulation import range_from_angles

_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over the median of the absolute values."""


def motion_figures(true: Motion, estimated: Motion, error: MotionError, x_1: Array, range_m: Array) -> dict[str, float]:
    """Errors of a motion, and their cost over some points, for the row of a trial.

    Parameters
    ----------
    true, estimated
        Motions of one length.
    error
        The estimated motion's own uncertainty.
    x_1
        `[n, 3]`, unit directions.
    range_m
        `[n]`, true ranges.

    Returns
    -------
    dict
        `motion_rotation_deg` and `motion_direction_deg`, angles between the two; `motion_range_predicted` and
        `motion_range_measured`, shares of the range: the median of the predicted standard deviations, and 1.4826 times
        the median of the errors' sizes; `motion_range_z`, the root of the mean square of errors over their predicted
        standard deviations, 1 on average over many trials if these are right.
    """
    shift = range_shift(true, estimated, x_1, range_m)
    sigma = range_sigma(x_1, range_m, estimated.t_v1, error)
    usable = np.isfinite(shift) & (sigma > 0)
    shift, sigma, d = shift[usable], sigma[usable], range_m[usable]
    turn = Rotation.from_matrix(estimated.R_v2_from_v1.T @ true.R_v2_from_v1).magnitude()
    nothing = not usable.any()
    return {
        "motion_rotation_deg": float(np.degrees(turn)),
        "motion_direction_deg": float(np.degrees(angle_between(estimated.t_v1, true.t_v1))),
        "motion_range_predicted": np.nan if nothing else float(np.median(sigma / d)),
        "motion_range_measured": np.nan if nothing else _TO_SIGMA * float(np.median(np.abs(shift) / d)),
        "motion_range_z": np.nan if nothing else float(np.sqrt(np.mean((shift / sigma) ** 2))),
    }


def range_shift(true: Motion, believed: Motion, x_1: Array, range_m: Array) -> Array:
    """Errors of ranges `[n]`, metres, of exact matches that are triangulated with a believed motion."""
    y = true.apply(range_m[:, None] * x_1) @ believed.R_v2_from_v1
    t = normalise(believed.t_v1)
    beside = normalise(x_1 - (x_1 @ t)[:, None] * t)  # m of the epipolar plane of x_1; what of y lies across it is lost
    alpha_2 = np.arctan2(np.sum(y * beside, axis=1), y @ t)
    return np.asarray(range_from_angles(angle_between(x_1, t), alpha_2, believed.baseline_m) - range_m)
