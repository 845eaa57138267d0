"""Rejection of implausible matches of photographs: the views do not look alike there, or the point has moved.

In an experiment a matcher's outliers are its own, and are counted. Without ground truth they cannot be.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.sensor import project
from harness.geometry.angles import Array
from harness.geometry.panorama import directions
from harness.matching.interface import MatcherSettings, Matches, Reason
from harness.matching.pair import Pair
from harness.matching.uncertainty import sampled_at
from harness.motion.tiles import SIDE_PX
from harness.pipeline.geometry_check import GeometryCheck

LEAST_CORRELATION = 0.5
"""Least correlation of grey levels over a window of both views; a third of the room's matches below are wrong."""
WINDOW_PX = 9
LEAST_CONTRAST = 1.0
"""Standard deviation of a window's grey levels: below, rounding to 8 bits is most of it."""
LEAST_MOVED_PX = 1.0
"""Least offset of a moved window from its epipolar curve, pixels of view 2."""
_LOOSE = 0.5
"""Weight of a tile that does not go with the rest."""
_LEAST_BESIDE = 2
"""Least number of a moved tile's eight neighbours that have moved too: single ones are borders of two surfaces."""


def without_unlike(pair: Pair, matcher: MatcherSettings, matches: Matches) -> Matches:
    """Matches without those at which the views do not look alike, or have no texture.

    A matcher that predicts its own standard deviation has looked at that, and is left as it is.
    """
    if matches.sigma_alpha_2 is not None:
        return matches
    first, second = pair.panoramas()
    second_values = sampled_at(second, matcher.curves(pair.grid, pair.t_v1), matches.alpha_2)
    both = np.isfinite(second_values) & first.valid
    share, mean_1, mean_2 = (_means(each, both) for each in (np.ones(pair.grid.shape), first.values, second_values))
    squares = [
        _means(a * b, both)
        for a, b in ((first.values, first.values), (second_values, second_values), (first.values, second_values))
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        v_1, v_2 = squares[0] / share - (mean_1 / share) ** 2, squares[1] / share - (mean_2 / share) ** 2
        covariance = squares[2] / share - mean_1 * mean_2 / share**2
        alike = covariance > LEAST_CORRELATION * np.sqrt(np.maximum(v_1 * v_2, 0.0))
        alike &= np.minimum(v_1, v_2) > LEAST_CONTRAST**2
    # Where view 2's panorama ends, a matcher may know more than this check.
    return without(matches, both & ~alike, Reason.NO_MATCH)


def moved(pair: Pair, check: GeometryCheck) -> NDArray[np.bool_]:
    """Pixels `[height, width]` in windows that lie off their epipolar curves, and not as the rest does."""
    tiles, causes = check.tiles, check.causes
    if causes is None:
        return np.zeros(pair.grid.shape, dtype=bool)
    off = np.abs(check.across_px - check.explained_px)
    loose = (causes.weight < _LOOSE) & (off > LEAST_MOVED_PX)
    camera = pair.sensors[0].camera
    lattice = np.zeros((camera.height_px // SIDE_PX + 2, camera.width_px // SIDE_PX + 2), dtype=bool)
    row, column = (tiles.tiles // SIDE_PX).T
    lattice[row[loose], column[loose]] = True
    neighbours = ndimage.convolve(lattice.astype(int), np.ones((3, 3), int), mode="constant") - lattice
    lattice &= neighbours >= _LEAST_BESIDE
    pixels, valid = project(pair.sensors[0], directions(pair.grid))
    u, v = np.moveaxis(np.rint(np.where(valid[..., None], pixels, 0)).astype(np.intp) // SIDE_PX, -1, 0)
    return np.asarray(valid & lattice[np.clip(v, 0, lattice.shape[0] - 1), np.clip(u, 0, lattice.shape[1] - 1)])


def without(matches: Matches, wrong: NDArray[np.bool_], reason: Reason) -> Matches:
    """Matches without those of some pixels; the same object if none of these is matched."""
    wrong = wrong & (matches.reasons == Reason.MATCHED)
    if not wrong.any():
        return matches

    def less(name: str) -> Array | None:
        values = getattr(matches, name)
        return None if values is None else np.where(wrong, np.nan, values)

    return replace(
        matches,
        alpha_2=np.where(wrong, np.nan, matches.alpha_2),
        confidence=less("confidence"),
        sigma_alpha_2=less("sigma_alpha_2"),
        reason=np.where(wrong, np.uint8(reason), matches.reasons),
        refined=None if matches.refined is None else matches.refined & ~wrong,
        k=less("k"),
    )


def _means(values: NDArray[np.floating], where: NDArray[np.bool_]) -> Array:
    filled = np.where(where, values, 0.0).astype(np.float64)
    return np.asarray(ndimage.uniform_filter(filled, WINDOW_PX, mode=("constant", "wrap")))
