"""What view 2's own planes say of the points that view 1's make: confirmed, contradicted, or hidden."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.matching.interface import Reason
from harness.matching.slanted import _reading_kernels as _kernels
from harness.matching.slanted.field import Field, Mask, Part, read_planes

_MISSING_SQUARE_PX, _MISSING_SHARE = 7, 0.05
"""A hidden pixel has this share of the pixels of such a square without a start (three of them)."""


@dataclass(frozen=True)
class Reverse:
    """View 2 fitted to view 1."""

    field: Field
    part: Part
    """View 2's."""
    motion: Motion
    """From view 1 to view 2."""


def seen_back(x: Array, w: Array, reverse: Reverse) -> tuple[Array, Array]:
    """Angles alpha_2 of the points in directions x of view 1 at inverse ranges w, radians; and by how much view 2's own
    surface there is nearer, radians of alpha_2, NaN where it has none.
    """
    there, (length, across, along) = np.empty(x.shape), np.empty((3, *w.shape))
    t, R = (np.ascontiguousarray(a, np.float64) for a in (reverse.motion.t_v1, reverse.motion.R_v2_from_v1))
    _kernels.seen_from_2(
        np.ascontiguousarray(x).reshape(-1, 3), w.ravel(), t, R, there.reshape(-1, 3), length.ravel(), across.ravel(),
        along.ravel(),
    )  # fmt: skip
    # The same point in view 2, at inverse range w/|q| in direction R q/|q|, and view 2's own there. With
    # d alpha_2/dw = |t × q|/|q|² and w_2 = w/|q|, alpha_2 changes by |t × q| |q| for a unit of w_2.
    _, _, w_2 = read_planes(reverse.field, there, reverse.part)
    return np.arctan2(across, along), (w_2 - w / length) * across * length


def tell_occluded(
    reasons: NDArray[np.uint8], w: Array, unlike: Mask, start: Array, reverse: Reverse, grid: Grid, apart: float
) -> None:
    """Mark pixels without a match that view 2 cannot see.

    What a hidden pixel shows goes on from the matched pixels around, and is the farthest of what they show: the nearer
    surface is the one that hides it. It is hidden if view 2 sees something nearer where that would be, by more than
    `apart`, if nothing that was found in view 2 is like it, and if the start lacks pixels around: view 2 matched theirs
    with others. Without the last two, pixels at the edge of the nearer surface, and in blank places, would be said to
    be hidden.

    Parameters
    ----------
    reasons
        `[height, width]`; written.
    w
        Inverse ranges, right where there is a match.
    unlike
        Pixels whose surroundings no plane explains.
    start
        NaN where there was none.
    """
    missing = ndimage.uniform_filter(np.isnan(start).astype(float), _MISSING_SQUARE_PX, mode=("nearest", "wrap"))
    without = (reasons == Reason.NO_MATCH) | (reasons == Reason.INCONSISTENT)
    row, column = np.nonzero(without & unlike & (missing > _MISSING_SHARE))
    behind = farthest_beside(np.where(reasons == Reason.MATCHED, w, np.nan))[row, column]
    _, nearer = seen_back(directions(grid)[row, column], behind, reverse)
    with np.errstate(invalid="ignore"):
        hidden = nearer > apart
    reasons[row[hidden], column[hidden]] = Reason.OCCLUDED


def farthest_beside(w: Array) -> Array:
    """The least of the nearest known values in either direction along row and column; NaN where there is none.

    Rows go round.
    """
    least = np.empty(w.shape)
    _kernels.farthest_beside(w, least)
    return least
