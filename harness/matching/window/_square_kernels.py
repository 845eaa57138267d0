"""Compiled loops over pixels, samples and square windows. `square` lays out their arguments.

Images are padded by half a window of columns on both sides, around the seam; windows are named by their upper left
pixels in padded images. Every column of a window has a sum of its own: additions of different columns may be done at a
time, and yet each is done in one order, whatever the compiler makes of it. Windows that lie side by side in both views
share the sums of the columns that they have in common, and no result depends on which do.
"""

import math

import numpy as np

from harness.compiled import kernel
from harness.matching._matching_kernels import CENSUS, LEAVES_IMAGE, OK, PHI, SSD, ZNCC, bits_set, census_code

# -- One window against another ----------------------------------------------------------------------------------------


@kernel
def _add_up(sums, size):
    total = 0.0
    for j in range(size):
        total += sums[j]
    return total


@kernel
def _differences(squared, first, second, row_1, column_1, row_2, column_2, size, sums):
    """Sum of absolute or squared differences."""
    for j in range(size):
        sums[j] = 0.0
    for i in range(size):
        row_a, row_b = row_1 + i, row_2 + i
        if squared:
            for j in range(size):
                d = first[row_a, column_1 + j] - second[row_b, column_2 + j]
                sums[j] += d * d
        else:
            for j in range(size):
                sums[j] += abs(first[row_a, column_1 + j] - second[row_b, column_2 + j])
    return _add_up(sums, size)


@kernel
def _products(first, second, row_1, column_1, row_2, column_2, size, sums):
    """Sum of products, in double precision: most of it is taken off again."""
    for j in range(size):
        sums[j] = 0.0
    for i in range(size):
        row_a, row_b = row_1 + i, row_2 + i
        for j in range(size):
            sums[j] += np.float64(first[row_a, column_1 + j]) * np.float64(second[row_b, column_2 + j])
    return _add_up(sums, size)


@kernel
def _hamming(first, second, row_1, column_1, row_2, column_2, size):
    """How many bits of census transforms differ."""
    total = np.int64(0)
    for i in range(size):
        row_a, row_b = row_1 + i, row_2 + i
        for j in range(size):
            total += np.int64(bits_set(np.uint32(first[row_a, column_1 + j] ^ second[row_b, column_2 + j])))
    return float(total)


@kernel(inline=True)
def _one_minus_zncc(number, sum_1, spread_1, sum_2, spread_2, products):
    """A spread is n times the sum of squares less the sum squared; 0, and correlated with nothing, without contrast."""
    scale = math.sqrt(spread_1) * math.sqrt(spread_2)
    return 1 - (number * products - sum_1 * sum_2) / scale if scale > 0 else 1.0


# -- One window against those of all samples of a curve ----------------------------------------------------------------
#
# rows, columns : `[samples]`, the pixels of view 2 on which windows are centred; a row of -1 where there is none.
# values : `[samples]`, written; NaN where there is no window.


@kernel
def _costs(
    cost, first, second, codes_1, codes_2, moments_1, moments_2, row, column, half, rows, columns, count, values, sums,
    sums_32,
):  # fmt: skip
    """Costs of the first `count` samples."""
    size = np.uint64(2 * half + 1)
    row_1, column_1, reach = np.uint64(row - half), np.uint64(column), np.uint64(half)
    number = float(size * size)
    for i in range(np.uint64(count)):
        if rows[i] < 0:
            values[i] = math.nan
            continue
        row_2, column_2 = np.uint64(rows[i]) - reach, np.uint64(columns[i])
        if cost == CENSUS:
            values[i] = _hamming(codes_1, codes_2, row_1, column_1, row_2, column_2, size)
        elif cost == ZNCC:
            products = _products(first, second, row_1, column_1, row_2, column_2, size, sums)
            values[i] = _one_minus_zncc(
                number, moments_1[0, row, column], moments_1[1, row, column],
                moments_2[0, rows[i], columns[i]], moments_2[1, rows[i], columns[i]], products,
            )  # fmt: skip
        else:
            values[i] = _differences(cost == SSD, first, second, row_1, column_1, row_2, column_2, size, sums_32)


# -- Along the curves --------------------------------------------------------------------------------------------------


