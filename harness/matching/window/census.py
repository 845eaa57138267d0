"""The census transform: a bit for each neighbour of a pixel, set if the neighbour is darker."""

import numpy as np
from numpy.typing import NDArray

from harness.matching.window import _window_kernels
from harness.matching.window.centres import whole_windows

NEIGHBOURHOOD_PX = 5
"""Side of the square of neighbours: 24 bits."""


def census(
    values: NDArray[np.number], valid: NDArray[np.bool_], parts: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """The transform of every pixel (Zabih and Woodfill 1994), around the seam.

    Parameters
    ----------
    values, valid
        `[height, width parts]`.
    parts
        Distance of neighbours along a row: an image with columns between its columns is compared at whole ones.

    Returns
    -------
    codes
        `[height, width parts]`; the first neighbour, up and to the left, is the lowest bit.
    valid
        The same shape: the whole neighbourhood is there.
    """
    codes = np.zeros(values.shape, dtype=np.int32)
    _window_kernels.census(values, NEIGHBOURHOOD_PX // 2, parts, codes)
    whole = np.empty(values.shape, dtype=bool)
    for part in range(parts):
        whole[:, part::parts] = whole_windows(valid[:, part::parts], NEIGHBOURHOOD_PX)
    return codes, whole
