"""The ranges to search, from a few triangulated points of the scene."""

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, pixel_directions
from harness.geometry.angles import Array, angle_between
from harness.geometry.pose import Motion
from harness.motion.features import Correspondences, find_features, is_mirrored, match_features
from harness.motion.residuals import Turn, lies_before, sampson
from harness.motion.tiles import inverse_ranges

Image = NDArray[np.float32]

LEAST_PAIRS = 50
"""Fewest pairs from which limits follow."""
LEAST_SHARE = 0.3
"""Least share of all putative pairs that agree with the motion: of fewer, it is the motion that selects them."""
_OFF_PX = 3.0
"""Largest Sampson distance of a pair that agrees, pixels: a yaw that is 0.3 degrees off moves matches by that."""
_LEAST_ANGLE = np.radians(10)
"""Least angle between a direction and the baseline: close to it, range amplifies the noise of a match."""
_FAR_SHARE, _NEAR_SHARE = 0.02, 0.005
"""Shares of the points, the farthest and the nearest, that set no limits."""
_BESIDE = 0.6
"""Nearest range searched, of the nearest point's; the farthest likewise."""
_WIDE_FAR_SHARE, _WIDE_BESIDE = 0.005, 1 / 3
"""Share of far points and margin for the farthest range, where a small surface may be far off and have no keypoints,
such as the end of a corridor: the search is over inverse ranges, of which this adds hardly any."""
_FARTHEST = 200.0
"""Farthest range that counts, baselines: beyond, the parallax is below a third of a degree."""


def limits_of(w: Array, *, wide: bool = False) -> tuple[float, float]:
    """The nearest and the farthest range to search, baselines, from inverse ranges `[n]` of points, 1/|t|.

    0.6 times the range of the nearest point, 1/0.6 times that of the farthest, outliers aside.

    Parameters
    ----------
    wide
        Three times the range of the farthest point instead.
    """
    share, beside = (_WIDE_FAR_SHARE, _WIDE_BESIDE) if wide else (_FAR_SHARE, _BESIDE)
    farthest, nearest = np.maximum(np.quantile(w, [share, 1 - _NEAR_SHARE]), 1 / _FARTHEST)
    return float(_BESIDE / nearest), float(max(1 / (beside * farthest), 2 * _BESIDE / nearest))


def points_along(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], motion: Motion) -> tuple[Array, int]:
    """Inverse ranges from view 1 `[n]`, 1/|t|, of the matched keypoints that agree with a motion, and how many
    keypoints match at all.

    Raises
    ------
    InputError
        When OpenCV is not installed.
    """
    if not all(pixel_directions(each)[1].any() for each in sensors):
        return np.empty(0), 0
    mirrored = [is_mirrored(each) for each in sensors]
    first = find_features(images[0], sensors[0])
    second = find_features(images[1], sensors[1], flip=mirrored[0] != mirrored[1])
    pairs = match_features(first, second)
    return triangulated(pairs, motion), len(pairs)


def triangulated(pairs: Correspondences, motion: Motion) -> Array:
    """Inverse ranges from view 1 `[n]`, 1/|t|, of the pairs that agree with a motion and are not close to its t."""
    if not len(pairs):
        return np.empty(0)
    turn = Turn(np.asarray(motion.R_v2_from_v1), np.asarray(motion.t_v1) / motion.baseline_m)
    angle = angle_between(pairs.x_1, turn.t)
    agree = (np.abs(sampson(pairs, turn)) <= _OFF_PX) & lies_before(pairs, turn)
    agree &= (angle >= _LEAST_ANGLE) & (angle <= np.pi - _LEAST_ANGLE)
    return inverse_ranges(pairs.at(agree), turn)
