"""Compiled loops over windows whose columns follow the epipolar map. `column` lays out their arguments.

Everything is a whole number: sums come out the same in any order, and running sums never drift. Arrays are
[column, row] or [column, sample], so that the innermost loops run along memory. Indices of those loops are unsigned:
numba would otherwise ask of each whether it counts from the end. Parts of arrays are named by indices beside the array:
to slice one counts references, atomically, and the threads would queue for that.
"""

import math

import numpy as np

from harness.compiled import kernel
from harness.matching._matching_kernels import CENSUS, LEAVES_IMAGE, OK, SSD, ZNCC, bits_set
from harness.matching._vector_kernels import LANES, load, store

FRACTION_BITS = 16
"""Rows of the second image are counted in parts of 2^-16."""
LARGEST = np.int32(4094)
"""The largest difference of two pixels; a pixel itself is within half of it."""
ABSENT = np.int16(8191)
"""Stands for a missing difference, or a missing pixel of view 2."""
MISSING = np.int32(-(1 << 31))
"""Stands for a missing pixel of view 2."""
ZNCC_UNIT = 1 << 24
"""1 - ZNCC is counted in parts of 2^-24, which is twice as fine as single precision near 1."""
NO_ZNCC = 1 << 30
"""Stands for 1 - ZNCC where a window is not whole."""


@kernel
def rows_of_samples(k_first, k_last, k_0, margin, first, end):
    """The rows of every column in which a sample, or one up to `margin` beside it, is searched.

    k_first, k_last : `[width, height]`.
    first, end : written; `[width, samples]`, half-open, for samples from k_0 on. Empty before: first = height, end = 0.
    """
    width, height = k_first.shape
    for column in range(width):
        for row in range(height):
            if k_last[column, row] < k_first[column, row]:
                continue
            begin, stop = k_first[column, row] - margin - k_0, k_last[column, row] + margin + 1 - k_0
            for k in range(np.uint64(begin), np.uint64(stop)):
                first[column, k] = min(first[column, k], np.int32(row))
                end[column, k] = row + 1


@kernel(inline=True)
def _gather(pairs, second, source, gain, offset, start, end):
    """Gather the values of a column of the second image at the rows that rows start .. end are mapped to.

    A loop of its own, because the compiler vectorises over rows only where there is no lookup.
    """
    position = np.uint32(np.uint32(offset) + np.uint32(gain) * np.uint32(start))
    for i in range(np.uint64(start), np.uint64(end)):
        pairs[i] = second[source, np.uint64(position >> np.uint32(16))]
        position = np.uint32(position + np.uint32(gain))


@kernel(inline=True)
def _between_rows(pair, gain, offset, i):
    """The pixel in the upper 16 bits, moved on by its fraction of the step to the next row in the lower ones."""
    fraction = ((np.uint32(offset) + np.uint32(gain) * np.uint32(i)) >> np.uint32(8)) & np.uint32(255)
    slope = np.int32(np.int16(pair))
    return np.int32(pair >> np.int32(16)) + np.int32((slope * np.int32(fraction) + np.int32(128)) >> np.int32(8))


@kernel(inline=True)
def _add_differences(
    total, stored, k, slot, first, column, pairs, gain, offset, image_first, image_end, start, end, absent, squared
):
    """Add one column's differences to the running sum over columns, and keep them to be taken off again."""
    for i in range(np.uint64(start), np.uint64(end)):
        row = np.int32(i)
        d = np.int32(abs(np.int32(np.int32(first[column, i]) - _between_rows(pairs[i], gain, offset, i))))
        present = (row >= image_first) & (row < image_end) & (d <= LARGEST)
        stored[slot, k, i] = np.int16(d) if present else ABSENT
        if squared:
            total[k, i] += d * d if present else absent
        else:
            total[k, i] += d if present else absent


@kernel
def _add_hamming(total, stored, k, slot, first, column, pairs, image_first, image_end, start, end, absent):
    """Add one column's Hamming distances of census transforms, as `_add_differences` does with differences."""
    for i in range(np.uint64(start), np.uint64(end)):
        row = np.int32(i)
        d = np.int32(bits_set(np.uint32(first[column, i] ^ pairs[i])))
        present = (row >= image_first) & (row < image_end) & (pairs[i] != MISSING)
        stored[slot, k, i] = np.int16(d) if present else ABSENT
        total[k, i] += d if present else absent


@kernel(inline=True)
def _subtract(total, stored, k, slot, start, end, absent, squared):
    """Take a column's differences off the running sum."""
    for i in range(np.uint64(start), np.uint64(end)):
        d = np.int32(stored[slot, k, i])
        if squared:
            total[k, i] -= d * d if d <= LARGEST else absent
        else:
            total[k, i] -= d if d <= LARGEST else absent


