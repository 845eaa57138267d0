"""Means over squares of pixels, on all threads and in no more memory than the result takes."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.slanted import _means_kernels as _kernels
from harness.matching.slanted.field import in_turn

_LINES = 64
"""Rows, or columns, that are worked on at a time."""


def means(values: NDArray[np.floating], side: int, pool: ThreadPoolExecutor, output: Array) -> Array:
    """Means over squares around every pixel, `[height, width]`; beyond the border lie zeros.

    The bits are those of `ndimage.uniform_filter` in double precision.

    Parameters
    ----------
    side
        Of a square, pixels, odd and above 1.
    output
        What is written and returned; may be `values` itself.
    """

    def in_lines(work: Callable[..., None], count: int, source: NDArray[np.floating]) -> None:
        in_turn(
            pool, range(0, count, _LINES), lambda first: work(first, min(first + _LINES, count), side, source, output)
        )

    in_lines(_kernels.along_columns, values.shape[1], values)
    in_lines(_kernels.along_rows, values.shape[0], output)
    return output
