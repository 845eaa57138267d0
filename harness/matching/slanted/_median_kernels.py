"""The compiled median over every pixel's surroundings, some dozens of columns at a time."""

import math

import numpy as np

from harness.compiled import kernel

AT_ONCE = 64
"""Columns side by side: the compiler compares several of them in one instruction."""


@kernel
def median_rows(first, end, reach, valid, w, smooth):
    """Median of the known inverse ranges about every pixel; NaN where fewer than a third are known.

    A window takes its samples to be linear in the inverse range, and one that is far off weighs as the square of that.

    smooth : written, rows `first` to `end`.
    """
    width = valid.shape[1]
    side = 2 * reach + 1
    size = side * side
    values, known = np.empty((size, AT_ONCE)), np.empty(AT_ONCE)
    for i in range(first, end):
        for begin in range(0, width, AT_ONCE):
            n = min(AT_ONCE, width - begin)
            if not valid[i, begin : begin + n].any():
                smooth[i, begin : begin + n] = math.nan
                continue
            for k in range(size):
                _shift(w, i + k // side - reach, begin + k % side - reach, values, k)
            _fill(values, known)
            middle = _median(values)
            for j in range(n):
                enough = valid[i, begin + j] and 3.0 * known[j] >= size
                smooth[i, begin + j] = values[middle, j] if enough else math.nan


@kernel
def _shift(w, row, column, values, k):
    """Write a row of w from a column on; NaN beyond the image."""
    height, width = w.shape
    out = values[k]
    for j in range(AT_ONCE):
        out[j] = math.nan
    if 0 <= row < height:
        begin = max(0, column)
        here, there = w[row, begin : min(width, column + AT_ONCE)], out[begin - column :]
        for j in range(here.shape[0]):
            there[j] = here[j]


@kernel
def _fill(values, known):
    """Put as many of the unknown values to -infinity, and the others to infinity, as leaves the median where it is.

    known : written, how many are finite. The median is value n // 2 of n, counted from 0.
    """
    size = values.shape[0]
    known[:] = 0.0
    for k in range(size):
        row = values[k]
        for j in range(AT_ONCE):
            known[j] += 1.0 if abs(row[j]) < math.inf else 0.0
    low = size // 2 - np.floor(0.5 * known)
    for k in range(size):
        row = values[k]
        for j in range(AT_ONCE):
            unknown = not abs(row[j]) < math.inf
            end = -math.inf if low[j] > 0.0 else math.inf
            row[j] = end if unknown else row[j]
            low[j] -= 1.0 if unknown else 0.0


@kernel
def _median(values):
    """Put the median of an odd number of rows, column by column, into one of them, whose number is returned.

    Of the first half of them and two more, neither the least nor the greatest is the median. Another takes their place
    until one is left.
    """
    size = values.shape[0]
    first, last = 0, size // 2 + 1
    for following in range(last + 1, size + 1):
        _least_and_greatest(values, first, last)
        first += 1
        if following == size:
            break
        _copy(values, following, last)
    return first


@kernel
def _least_and_greatest(values, first, last):
    """Move the least of some rows to the first, and the greatest to the last."""
    half = (first + last + 1) // 2  # with an odd number, the one in the middle is among both halves
    for k in range(first, half):
        _order(values, k, first + last - k)
    for k in range(first + 1, (first + last) // 2 + 1):
        _order(values, first, k)
    for k in range(half, last):
        _order(values, k, last)


@kernel
def _order(values, least, greatest):
    low, high = values[least], values[greatest]
    for j in range(AT_ONCE):
        one, other = low[j], high[j]
        low[j] = min(other, one)
        high[j] = max(one, other)


@kernel
def _copy(values, origin, to):
    here, there = values[origin], values[to]
    for j in range(AT_ONCE):
        there[j] = here[j]
