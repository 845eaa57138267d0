"""The predicted standard deviation of a trial's ranges."""

from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_1
from harness.geometry.triangulation import sigma_of_range
from harness.matching.uncertainty import sigma_alpha_2
from harness.pipeline.trial import Outcome


def sigma_m(outcome: Outcome) -> Array:
    """Standard deviation of each pixel's range, metres `[height, width]`; NaN for a pixel without one."""
    pair, matches = outcome.pair, outcome.matches
    sigma = sigma_alpha_2(pair, outcome.trial.matching, matches)
    return sigma_of_range(alpha_1(pair.grid, pair.t_v1), matches.alpha_2, sigma, pair.motion.baseline_m)