@kernel(inline=True)
def _curve_point(mode, k, cos_k, sin_k, start, c_1, s_1, t_hat, m, n, step):
    """Azimuth and height of sample k of a curve.

    cos_k, sin_k : of k times the length of the step.
    start, c_1, s_1 : phi_1, or alpha_1 for a curve sampled in alpha, with its cosine and sine.
    """
    if mode == PHI:
        turn = sin_k if step > 0 else -sin_k
        z = -(n[0] * (c_1 * cos_k - s_1 * turn) + n[1] * (s_1 * cos_k + c_1 * turn)) / n[2]
        return start + k * step, z
    c, s = c_1 * cos_k - s_1 * sin_k, s_1 * cos_k + c_1 * sin_k
    x, y = c * t_hat[0] + s * m[0], c * t_hat[1] + s * m[1]
    return math.atan2(y, x), (c * t_hat[2] + s * m[2]) / math.sqrt(x * x + y * y)


@kernel
def _pixels(
    k, k_0, cos_k, sin_k, mode, matchable_2, start, t_hat, m, n, step, z_max, z_pitch, phi_pitch, rows, columns, count
):
    """The pixels nearest to `count` samples from k on; row -1 where the window around one is not whole."""
    height, width = matchable_2.shape
    c_1, s_1 = math.cos(start), math.sin(start)
    for i in range(count):
        phi, z = _curve_point(mode, k + i, cos_k[k + i - k_0], sin_k[k + i - k_0], start, c_1, s_1, t_hat, m, n, step)
        row = int(min(max(math.floor((z_max - z) / z_pitch), -1.0), float(height)))
        columns[i] = math.floor((phi + math.pi) / phi_pitch) % width
        rows[i] = row if 0 <= row < height and matchable_2[row, columns[i]] else -1


# -- Many windows side by side against as many -------------------------------------------------------------------------
#
# values, rows, columns : `[samples, BLOCK]`, for the same samples k of the pixels of a block, a part of a row.

BLOCK = 128
"""Pixels of a row that are matched together: what is kept of them stays in the cache."""
_NOT_ASKED = -2


@kernel
def _column_sums(cost, first, second, codes_1, codes_2, row_1, column_1, row_2, column_2, size, many, sums, sums_32):
    """Sums down the first `many` columns of a strip as high as a window; `sums_32` of differences, else `sums`."""
    for j in range(many):
        sums[j], sums_32[j] = 0.0, 0.0
    for i in range(size):
        row_a, row_b = row_1 + i, row_2 + i
        if cost == CENSUS:
            for j in range(many):
                sums[j] += float(bits_set(np.uint32(codes_1[row_a, column_1 + j] ^ codes_2[row_b, column_2 + j])))
        elif cost == ZNCC:
            for j in range(many):
                sums[j] += np.float64(first[row_a, column_1 + j]) * np.float64(second[row_b, column_2 + j])
        elif cost == SSD:
            for j in range(many):
                d = first[row_a, column_1 + j] - second[row_b, column_2 + j]
                sums_32[j] += d * d
        else:
            for j in range(many):
                sums_32[j] += abs(first[row_a, column_1 + j] - second[row_b, column_2 + j])


@kernel
def _window_sums(sums, size, count, values):
    """Sums of `size` columns from each of the first `count` on, every one from left to right."""
    for p in range(count):
        values[p] = 0.0
    for j in range(size):
        for p in range(count):
            values[p] += sums[p + j]


@kernel
def _costs_side_by_side(
    cost, first, second, codes_1, codes_2, moments_1, moments_2, row, column, half, rows, columns, count, values, sums,
    sums_32,
):  # fmt: skip
    """Costs of one sample of `count` pixels from `column` on; nothing where none is asked for, NaN without a window."""
    size, number = np.uint64(2 * half + 1), float((2 * half + 1) ** 2)
    begin = 0
    while begin < count:
        if rows[begin] < 0:
            if rows[begin] != _NOT_ASKED:
                values[begin] = math.nan
            begin += 1
            continue
        end = begin + 1
        while end < count and rows[end] == rows[begin] and columns[end] == columns[end - 1] + 1:
            end += 1
        run = values[begin:end]
        _column_sums(
            cost, first, second, codes_1, codes_2, np.uint64(row - half), np.uint64(column + begin),
            np.uint64(rows[begin] - half), np.uint64(columns[begin]), size, np.uint64(end - begin + 2 * half), sums,
            sums_32,
        )  # fmt: skip
        if cost in (CENSUS, ZNCC):
            _window_sums(sums, size, np.uint64(end - begin), run)
        else:
            _window_sums(sums_32, size, np.uint64(end - begin), run)
        if cost == ZNCC:
            for i in range(begin, end):
                values[i] = _one_minus_zncc(
                    number, moments_1[0, row, column + i], moments_1[1, row, column + i],
                    moments_2[0, rows[i], columns[i]], moments_2[1, rows[i], columns[i]], values[i],
                )  # fmt: skip
        begin = end


