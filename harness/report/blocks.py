"""The numbers behind maps and pictures of a panorama, averaged in a fixed number of blocks."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.report.data import Data

BLOCKS = (20, 72)
"""Most blocks down and across a panorama."""

Fields = dict[str, tuple[NDArray[np.floating], NDArray[np.bool_], Callable[[Any], Any]]]
"""Values `[height, width]` by column name, the mask of known ones, and the function that summarises a block."""


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def in_blocks(name: str, grid: Grid, fields: Fields) -> Data:
    """One row for each block: its middle, and each field summarised over the pixels that have a value."""
    downs, acrosses = (
        np.array_split(np.arange(size), min(most, size)) for size, most in zip(grid.shape, BLOCKS, strict=True)
    )
    lines = []
    for down in downs:
        for across in acrosses:
            block = np.ix_(down, across)
            line = [float(np.degrees(grid.phi[across].mean())), float(grid.z[down].mean())]
            for values, known, sum_up in fields.values():
                chosen = values[block][known[block]]
                line.append(float(sum_up(chosen)) if chosen.size else np.nan)
            lines.append(line)
    return Data(name, ["azimuth_deg", "z", *fields], lines)
