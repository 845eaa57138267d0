"""Compiled loops over pixels, samples and windows. `square` and `column` lay out their arguments."""

import math

import numpy as np
from numba import njit

PHI, ALPHA = 0, 1
SAD, SSD = 0, 1
OK, LEAVES_IMAGE = 0, 1


@njit(cache=True, nogil=True, inline="always")
def _pixel_of_sample(mode, k, phi_1, alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch, width):
    """Row and column of the pixel nearest to sample k of a curve; the row may lie outside the image."""
    if mode == PHI:
        phi = phi_1 + k * step
        z = -(n[0] * math.cos(phi) + n[1] * math.sin(phi)) / n[2]
    else:
        c, s = math.cos(alpha_1 + k * step), math.sin(alpha_1 + k * step)
        x, y = c * t_hat[0] + s * m[0], c * t_hat[1] + s * m[1]
        phi = math.atan2(y, x)
        z = (c * t_hat[2] + s * m[2]) / math.sqrt(x * x + y * y)
    row = min(max(math.floor((z_max - z) / z_pitch), -2.0e9), 2.0e9)
    return int(row), math.floor((phi + math.pi) / phi_pitch) % width


@njit(cache=True, nogil=True)
def _window_cost(cost, first, second, row_1, column_1, row_2, column_2, half, sums):
    """Dissimilarity of two square windows. The images are padded by `half` columns on both sides, around the seam.

    Every column of the window has a sum of its own in `sums`: additions of different columns may be done at a time, and
    yet each is done in one order, whatever the compiler makes of it.
    """
    size = np.uint64(2 * half + 1)
    for j in range(size):
        sums[j] = 0.0
    for i in range(size):
        row_a, row_b = np.uint64(row_1 - half) + i, np.uint64(row_2 - half) + i
        if cost == SAD:
            for j in range(size):
                sums[j] += abs(first[row_a, np.uint64(column_1) + j] - second[row_b, np.uint64(column_2) + j])
        else:
            for j in range(size):
                d = first[row_a, np.uint64(column_1) + j] - second[row_b, np.uint64(column_2) + j]
                sums[j] += d * d
    total = 0.0
    for j in range(size):
        total += sums[j]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _sample_cost(
    k, mode, cost, first, second, matchable_2, row, column, half, phi_1, alpha_1, step, t_hat, m, n,
    z_max, z_pitch, phi_pitch, sums,
):  # fmt: skip
    """Cost of sample k, NaN where the window of the second image is not all there."""
    height, width = matchable_2.shape
    row_2, column_2 = _pixel_of_sample(mode, k, phi_1, alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch, width)
    if row_2 < 0 or row_2 >= height or not matchable_2[row_2, column_2]:
        return math.nan
    return _window_cost(cost, first, second, row, column, row_2, column_2, half, sums)