@kernel
def _add_moments(
    total, squares, products, stored, k, slot, first, column, pairs, gain, offset, image_first, image_end, start, end,
    absent,
):  # fmt: skip
    """For ZNCC: add a column's pixels of view 2, their squares, and their products with view 1's."""
    for i in range(np.uint64(start), np.uint64(end)):
        row = np.int32(i)
        value = _between_rows(pairs[i], gain, offset, i)
        present = (row >= image_first) & (row < image_end) & (abs(value) <= LARGEST)
        value = value if present else np.int32(0)
        stored[slot, k, i] = np.int16(value) if present else ABSENT
        total[k, i] += value if present else absent
        squares[k, i] += value * value
        products[k, i] += value * np.int32(first[column, i])


@kernel(inline=True)
def _subtract_moments(total, squares, products, stored, k, slot, first, column, start, end, absent):
    for i in range(np.uint64(start), np.uint64(end)):
        value = np.int32(stored[slot, k, i])
        present = value <= LARGEST
        value = value if present else np.int32(0)
        total[k, i] -= value if present else absent
        squares[k, i] -= value * value
        products[k, i] -= value * np.int32(first[column, i])


@kernel
def _sum_rows(sums, total, fours, k, start, end, half):
    """Sums of 2 half + 1 rows, as many as possible four at a time.

    fours : `[height + 2 LANES]`, overwritten.
    """
    last = np.uint64(2 * half)
    for i in range(np.uint64(start - half), np.uint64(end + half), np.uint64(LANES)):
        a, b = load(total, (k, i)), load(total, (k, i + np.uint64(1)))
        c, d = load(total, (k, i + np.uint64(2))), load(total, (k, i + np.uint64(3)))
        store(fours, (i,), (a + b) + (c + d))
    whole = (last + np.uint64(1)) & ~np.uint64(3)
    for i in range(np.uint64(start - half), np.uint64(end - half), np.uint64(LANES)):
        running = load(total, (k, i + last))
        for j in range(np.uint64(0), whole, np.uint64(4)):
            running += load(fours, (i + j,))
        for j in range(whole, last):
            running += load(total, (k, i + j))
        store(sums, (k, i + np.uint64(half)), running)


@kernel
def _one_minus_zncc(costs, total, squares, products, k, number, own_sum, own_spread, column, absent, start, end):
    """1 - ZNCC in parts of 2^-24; a window without any contrast is correlated with nothing.

    All sums times the window's size are below 2^53: doubles hold them exactly.
    """
    for i in range(np.uint64(start), np.uint64(end)):
        s = np.float64(total[k, i])
        spread = number * np.float64(squares[k, i]) - s * s
        together = number * np.float64(products[k, i]) - s * own_sum[column, i]
        scale = math.sqrt(max(spread, 0.0)) * math.sqrt(own_spread[column, i])
        zncc = together / scale if scale > 0 else 0.0
        cost = np.int32(min(max((1 - zncc) * ZNCC_UNIT + 0.5, 0.0), 3.0 * ZNCC_UNIT))
        costs[k, i] = cost if total[k, i] <= absent // 2 else NO_ZNCC


@kernel(inline=True)
def _update_least(sums, k, number, k_first, k_last, column, least, least_k, most, start, end):
    """Keep, of the samples searched so far, the least cost, its sample (the first of equals), and the greatest cost."""
    for i in range(np.uint64(start), np.uint64(end)):
        value = sums[k, i]
        searched = (number >= k_first[column, i]) & (number <= k_last[column, i])
        better = searched & (value < least[i])
        least[i] = value if better else least[i]
        least_k[i] = number if better else least_k[i]
        most[i] = max(most[i], value) if searched else most[i]


