"""From the angles of a matcher to ranges, with a reason where a range is missing."""

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.triangulation import range_from_angles
from harness.matching.interface import Matches, Reason


def ranges_of(matches: Matches, alpha_1: Array, baseline_m: float) -> tuple[Array, NDArray[np.uint8]]:
    """Range from view 1 in metres `[height, width]`, NaN where it is missing, and the `Reason` why.

    Parameters
    ----------
    alpha_1
        `[height, width]`, radians: the angle between each pixel's direction and t.
    baseline_m
        |t|.
    """
    range_m = range_from_angles(alpha_1, matches.alpha_2, baseline_m)
    lost = np.isnan(range_m) & (matches.reasons == Reason.MATCHED)
    return range_m, np.where(lost, np.uint8(Reason.BEYOND_INFINITY), matches.reasons)
