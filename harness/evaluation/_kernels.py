"""Compiled loops over pixels and groups. Called through `groups`, which prepares the arguments."""

import numpy as np
from numba import njit

DIGITS = 1 << 11


@njit(cache=True, nogil=True)
def count(labels, seen, counts):
    """How many seen pixels each group has. labels : `[pixels, layers]`, group or -1; counts : written, `[groups]`."""
    for pixel in range(labels.shape[0]):
        if seen[pixel]:
            for layer in range(labels.shape[1]):
                if labels[pixel, layer] >= 0:
                    counts[labels[pixel, layer]] += 1


@njit(cache=True, nogil=True)
def add(labels, seen, values, sums):
    """Sums over the seen pixels of each group. values : `[pixels, kinds]`; sums : written, `[groups, kinds]`."""
    for pixel in range(labels.shape[0]):
        if seen[pixel]:
            for layer in range(labels.shape[1]):
                group = labels[pixel, layer]
                if group >= 0:
                    for kind in range(values.shape[1]):
                        sums[group, kind] += values[pixel, kind]


@njit(cache=True, nogil=True)
def medians(labels, seen, order, values, counts, passed, low, high):
    """Both middle values (one, where the count is odd) of each group, in one walk over the pixels in ascending order.

    order : pixels by ascending value; passed : `[groups]`, zeros; low, high : written, `[groups]`.
    """
    for i in range(order.size):
        pixel = order[i]
        if not seen[pixel]:
            continue
        for layer in range(labels.shape[1]):
            group = labels[pixel, layer]
            if group < 0:
                continue
            if passed[group] == (counts[group] - 1) // 2:
                low[group] = values[pixel]
            if passed[group] == counts[group] // 2:
                high[group] = values[pixel]
            passed[group] += 1


@njit(cache=True, nogil=True)
def sort_by_bits(keys, order, other):
    """Sort `order`, indices into the 32-bit keys, by their keys: three passes of eleven bits. other : of its size."""
    for shift in (0, 11, 22):
        place = np.zeros(DIGITS + 1, dtype=np.int64)
        for i in range(order.size):
            place[((keys[order[i]] >> np.uint32(shift)) & np.uint32(DIGITS - 1)) + 1] += 1
        for digit in range(DIGITS):
            place[digit + 1] += place[digit]
        for i in range(order.size):
            digit = (keys[order[i]] >> np.uint32(shift)) & np.uint32(DIGITS - 1)
            other[place[digit]] = order[i]
            place[digit] += 1
        order, other = other, order
    return order