@kernel
def match_columns(
    column_first,
    column_end,
    kind,
    first,
    second,
    parts,
    stride,
    shift,
    half,
    unit,
    absent,
    none,
    k_0,
    sign,
    gain,
    offset,
    image_first,
    image_end,
    centre_first,
    centre_end,
    row_first,
    row_end,
    own_sum,
    own_spread,
    k_first,
    k_last,
    searched,
    total,
    squares,
    products,
    stored,
    sums,
    of_squares,
    of_products,
    costs_of,
    before,
    find,
    reason,
    k_best,
    costs,
):
    """For each searched pixel of some columns: the best sample, and the costs of some samples from `before` it on.

    kind : SAD, SSD, ZNCC or CENSUS.
    first : `[width, height]`, whole numbers of parts of a grey level, or census transforms.
    second : `[width parts, height]`, each pixel in the upper 16 bits and the step to the next row in the lower ones, or
        census transforms.
    stride, shift : sample k is `stride k + shift` of the second image's columns away.
    unit, absent, none : what costs are counted in, what a missing pixel adds to a sum, and the least cost
        that no whole window has.
    k_0 : the sample that comes first in all arrays of samples.
    sign, gain, offset, image_first, image_end : the columns' maps, and the rows that they map into the image.
    centre_first, centre_end : `[width, samples]`, rows of the window centres that are compared.
    row_first, row_end : rows of the windows that a column is part of.
    own_sum, own_spread : `[width, height]`, for ZNCC: a window's sum, and n times the sum of squares less its square.
    k_first, k_last : `[width, height]`.
    searched : `[height, width]`.
    total, squares, products : `[samples, height + 2 LANES]`, zeros; sums of rows of the window, of a type that holds
        all of them.
    stored : `[2 half + 1, samples, height]`: what the window's columns have added.
    sums, of_squares, of_products : `[samples, height + 2 LANES]`, sums of windows.
    costs_of : `[samples, height + 2 LANES]`: `sums` itself, or for ZNCC what is made of them.
    find : whether to look for the best sample; otherwise `k_best` says which it is.
    reason, k_best, costs : written; `[height, width]`, and `[height, width, count]`.
    """
    width = np.uint64(first.shape[0])
    sources = np.int64(second.shape[0])
    height = searched.shape[0]
    size, reach = np.uint64(2 * half + 1), np.uint64(half)
    number = np.float64(size * size)
    squared = kind == SSD
    rounding = np.int32(1 << 15) if kind == CENSUS else np.int32(0)
    pairs, least_k = np.zeros(height, np.int32), np.zeros(height, np.int32)
    fours = np.empty(total.shape[1], total.dtype)
    least, most = np.zeros(height, total.dtype), np.zeros(height, total.dtype)
    for step in range(np.uint64(column_end - column_first + 2 * half)):
        # A column enters the window on its far side, and the one `size` before it leaves.
        entering = np.uint64(np.uint64(column_first) + size * width - reach + step) % width
        centre = np.uint64(entering + size * width - reach) % width
        leaving = np.uint64(entering + size * width - size) % width
        slot = step % size
        compare = step >= size - 1
        least[:] = none
        most[:] = 0
        for k in range(np.uint64(total.shape[0])):
            if step >= size and row_first[leaving, k] < row_end[leaving, k]:
                start, end = row_first[leaving, k], row_end[leaving, k]
                if kind == ZNCC:
                    _subtract_moments(total, squares, products, stored, k, slot, first, leaving, start, end, absent)
                else:
                    _subtract(total, stored, k, slot, start, end, absent, squared)
            start, end = row_first[entering, k], row_end[entering, k]
            if start >= end:
                continue
            sample = np.int32(np.int64(k) + k_0)
            source = np.uint64((np.int64(entering) * parts + sign[entering] * (stride * sample + shift)) % sources)
            image_start, image_stop = image_first[entering, k], image_end[entering, k]
            map_gain, map_offset = gain[entering, k], np.int32(offset[entering, k] + rounding)
            _gather(pairs, second, source, map_gain, map_offset, max(start, image_start), min(end, image_stop))
            if kind == ZNCC:
                _add_moments(
                    total, squares, products, stored, k, slot, first, entering, pairs, map_gain, map_offset,
                    image_start, image_stop, start, end, absent,
                )  # fmt: skip
            elif kind == CENSUS:
                _add_hamming(
                    total, stored, k, slot, first, entering, pairs, image_start, image_stop, start, end, absent
                )
            else:
                _add_differences(
                    total, stored, k, slot, first, entering, pairs, map_gain, map_offset, image_start, image_stop,
                    start, end, absent, squared,
                )  # fmt: skip
            start, end = centre_first[centre, k], centre_end[centre, k]
            if compare and start < end:
                _sum_rows(sums, total, fours, k, start, end, half)
                if kind == ZNCC:
                    _sum_rows(of_squares, squares, fours, k, start, end, half)
                    _sum_rows(of_products, products, fours, k, start, end, half)
                    _one_minus_zncc(
                        costs_of, sums, of_squares, of_products, k, number, own_sum, own_spread, centre, absent,
                        start, end,
                    )  # fmt: skip
                if find:
                    _update_least(costs_of, k, sample, k_first, k_last, centre, least, least_k, most, start, end)
        if not compare:
            continue
        for row in range(height):
            if not searched[row, centre]:
                continue
            if find:
                if most[row] >= none:
                    reason[row, centre] = LEAVES_IMAGE
                    continue
                reason[row, centre] = OK
                k_best[row, centre] = least_k[row]
            base = k_best[row, centre] - before - k_0
            for i in range(costs.shape[2]):
                value = costs_of[base + i, row]
                costs[row, centre, i] = value / unit if value < none else math.nan
