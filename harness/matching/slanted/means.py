"""Means over squares of pixels, on all threads and in no more memory than the result takes."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array

_LINES = 64
"""Rows, or columns, that are worked on at a time."""


def means(values: NDArray[np.floating], side: int, pool: ThreadPoolExecutor, output: Array) -> Array:
    """Means over squares around every pixel, `[height, width]`; beyond the border lie zeros.

    The bits are those of `ndimage.uniform_filter`: along an axis it filters every line by itself.

    Parameters
    ----------
    side
        Of a square, pixels, odd and above 1.
    output
        What is written and returned; may be `values` itself.
    """

    def along(axis: int, source: NDArray[np.floating]) -> None:
        def lines(first: int) -> None:
            some = (slice(first, first + _LINES), slice(None))[:: 1 if axis else -1]
            ndimage.uniform_filter1d(source[some], side, axis, output[some], mode="constant")

        list(pool.map(lines, range(0, values.shape[1 - axis], _LINES)))

    along(0, values)
    along(1, output)
    return output
