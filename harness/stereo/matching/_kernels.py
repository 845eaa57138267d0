"""Compiled loop over pixels, samples and windows. Called through `window`, which prepares and checks the arguments."""

import math

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
    return int(row), int(math.floor((phi + math.pi) / phi_pitch)) % width


# Only the order of additions is left to the compiler, so that it may add several pixels of a window at a time.
@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz"})
def _window_cost(cost, first, second, row_1, column_1, row_2, column_2, half):
    """Dissimilarity of two square windows. The images are padded by `half` columns on both sides, around the seam."""
    total = 0.0
    size = 2 * half + 1
    for i in range(-half, half + 1):
        a = first[row_1 + i, column_1 : column_1 + size]
        b = second[row_2 + i, column_2 : column_2 + size]
        part = 0.0
        if cost == SAD:
            for j in range(size):
                part += abs(a[j] - b[j])
        else:
            for j in range(size):
                part += (a[j] - b[j]) * (a[j] - b[j])
        total += part
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _sample_cost(
    k, mode, cost, first, second, matchable_2, row, column, half, phi_1, alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch
):
    """Cost of sample k, NaN where the window of the second image is not all there."""
    height, width = matchable_2.shape
    row_2, column_2 = _pixel_of_sample(
        mode, k, phi_1, alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch, width
    )
    if row_2 < 0 or row_2 >= height or not matchable_2[row_2, column_2]:
        return math.nan
    return _window_cost(cost, first, second, row, column, row_2, column_2, half)


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
                    z_max, z_pitch, phi_pitch,
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
                    z_max, z_pitch, phi_pitch,
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def costs_along_curve(
    ks, mode, cost, first, second, matchable_2, row, column, half, phi_1, alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch, out
):
    """The costs of the samples `ks` of one pixel's curve."""
    for i in range(ks.size):
        out[i] = _sample_cost(
            ks[i], mode, cost, first, second, matchable_2, row, column, half, phi_1,
            alpha_1, step, t_hat, m, n, z_max, z_pitch, phi_pitch,
        )  # fmt: skip
