"""Compiled means over neighbours along an axis. `means` prepares their arguments.

Additions are those of `ndimage.uniform_filter1d`, in its order: the first sum of a line over its length, and then the
differences of what comes and what leaves.
"""

import numpy as np

from harness.compiled import kernel


@kernel
def along_columns(first, end, side, values, out):
    """Write means over `side` rows, in columns `first` to `end`; beyond the border lie zeros.

    out : written; may be `values` itself.
    """
    height, half = values.shape[0], side // 2
    padded, total = np.zeros((height + side, end - first)), np.zeros(end - first)
    for i in range(height):
        here, there = values[i, first:end], padded[half + i]
        for j in range(there.shape[0]):
            there[j] = here[j]
    for i in range(side):
        row = padded[i]
        for j in range(total.shape[0]):
            total[j] += row[j]
    for i in range(height):
        _move(padded[i], padded[i + side], side, total, out[i, first:end])


@kernel
def _move(leaving, coming, side, total, mean):
    """Write a row of means, and move the sums on by a row."""
    for j in range(total.shape[0]):
        mean[j] = total[j] / side
        total[j] += coming[j] - leaving[j]


@kernel
def along_rows(first, end, side, values, out):
    """Write means over `side` columns, in rows `first` to `end`; beyond the border lie zeros.

    out : written; may be `values` itself.
    """
    width, half = values.shape[1], side // 2
    padded, change = np.zeros(width + side), np.empty(width)
    for i in range(first, end):
        here, there = values[i], padded[half:]
        for j in range(width):
            there[j] = here[j]
        for j in range(width):
            change[j] = padded[j + side] - padded[j]
        total = 0.0
        for j in range(side):
            total += padded[j]
        for j in range(width):
            following = total + change[j]
            change[j], total = total, following
        mean = out[i]
        for j in range(width):
            mean[j] = change[j] / side
