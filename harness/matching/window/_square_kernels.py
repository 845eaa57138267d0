"""Compiled loops over pixels, samples and square windows. `square` lays out their arguments.

Images are padded by half a window of columns on both sides, around the seam, and by a vector more on the right, which
no result depends on; windows are named by their upper left pixels in padded images. Every column of a window has a sum
of its own: eight columns are summed at a time, each in one order. Windows that lie side by side in both views share the
sums of the columns that they have in common, and no result depends on which do.
"""

import math

import numpy as np

from harness.compiled import kernel
from harness.matching._matching_kernels import CENSUS, LEAVES_IMAGE, OK, PHI, SSD, ZNCC, census_code
from harness.matching._vector_kernels import LANES, absolute, bits_set, doubles, load, singles, store, zeros

# -- Windows side by side ----------------------------------------------------------------------------------------------


@kernel(inline=True)
def _column_sums(cost, first, second, codes_1, codes_2, row_1, column_1, row_2, column_2, size, many, sums, sums_32):
    """Sums down at least `many` columns of a strip as high as a window: with ZNCC to `sums`, else to `sums_32`.

    Products are summed in double precision, as most of their sum is taken off again.
    """
    for j in range(np.uint64(0), many, np.uint64(LANES)):
        a, b = column_1 + j, column_2 + j
        if cost == ZNCC:
            products = zeros(np.float64)
            for i in range(size):
                products += doubles(load(first, (row_1 + i, a))) * doubles(load(second, (row_2 + i, b)))
            store(sums, (j,), products)
            continue
        total = zeros(np.float32)
        if cost == CENSUS:
            bits = zeros(np.int32)
            for i in range(size):
                bits += bits_set(load(codes_1, (row_1 + i, a)) ^ load(codes_2, (row_2 + i, b)))
            total = singles(bits)
        elif cost == SSD:
            for i in range(size):
                d = load(first, (row_1 + i, a)) - load(second, (row_2 + i, b))
                total += d * d
        else:
            for i in range(size):
                total += absolute(load(first, (row_1 + i, a)) - load(second, (row_2 + i, b)))
        store(sums_32, (j,), total)


@kernel(inline=True)
def _window_sums(cost, sums, sums_32, size, many, values, sample, begin):
    """Sums of `size` columns from each of at least the first `many` on, every one from left to right."""
    for p in range(np.uint64(0), many, np.uint64(LANES)):
        total = zeros(np.float64)
        if cost == ZNCC:
            for j in range(size):
                total += load(sums, (p + j,))
        else:
            for j in range(size):
                total += doubles(load(sums_32, (p + j,)))
        store(values, (sample, begin + p), total)


@kernel(inline=True)
def _one_minus_zncc(number, sum_1, spread_1, sum_2, spread_2, products):
    """A spread is n times the sum of squares less the sum squared; 0, and correlated with nothing, without contrast."""
    scale = math.sqrt(spread_1) * math.sqrt(spread_2)
    return 1 - (number * products - sum_1 * sum_2) / scale if scale > 0 else 1.0


@kernel
def _costs(
    cost, first, second, codes_1, codes_2, moments_1, moments_2, row, column, half, rows, columns, sample, count,
    values, sums, sums_32,
):  # fmt: skip
    """Costs of one sample of `count` pixels from `column` on: NaN without a window, any where none is asked for.

    rows, columns : `[samples, pixels]`, the pixels of view 2 on which windows are centred.
    values : `[samples, pixels + LANES]`, written.
    """
    size, number = np.uint64(2 * half + 1), float((2 * half + 1) ** 2)
    begin = 0
    while begin < count:
        if rows[sample, begin] < 0:
            values[sample, begin] = math.nan
            begin += 1
            continue
        row_2, column_2 = rows[sample, begin], columns[sample, begin]
        end = begin + 1
        while end < count and rows[sample, end] == row_2 and columns[sample, end] - end == column_2 - begin:
            end += 1
        many = np.uint64(end - begin)
        _column_sums(
            cost, first, second, codes_1, codes_2, np.uint64(row - half), np.uint64(column + begin),
            np.uint64(row_2 - half), np.uint64(column_2), size, many + size - np.uint64(1), sums, sums_32,
        )  # fmt: skip
        _window_sums(cost, sums, sums_32, size, many, values, np.uint64(sample), np.uint64(begin))
        if cost == ZNCC:
            for i in range(begin, end):
                values[sample, i] = _one_minus_zncc(
                    number, moments_1[0, row, column + i], moments_1[1, row, column + i],
                    moments_2[0, row_2, column_2 + i - begin], moments_2[1, row_2, column_2 + i - begin],
                    values[sample, i],
                )  # fmt: skip
        begin = end