@njit(cache=True, nogil=True, error_model="numpy")
def match_rows(
    rows,
    mode,
    cost,
    first,
    second,
    searched,
    matchable_2,
    half,
    phi,
    alpha_1,
    step,
    t_hat,
    m,
    n,
    k_first,
    k_last,
    z_max,
    z_pitch,
    phi_pitch,
    reach,
    reason,
    k_best,
    costs,
):
    """For each searched pixel of some rows: the best sample, and the costs from `reach` before it to `reach` after it.

    first, second : padded images, `[height, width + 2 half]`.
    searched, matchable_2 : `[height, width]`; pixels to search for, and window centres allowed in the second image.
    reason, k_best, costs : written; `[height, width]`, and `[height, width, 2 reach + 1]`.
    """
    sums = np.empty(2 * half + 1, dtype=np.float32)
    for row in rows:
        for column in range(searched.shape[1]):
            if not searched[row, column]:
                continue
            best, best_k = math.inf, -1
            complete = True
            for k in range(k_first[row, column], k_last[row, column] + 1):
                value = _sample_cost(
                    k, mode, cost, first, second, matchable_2, row, column, half, phi[column],
                    alpha_1[row, column], step[row, column], t_hat, m[row, column], n[row, column],
                    z_max, z_pitch, phi_pitch, sums,
                )  # fmt: skip
                if math.isnan(value):
                    complete = False
                    break
                if value < best:
                    best, best_k = value, k
            if not complete:
                reason[row, column] = LEAVES_IMAGE
                continue
            reason[row, column] = OK
            k_best[row, column] = best_k
            for i in range(-reach, reach + 1):
                costs[row, column, i + reach] = _sample_cost(
                    best_k + i, mode, cost, first, second, matchable_2, row, column, half, phi[column],
                    alpha_1[row, column], step[row, column], t_hat, m[row, column], n[row, column],
                    z_max, z_pitch, phi_pitch, sums,
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def costs_along_curve(
    ks, mode, cost, first, second, matchable_2, row, column, half, phi_1, alpha_1, step, t_hat, m, n,
    z_max, z_pitch, phi_pitch, out,
):  # fmt: skip
    """The costs of the samples `ks` of one pixel's curve."""
    sums = np.empty(2 * half + 1, dtype=np.float32)
    for i in range(ks.size):
        out[i] = _sample_cost(
            ks[i], mode, cost, first, second, matchable_2, row, column, half, phi_1,
            alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch, sums,
        )  # fmt: skip


# -- Windows whose columns follow the epipolar map -----------------------------------------------------------------
#
# Everything is a whole number: sums come out the same in any order, and running sums never drift. Arrays are
# [column, row] or [column, sample], so that the innermost loops run along memory. Indices of those loops are unsigned:
# numba would otherwise ask of each whether it counts from the end.

FRACTION_BITS = 16
"""Rows of the second image are counted in parts of 2^-16."""
LARGEST = np.int32(4094)
"""The largest difference of two pixels."""
ABSENT = np.int16(8191)
"""Kept instead where one of the two is not there."""


@njit(cache=True, nogil=True)
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
            for k in range(k_first[column, row] - margin - k_0, k_last[column, row] + margin + 1 - k_0):
                first[column, k] = min(first[column, k], row)
                end[column, k] = row + 1


# Parts of arrays are named by indices beside the array: to slice one counts references, atomically, and the threads
# would queue for that.


@njit(cache=True, nogil=True)
def _gather(pairs, second, source, gain, offset, start, end):
    """The pixels of a column of the second image that rows start .. end are mapped to, each with the step to the next.

    A loop of its own, because the compiler works on several rows at a time only where no place is looked up.
    """
    position = np.uint32(np.uint32(offset) + np.uint32(gain) * np.uint32(start))
    for i in range(np.uint64(start), np.uint64(end)):
        pairs[i] = second[source, np.uint64(position >> np.uint32(16))]
        position = np.uint32(position + np.uint32(gain))


@njit(cache=True, nogil=True)
def _add_differences(
    total, kept, k, slot, first, column, pairs, gain, offset, image_first, image_end, start, end, absent, squared
):
    """Add one column's differences to the running sum over columns, and keep them to be taken off again."""
    for i in range(np.uint64(start), np.uint64(end)):
        row = np.int32(i)
        pair = pairs[i]
        fraction = ((np.uint32(offset) + np.uint32(gain) * np.uint32(i)) >> np.uint32(8)) & np.uint32(255)
        slope = np.int32(np.int16(pair))
        value = np.int32(pair >> np.int32(16)) + np.int32((slope * np.int32(fraction) + np.int32(128)) >> np.int32(8))
        d = np.int32(abs(np.int32(np.int32(first[column, i]) - value)))
        there = (row >= image_first) & (row < image_end) & (d <= LARGEST)
        kept[slot, k, i] = np.int16(d) if there else ABSENT
        if squared:
            total[k, i] += d * d if there else absent
        else:
            total[k, i] += d if there else absent


@njit(cache=True, nogil=True)
def _take_off(total, kept, k, slot, start, end, absent, squared):
    """Take a column's differences off the running sum."""
    for i in range(np.uint64(start), np.uint64(end)):
        d = np.int32(kept[slot, k, i])
        if squared:
            total[k, i] -= d * d if d <= LARGEST else absent
        else:
            total[k, i] -= d if d <= LARGEST else absent


@njit(cache=True, nogil=True)
def _sum_rows(sums, total, k, below, start, end, half):
    """Sums of 2 half + 1 rows, as differences of the sum so far; `below[i]` is the sum of the rows before i."""
    running = below.dtype.type(0)
    for i in range(np.uint64(start - half), np.uint64(end + half)):
        below[i] = running
        running += total[k, i]
    below[np.uint64(end + half)] = running
    upper, lower = np.uint64(half + 1), np.uint64(half)
    for i in range(np.uint64(start), np.uint64(end)):
        sums[k, i] = below[i + upper] - below[i - lower]


@njit(cache=True, nogil=True)
def _keep_least(sums, k, number, k_first, k_last, column, least, least_k, most, start, end):
    """Of the searched samples so far: the least cost, its sample (the first of equals), and the greatest cost."""
    for i in range(np.uint64(start), np.uint64(end)):
        value = sums[k, i]
        searched = (number >= k_first[column, i]) & (number <= k_last[column, i])
        better = searched & (value < least[i])
        least[i] = value if better else least[i]
        least_k[i] = number if better else least_k[i]
        most[i] = max(most[i], value) if searched else most[i]


@njit(cache=True, nogil=True, error_model="numpy")
def match_columns(
    column_first,
    column_end,
    first,
    second,
    parts,
    half,
    squared,
    unit,
    absent,
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
    k_first,
    k_last,
    searched,
    total,
    kept,
    sums,
    reach,
    reason,
    k_best,
    costs,
):
    """For each searched pixel of some columns: the best sample, and the costs of `reach` samples to both sides of it.

    first : `[width, height]`, whole numbers of 1/unit of a grey level.
    second : `[width parts, height]`, each pixel in the upper 16 bits, the step to the next row in the lower ones.
    unit, absent : the costs of one grey level, and of a pixel that is not there.
    sign, gain, offset, image_first, image_end : the columns' maps, and the rows that they map into the image.
    centre_first, centre_end : `[width, samples]`, rows of the window centres that are compared.
    row_first, row_end : rows of the windows that a column is part of.
    k_first, k_last : `[width, height]`.
    searched : `[height, width]`.
    total, sums : `[samples, height]`, zeros; sums of rows of the window, and of windows. Of a type that holds all sums.
    kept : `[2 half + 1, samples, height]`, differences of the window's columns.
    reason, k_best, costs : written; `[height, width]`, and `[height, width, 2 reach + 1]`.
    """
    width = np.uint64(first.shape[0])
    sources = np.int64(second.shape[0])
    height = total.shape[1]
    size = np.uint64(2 * half + 1)
    pairs, least_k = np.zeros(height, np.int32), np.zeros(height, np.int32)
    least, most = np.zeros(height, total.dtype), np.zeros(height, total.dtype)
    below = np.zeros(height + 1, total.dtype)
    for step in range(np.uint64(column_end - column_first + 2 * half)):
        # A column enters the window on its far side, and the one `size` before it leaves.
        entering = np.uint64(column_first + width - half + step) % width
        centre = np.uint64(entering + width - half) % width
        leaving = np.uint64(entering + width - size) % width
        slot = step % size
        compare = step >= size - 1
        least[:] = absent
        most[:] = 0
        for k in range(np.uint64(total.shape[0])):
            if step >= size and row_first[leaving, k] < row_end[leaving, k]:
                _take_off(total, kept, k, slot, row_first[leaving, k], row_end[leaving, k], absent, squared)
            start, end = row_first[entering, k], row_end[entering, k]
            if start >= end:
                continue
            number = np.int32(np.int64(k) + k_0)
            source = np.uint64((np.int64(entering) * parts + sign[entering] * number) % sources)
            image_start, image_stop = image_first[entering, k], image_end[entering, k]
            map_gain, map_offset = gain[entering, k], offset[entering, k]
            _gather(pairs, second, source, map_gain, map_offset, max(start, image_start), min(end, image_stop))
            _add_differences(
                total, kept, k, slot, first, entering, pairs, map_gain, map_offset, image_start, image_stop,
                start, end, absent, squared,
            )  # fmt: skip
            start, end = centre_first[centre, k], centre_end[centre, k]
            if compare and start < end:
                _sum_rows(sums, total, k, below, start, end, half)
                _keep_least(sums, k, number, k_first, k_last, centre, least, least_k, most, start, end)
        if not compare:
            continue
        for row in range(height):
            if searched[row, centre] and most[row] < absent:
                reason[row, centre] = OK
                k_best[row, centre] = least_k[row]
                for i in range(2 * reach + 1):
                    value = sums[least_k[row] - reach + i - k_0, row]
                    costs[row, centre, i] = value / unit if value < absent else math.nan
            else:
                if searched[row, centre]:
                    reason[row, centre] = LEAVES_IMAGE
                costs[row, centre] = math.nan


# -- Sub-pixel step ----------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def parabola_minima(costs, offset, refined):
    """The least-squares parabola a x² + b x + c through the finite samples of each row, x = 0 in the middle.

    Where its minimum lies among those samples, its place and True are written to `offset` and `refined`, both `[rows]`.
    The 3x3 normal equations are solved by Cramer's rule. Of whole numbers, or of parts of a power of two, all sums are
    exact, and so a row of equal costs has no curvature at all.
    """
    rows, samples = costs.shape
    reach = samples // 2
    all_s2, all_s4 = 0.0, 0.0
    for x in range(-reach, reach + 1):
        all_s2 += x**2
        all_s4 += x**4
    for row in range(rows):
        s0, s1, s2, s3, s4 = float(samples), 0.0, all_s2, 0.0, all_s4
        first, last = -reach, reach
        t0, t1, t2 = 0.0, 0.0, 0.0
        for i in range(samples):
            x, y = i - reach, costs[row, i]
            t0 += y
            t1 += x * y
            t2 += x * x * y
        if not math.isfinite(t0):
            s0, s1, s2, s3, s4, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            first, last = reach, -reach
            for i in range(samples):
                x, y = i - reach, costs[row, i]
                if math.isfinite(y):
                    first, last = min(first, x), x
                    s0, s1, s2, s3, s4 = s0 + 1, s1 + x, s2 + x**2, s3 + x**3, s4 + x**4
                    t0, t1, t2 = t0 + y, t1 + x * y, t2 + x * x * y
            if s0 < 3:
                continue
        # The determinant that a and b share is positive, and cancels in -b / 2a.
        a = t2 * (s2 * s0 - s1 * s1) - s3 * (t1 * s0 - s1 * t0) + s2 * (t1 * s1 - s2 * t0)
        b = s4 * (t1 * s0 - s1 * t0) - t2 * (s3 * s0 - s1 * s2) + s2 * (s3 * t0 - s2 * t1)
        if a > 0 and first <= -b / (2 * a) <= last:
            offset[row], refined[row] = -b / (2 * a), True