@kernel
def match_rows(
    rows,
    mode,
    cost,
    first,
    second,
    codes_1,
    codes_2,
    moments_1,
    moments_2,
    searched,
    matchable_2,
    half,
    phi,
    alpha_1,
    step,
    t_hat,
    m,
    n,
    k_0,
    cos_k,
    sin_k,
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
    codes_1, codes_2 : their census transforms, padded; asked for with CENSUS alone.
    moments_1, moments_2 : `[2, height, width]`, each window's sum and spread; asked for with ZNCC alone.
    searched, matchable_2 : `[height, width]`; pixels to search for, and window centres allowed in the second image.
    cos_k, sin_k : of k times the length of a step, from k_0 on.
    reason, k_best, costs : written; `[height, width]`, and `[height, width, 2 reach + 1]`.
    """
    width = searched.shape[1]
    sums, sums_32 = np.empty(BLOCK + 2 * half), np.empty(BLOCK + 2 * half, dtype=np.float32)
    rows_k, columns_k = np.empty(cos_k.size, np.int64), np.empty(cos_k.size, np.int64)
    rows_2, columns_2 = np.empty((cos_k.size, BLOCK), np.int32), np.empty((cos_k.size, BLOCK), np.int32)
    values = np.empty((cos_k.size, BLOCK))
    begins, ends = np.zeros(BLOCK, np.int64), np.zeros(BLOCK, np.int64)  # samples of each pixel, counted from k_0
    for row in rows:
        for left in range(0, width, BLOCK):
            some = min(BLOCK, width - left)
            begin, end = cos_k.size, 0
            for i in range(some):
                column = left + i
                begins[i] = ends[i] = 0
                if not searched[row, column]:
                    continue
                k = k_first[row, column] - reach
                count = k_last[row, column] + reach + 1 - k
                _pixels(
                    k, k_0, cos_k, sin_k, mode, matchable_2, phi[column] if mode == PHI else alpha_1[row, column],
                    t_hat, m[row, column], n[row, column], step[row, column], z_max, z_pitch, phi_pitch, rows_k,
                    columns_k, count,
                )  # fmt: skip
                complete = True
                for j in range(reach, count - reach):
                    complete &= rows_k[j] >= 0
                if not complete:
                    reason[row, column] = LEAVES_IMAGE
                    continue
                reason[row, column] = OK
                begins[i], ends[i] = k - k_0, k - k_0 + count
                begin, end = min(begin, begins[i]), max(end, ends[i])
                for j in range(count):
                    rows_2[k - k_0 + j, i], columns_2[k - k_0 + j, i] = rows_k[j], columns_k[j]
            for i in range(some):
                for j in range(begin, end):
                    if not begins[i] <= j < ends[i]:
                        rows_2[j, i] = _NOT_ASKED
            for j in range(begin, end):
                _costs_side_by_side(
                    cost, first, second, codes_1, codes_2, moments_1, moments_2, row, left, half, rows_2[j],
                    columns_2[j], some, values[j], sums, sums_32,
                )  # fmt: skip
            for i in range(some):
                if begins[i] == ends[i]:
                    continue
                best = begins[i] + reach
                for j in range(best + 1, ends[i] - reach):
                    if values[j, i] < values[best, i]:
                        best = j
                k_best[row, left + i] = k_0 + best
                for j in range(2 * reach + 1):
                    costs[row, left + i, j] = values[best - reach + j, i]


@kernel
def costs_along_curve(
    k, mode, cost, first, second, codes_1, codes_2, moments_1, moments_2, matchable_2, row, column, half, start, step,
    t_hat, m, n, k_0, cos_k, sin_k, z_max, z_pitch, phi_pitch, values,
):  # fmt: skip
    """The costs of one pixel's samples from k on."""
    sums, sums_32 = np.empty(2 * half + 1), np.empty(2 * half + 1, dtype=np.float32)
    rows_2, columns_2 = np.empty(values.size, np.int64), np.empty(values.size, np.int64)
    _pixels(
        k, k_0, cos_k, sin_k, mode, matchable_2, start, t_hat, m, n, step, z_max, z_pitch, phi_pitch, rows_2, columns_2,
        values.size,
    )  # fmt: skip
    _costs(
        cost, first, second, codes_1, codes_2, moments_1, moments_2, row, column, half, rows_2, columns_2, values.size,
        values, sums, sums_32,
    )  # fmt: skip


# -- Between pixels ----------------------------------------------------------------------------------------------------


@kernel
def _interpolate(patch, second, row, column, across, down):
    """The square of view 2 whose upper left corner lies between pixels, interpolated linearly in both directions."""
    a, b = np.float32((1 - across) * (1 - down)), np.float32(across * (1 - down))
    c, d = np.float32((1 - across) * down), np.float32(across * down)
    size, one = np.uint64(patch.shape[0]), np.uint64(1)
    for i in range(size):
        r = np.uint64(row) + i
        for j in range(size):
            s = np.uint64(column) + j
            patch[i, j] = (
                a * second[r, s] + b * second[r, s + one] + c * second[r + one, s] + d * second[r + one, s + one]
            )


@kernel
def _census_of(codes, patch, reach):
    """Census codes of a patch that is larger by `reach` on all sides."""
    size = codes.shape[0]
    for row in range(size):
        for column in range(size):
            codes[row, column] = census_code(patch, row + reach, column + reach, reach, 1)


@kernel
def costs_between(
    rows,
    mode,
    cost,
    first,
    second,
    codes_1,
    moments_1,
    margin,
    matched,
    matchable_2,
    half,
    phi,
    alpha_1,
    step,
    t_hat,
    m,
    n,
    z_max,
    z_pitch,
    phi_pitch,
    k_best,
    costs,
):
    """Costs at half samples around the best ones, windows of view 2 interpolated; `[height, width, samples]`.

    second : padded by `half + margin` columns before and one more after, the margin being what a census transform
        reaches out.
    matchable_2 : centres of windows with their margins.
    """
    height, width, samples = costs.shape
    size = 2 * half + 1
    patch = np.empty((size + 2 * margin, size + 2 * margin), dtype=np.float32)
    codes = np.empty((size, size), dtype=np.int32)
    sums, sums_32 = np.empty(size), np.empty(size, dtype=np.float32)
    side, zero = np.uint64(size), np.uint64(0)
    for row in rows:
        for column in range(width):
            if not matched[row, column]:
                continue
            start = phi[column] if mode == PHI else alpha_1[row, column]
            c_1, s_1 = math.cos(start), math.sin(start)
            length = abs(step[row, column])
            for i in range(samples):
                k = k_best[row, column] + (i - samples // 2) / 2
                phi_2, z = _curve_point(
                    mode, k, math.cos(k * length), math.sin(k * length), start, c_1, s_1, t_hat, m[row, column],
                    n[row, column], step[row, column],
                )  # fmt: skip
                y, x = (z_max - z) / z_pitch - 0.5, (phi_2 + math.pi) / phi_pitch - 0.5
                if not 0 <= y < height - 1:
                    continue
                row_2, column_2 = int(y), math.floor(x)
                across, down = x - column_2, y - row_2
                column_2 %= width
                beside = (column_2 + 1) % width
                if not (
                    matchable_2[row_2, column_2]
                    and matchable_2[row_2, beside]
                    and matchable_2[row_2 + 1, column_2]
                    and matchable_2[row_2 + 1, beside]
                ):
                    continue
                _interpolate(patch, second, row_2 - half - margin, column_2, across, down)
                row_1, column_1 = np.uint64(row - half), np.uint64(column)
                if cost == CENSUS:
                    _census_of(codes, patch, margin)
                    costs[row, column, i] = _hamming(codes_1, codes, row_1, column_1, zero, zero, side)
                elif cost == ZNCC:
                    total = squares = 0.0
                    for a in range(size):
                        for b in range(size):
                            value = np.float64(patch[a, b])
                            total, squares = total + value, squares + value * value
                    spread = max(size * size * squares - total * total, 0.0)
                    costs[row, column, i] = _one_minus_zncc(
                        float(size * size), moments_1[0, row, column], moments_1[1, row, column], total,
                        spread if spread > 1e-12 * size * size * squares else 0.0,
                        _products(first, patch, row_1, column_1, zero, zero, side, sums),
                    )  # fmt: skip
                else:
                    costs[row, column, i] = _differences(
                        cost == SSD, first, patch, row_1, column_1, zero, zero, side, sums_32
                    )
