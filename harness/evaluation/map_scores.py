"""Scores of a map against the true floor plan.

The plan's lines make cells occupied that they cross. Cells that can be reached from the path without crossing one are
free. Of the lines those count that border on what is free: what is inside of a solid, or behind a wall, nobody can map,
and nothing there is scored.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from harness.geometry.angles import Array
from harness.mapping.occupancy import Cell, GridFrame

States = NDArray[np.uint8]

_SAMPLES = 8
"""Points on a line for the side of a cell: one that cuts off a corner of less than an eighth is not counted."""


@dataclass(frozen=True)
class MapScore:
    """Figures of one map."""

    iou_free: float
    """Cells that are free in both, over those that are in either; of the cells that are scored."""
    iou_occupied: float
    """Occupied cells in both maps over those in either: a line of cells, so that an error of half a cell halves it."""
    known: float
    """Share of the scored cells that the map calls free or occupied."""
    border_m: float | None
    """Mean distance from the map's occupied cells to the plan's nearest line; None without any."""
    border_p95_m: float | None
    """The 95th percentile of these distances."""
    missed_borders: float
    """Share of the plan's borders with no occupied cell within two cells."""


def true_states(segments_m: Array, seeds_m: Array, frame: GridFrame) -> States:
    """The true map, a `Cell` for each cell; unknown where nothing is scored.

    Parameters
    ----------
    segments_m
        `[n, 2, 2]`: both ends of the plan's lines, metres.
    seeds_m
        `[n, 2]`: places that are free, such as those of the path.
    """
    crossed = np.zeros(frame.shape, dtype=bool)
    row, column, inside = frame.cells_of(points_on(segments_m, frame.cell_m / _SAMPLES))
    crossed[row[inside], column[inside]] = True
    regions, _ = ndimage.label(~crossed)
    row, column, inside = frame.cells_of(np.asarray(seeds_m, dtype=np.float64))
    reached = np.unique(regions[row[inside], column[inside]])
    free = np.isin(regions, reached[reached > 0])
    state = np.where(free, np.uint8(Cell.FREE), np.uint8(Cell.UNKNOWN))
    state[crossed & ndimage.binary_dilation(free, np.ones((3, 3)))] = Cell.OCCUPIED
    return state


def points_on(segments_m: Array, step_m: float) -> Array:
    """`[points, 2]` on lines `[n, 2, 2]`, no farther apart than a step, ends included."""
    if not len(segments_m):
        return np.empty((0, 2))
    length = np.linalg.norm(segments_m[:, 1] - segments_m[:, 0], axis=1)
    counts = np.ceil(length / step_m).astype(np.intp) + 1
    which = np.repeat(np.arange(len(segments_m)), counts)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    part = number / np.maximum(counts[which] - 1, 1)
    begin, end = segments_m[which, 0], segments_m[which, 1]
    return np.asarray(begin + part[:, None] * (end - begin))


def score_map(state: States, true: States, segments_m: Array, frame: GridFrame) -> MapScore:
    """The figures of a map.

    Parameters
    ----------
    state, true
        `[rows, columns]`: `Cell`; see `true_states`, unknown where nothing is scored.
    segments_m
        As for `true_states`.
    """
    scored = true != Cell.UNKNOWN
    x, y = frame.centres()
    centres = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
    occupied, borders = centres[state == Cell.OCCUPIED], centres[true == Cell.OCCUPIED]
    distance = None
    if len(occupied) and len(segments_m):
        distance, _ = cKDTree(points_on(segments_m, frame.cell_m / _SAMPLES)).query(occupied)
    missed = 0.0
    if len(borders):
        near = 2 * frame.cell_m * (1 + 1e-9)
        missed = float((cKDTree(occupied).query(borders)[0] > near).mean()) if len(occupied) else 1.0
    return MapScore(
        iou_free=_iou((state == Cell.FREE) & scored, true == Cell.FREE),
        iou_occupied=_iou((state == Cell.OCCUPIED) & scored, true == Cell.OCCUPIED),
        known=float((state[scored] != Cell.UNKNOWN).mean()) if scored.any() else 0.0,
        border_m=None if distance is None else float(distance.mean()),
        border_p95_m=None if distance is None else float(np.percentile(distance, 95)),
        missed_borders=missed,
    )


def _iou(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    union = int((one | other).sum())
    return float((one & other).sum() / union) if union else 1.0