# -- Along the curves --------------------------------------------------------------------------------------------------
#
# rows, columns, values : `[samples, BLOCK]`, for the same samples k of the pixels of a block, a part of a row. Samples
#     are counted from k_0.

BLOCK = 128
"""Pixels of a row that are matched together: what is kept of them stays in the cache."""
_NOT_ASKED = -2


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
def _nearest_pixels(
    mode, height, width, curves, t_hat, k_0, cos_k, sin_k, first, end, count, z_max, z_pitch, phi_pitch, rows, columns
):
    """The pixels nearest to samples first .. end of `count` curves; row -1 or `height` where that is off the image.

    curves : `[10, pixels]`: of each pixel start, c_1, s_1, m, n and step, as in `_curve_point`.
    """
    for j in range(first, end):
        for i in range(np.uint64(count)):
            phi, z = _curve_point(
                mode, k_0 + j, cos_k[j], sin_k[j], curves[0, i], curves[1, i], curves[2, i], t_hat,
                (curves[3, i], curves[4, i], curves[5, i]), (curves[6, i], curves[7, i], curves[8, i]), curves[9, i],
            )  # fmt: skip
            rows[j, i] = int(min(max(math.floor((z_max - z) / z_pitch), -1.0), float(height)))
            column = np.floor((phi + math.pi) / phi_pitch)
            columns[j, i] = int(column - width * np.floor(column / width))


@kernel
def _keep_whole(allowed_2, reach, begins, ends, begin, end, count, rows, columns, complete):
    """Mark samples that have no whole window by a row of -1, and those that no pixel asks for by `_NOT_ASKED`.

    allowed_2 : `[height + 2, width]`, centres of windows, with a row of none before the first and after the last.
    begins, ends : `[pixels]`, the samples that each of `count` pixels asks for.
    complete : `[pixels]`, written: whether it asks for any, and all but the first and last `reach` have a whole window.
        The others are left out.
    """
    some = np.uint64(count)
    for i in range(some):
        complete[i] = ends[i] > begins[i]
    for j in range(begin, end):
        for i in range(some):
            if not allowed_2[np.uint64(rows[j, i] + 1), np.uint64(columns[j, i])]:
                rows[j, i] = -1
        for i in range(some):
            complete[i] &= (rows[j, i] >= 0) | (j < begins[i] + reach) | (j >= ends[i] - reach)
    for j in range(begin, end):
        for i in range(some):
            rows[j, i] = rows[j, i] if complete[i] & (j >= begins[i]) & (j < ends[i]) else _NOT_ASKED


