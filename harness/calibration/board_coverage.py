"""The part of the field of view that is covered by boards."""

from dataclasses import dataclass

import numpy as np

from harness.calibration.corners import Corners
from harness.calibration.uncertainty import RayGrid, angles_off_axis
from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.geometry.angles import Array

_CELLS = 12
"""Cells along the longer side of the image."""


@dataclass(frozen=True, repr=False, eq=False)
class Coverage(OneLine):
    """The distribution of corners over the image."""

    counts: Array
    """`[rows, columns]`: corners in each square cell of the image; NaN in cells outside the field."""
    cell_px: float
    """Side of a cell, pixels; the first one's upper left corner is (-0.5, -0.5)."""
    share: float
    """Share of the field's cells that have a corner."""
    innermost_deg: float
    outermost_deg: float
    """Angles off the optical axis between which the corners lie, degrees."""
    widest_gap_deg: float
    """The largest angle around the axis without a corner, degrees."""


def coverage_of(sensor: Sensor, corners: Corners, grid: RayGrid) -> Coverage:
    """Corner counts in cells of the image, and the range of the corners' angles.

    Parameters
    ----------
    grid
        A grid over the sensor's field; a cell that holds no point of the grid counts as outside the field.
    """
    camera = sensor.camera
    cell = max(camera.width_px, camera.height_px) / _CELLS
    shape = int(np.ceil(camera.height_px / cell)), int(np.ceil(camera.width_px / cell))
    counts, inside = np.zeros(shape), np.zeros(shape, dtype=bool)
    column, row = _cells(corners.pixels, cell, shape).T
    np.add.at(counts, (row, column), 1)
    v, u = np.nonzero(grid.inside)
    column, row = _cells(np.stack([grid.u[u], grid.v[v]], axis=-1), cell, shape).T
    inside[row, column] = True
    inside |= counts > 0
    off_axis = np.degrees(angles_off_axis(sensor, corners.pixels))
    centre = [camera.cx_px, camera.cy_px]
    around = np.sort(np.degrees(np.arctan2(*(corners.pixels - centre).T[::-1])))
    return Coverage(
        counts=np.where(inside, counts, np.nan),
        cell_px=cell,
        share=float(np.mean(counts[inside] > 0)),
        innermost_deg=float(off_axis.min()),
        outermost_deg=float(off_axis.max()),
        widest_gap_deg=float(np.diff(around, append=around[0] + 360).max()),
    )


def _cells(pixels: Array, cell: float, shape: tuple[int, int]) -> Array:
    """Column and row `[n, 2]` of the cells that contain pixels `[n, 2]`."""
    return np.clip(np.floor((pixels + 0.5) / cell).astype(int), 0, [shape[1] - 1, shape[0] - 1])