@kernel
def _update_least(values, sample, begins, ends, reach, count, least, best):
    """Keep, of the samples so far, each pixel's least cost and the first sample that has it."""
    for i in range(np.uint64(count)):
        value = values[sample, i]
        first = sample == begins[i] + reach
        better = first | ((sample > begins[i] + reach) & (sample < ends[i] - reach) & (value < least[i]))
        least[i], best[i] = value if better else least[i], sample if better else best[i]


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
    allowed_2,
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
    searched : `[height, width]`, pixels to search for.
    allowed_2 : `[height + 2, width]`, centres of windows in view 2; see `_keep_whole`.
    cos_k, sin_k : of k times the length of a step, from k_0 on.
    reason, k_best, costs : written; `[height, width]`, and `[height, width, 2 reach + 1]`.
    """
    height, width = searched.shape
    sums, sums_32 = np.empty(BLOCK + 2 * half + 2 * LANES), np.empty(BLOCK + 2 * half + 2 * LANES, dtype=np.float32)
    rows_2, columns_2 = np.empty((cos_k.size, BLOCK), np.int32), np.empty((cos_k.size, BLOCK), np.int32)
    values, curves = np.empty((cos_k.size, BLOCK + LANES)), np.ones((10, BLOCK))
    begins, ends = np.zeros(BLOCK, np.int64), np.zeros(BLOCK, np.int64)  # samples of each pixel, counted from k_0
    complete, least, best = np.empty(BLOCK, np.bool_), np.empty(BLOCK), np.zeros(BLOCK, np.int64)
    for row in rows:
        for left in range(0, width, BLOCK):
            some = min(BLOCK, width - left)
            begin, end = cos_k.size, 0
            for i in range(some):
                column = left + i
                begins[i] = ends[i] = 0
                if not searched[row, column]:
                    continue
                begins[i], ends[i] = k_first[row, column] - reach - k_0, k_last[row, column] + reach + 1 - k_0
                begin, end = min(begin, begins[i]), max(end, ends[i])
                start = phi[column] if mode == PHI else alpha_1[row, column]
                curves[0, i], curves[1, i], curves[2, i] = start, math.cos(start), math.sin(start)
                for j in range(3):
                    curves[3 + j, i], curves[6 + j, i] = m[row, column, j], n[row, column, j]
                curves[9, i] = step[row, column]
            _nearest_pixels(
                mode, height, width, curves, t_hat, k_0, cos_k, sin_k, begin, end, some, z_max, z_pitch, phi_pitch,
                rows_2, columns_2,
            )  # fmt: skip
            _keep_whole(allowed_2, reach, begins, ends, begin, end, some, rows_2, columns_2, complete)
            for j in range(begin, end):
                _costs(
                    cost, first, second, codes_1, codes_2, moments_1, moments_2, row, left, half, rows_2, columns_2, j,
                    some, values, sums, sums_32,
                )  # fmt: skip
                _update_least(values, j, begins, ends, reach, some, least, best)
            for i in range(some):
                if begins[i] == ends[i]:
                    continue
                if not complete[i]:
                    reason[row, left + i] = LEAVES_IMAGE
                    continue
                reason[row, left + i], k_best[row, left + i] = OK, k_0 + best[i]
                for j in range(2 * reach + 1):
                    costs[row, left + i, j] = values[best[i] - reach + j, i]


@kernel
def costs_along_curve(
    k, mode, cost, first, second, codes_1, codes_2, moments_1, moments_2, allowed_2, row, column, half, start, step,
    t_hat, m, n, k_0, cos_k, sin_k, z_max, z_pitch, phi_pitch, values,
):  # fmt: skip
    """The costs of one pixel's samples from k on."""
    height, width = allowed_2.shape[0] - 2, allowed_2.shape[1]
    sums, sums_32 = np.empty(2 * half + 1 + 2 * LANES), np.empty(2 * half + 1 + 2 * LANES, dtype=np.float32)
    rows_2, columns_2 = np.empty((cos_k.size, 1), np.int32), np.empty((cos_k.size, 1), np.int32)
    own = np.array(
        [[start], [math.cos(start)], [math.sin(start)], [m[0]], [m[1]], [m[2]], [n[0]], [n[1]], [n[2]], [step]]
    )
    begins, ends = np.array([k - k_0]), np.array([k - k_0 + values.size])
    some, complete = np.empty((cos_k.size, 1 + LANES)), np.empty(1, np.bool_)
    _nearest_pixels(
        mode, height, width, own, t_hat, k_0, cos_k, sin_k, begins[0], ends[0], 1, z_max, z_pitch, phi_pitch, rows_2,
        columns_2,
    )  # fmt: skip
    _keep_whole(allowed_2, 0, begins, ends, begins[0], ends[0], 1, rows_2, columns_2, complete)
    for j in range(begins[0], ends[0]):
        _costs(
            cost, first, second, codes_1, codes_2, moments_1, moments_2, row, column, half, rows_2, columns_2, j, 1,
            some, sums, sums_32,
        )  # fmt: skip
        values[j - begins[0]] = some[j, 0]


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
    patch = np.zeros((size + 2 * margin, size + 2 * margin + LANES), dtype=np.float32)
    codes = np.zeros((size, size + LANES), dtype=np.int32)
    sums, sums_32 = np.empty(size + 2 * LANES), np.empty(size + 2 * LANES, dtype=np.float32)
    values = np.empty((1, LANES))
    side, zero, one = np.uint64(size), np.uint64(0), np.uint64(1)
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
                if cost == CENSUS:
                    _census_of(codes, patch, margin)
                row_1, column_1 = np.uint64(row - half), np.uint64(column)
                _column_sums(
                    cost, first, patch, codes_1, codes, row_1, column_1, zero, zero, side, side, sums, sums_32
                )  # fmt: skip
                _window_sums(cost, sums, sums_32, side, one, values, zero, zero)
                if cost == ZNCC:
                    total = squares = 0.0
                    for a in range(size):
                        for b in range(size):
                            value = np.float64(patch[a, b])
                            total, squares = total + value, squares + value * value
                    spread = max(size * size * squares - total * total, 0.0)
                    values[0, 0] = _one_minus_zncc(
                        float(size * size), moments_1[0, row, column], moments_1[1, row, column], total,
                        spread if spread > 1e-12 * size * size * squares else 0.0, values[0, 0],
                    )  # fmt: skip
                costs[row, column, i] = values[0, 0]
