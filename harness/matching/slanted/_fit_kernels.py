"""Compiled loops that fit planes to windows. `field` prepares their arguments.

Sums over windows and what follows from them are loops over columns without branches, one quantity at a time, which
compilers turn into vector instructions; a tile of the row at a time, so that all of it stays in the processor's cache.
"""

import math
from typing import NamedTuple

import numpy as np

from harness.compiled import kernel
from harness.matching._vector_kernels import LANES, from_1, from_2, from_4, load, store, zeros

TILE = 64
"""Columns whose planes are fitted side by side."""

SCATTERED = 1.2
"""The mean square of a window's noise is mostly less than so many times its variance: over 11² or 17² pixels it has a
standard deviation of 0.13 or 0.08 of itself."""


class FitNoise(NamedTuple):
    """What is known of white noise, of which a view's pixel has the variance n_1 or n_2."""

    of_value: float
    """Variance of noise of variance 1 along an axis, once view 2 is interpolated."""
    of_slope: float
    """That of its slope."""
    ratio: float
    """n_1/n_2."""
    gain_squared: float
    """The square of the gain between the whole images."""
    excess_1: float
    """n_1 - gain_squared n_2, or 0 if that is negative."""
    excess_2: float
    """gain_squared n_2 - n_1, or 0 if that is negative."""
    least_variance: float
    """The variance above which a window has texture."""


# -- Sums over windows -------------------------------------------------------------------------------------------------

ONE, I_1, I_2, H, GX, GY, GZ, MOTION, G = 0, 1, 2, 3, 4, 5, 6, 7, 8
FACTORS = 9
"""What a pixel adds to its windows' sums is a product of two of these: 1, I_1, I_2, h = I_2 - g w, g x, and
(du/dw)² + (dv/dw)². With h, the warped image is h + g (m·x) for any plane m."""

XX, XY, XZ, YY, YZ, ZZ, X, Y, Z, X_1, Y_1, Z_1, X_H, Y_H, Z_H = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14
S_1, S_11, S_H, S_HH, S_1H, N, S_2, S_22, MOVED, X_2, Y_2, Z_2 = 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26
SUMS = 27
"""The sums that the normal equations of a window are made of, of products of two factors; see `_replace`."""


@kernel
def _where(known, values, factors, k):
    """Write a factor, 0 where it is not known."""
    out = factors[k]
    for j in range(known.shape[0]):
        out[j] = values[j] if known[j] else 0.0


@kernel
def _times(x, axis, factors, k):
    """Write g x along an axis."""
    g, out = factors[G], factors[k]
    for j in range(x.shape[0]):
        out[j] = g[j] * x[j, axis]


@kernel
def _warped_at_0(known, value, w, factors):
    """Write h = I_2 - g w."""
    g, out = factors[G], factors[H]
    for j in range(known.shape[0]):
        out[j] = value[j] - g[j] * w[j] if known[j] else 0.0


@kernel
def _factors_of(i, known, x, w, first_image, value, slope, motion, factors):
    """Write the factors of a row of pixels, all 0 where there is no sample."""
    there = known[i]
    _where(there, there, factors, ONE)
    _where(there, first_image[i], factors, I_1)
    _where(there, value[i], factors, I_2)
    _where(there, motion[i], factors, MOTION)
    _where(there, slope[i], factors, G)
    _warped_at_0(there, value[i], w[i], factors)
    for axis in range(3):
        _times(x[i], axis, factors, GX + axis)


@kernel(inline=True)
def _add(sums, k, at, change):
    """Add eight numbers to the sums of as many columns."""
    store(sums, (k, at), load(sums, (k, at)) + change)


@kernel
def _replace(sums, half, new, old):
    """Add the products of a row of pixels to the sums of their columns, and take those of another off.

    The factors of eight columns are loaded once, for all products.
    """
    for j in range(0, new.shape[1], LANES):
        at = half + j
        n_x, o_x = load(new, (GX, j)), load(old, (GX, j))
        n_y, o_y = load(new, (GY, j)), load(old, (GY, j))
        n_z, o_z = load(new, (GZ, j)), load(old, (GZ, j))
        n_1, o_1 = load(new, (I_1, j)), load(old, (I_1, j))
        n_2, o_2 = load(new, (I_2, j)), load(old, (I_2, j))
        n_h, o_h = load(new, (H, j)), load(old, (H, j))
        n_one, o_one = load(new, (ONE, j)), load(old, (ONE, j))
        n_m, o_m = load(new, (MOTION, j)), load(old, (MOTION, j))
        _add(sums, XX, at, n_x * n_x - o_x * o_x)
        _add(sums, XY, at, n_x * n_y - o_x * o_y)
        _add(sums, XZ, at, n_x * n_z - o_x * o_z)
        _add(sums, YY, at, n_y * n_y - o_y * o_y)
        _add(sums, YZ, at, n_y * n_z - o_y * o_z)
        _add(sums, ZZ, at, n_z * n_z - o_z * o_z)
        _add(sums, X, at, n_x - o_x)
        _add(sums, Y, at, n_y - o_y)
        _add(sums, Z, at, n_z - o_z)
        _add(sums, X_1, at, n_x * n_1 - o_x * o_1)
        _add(sums, Y_1, at, n_y * n_1 - o_y * o_1)
        _add(sums, Z_1, at, n_z * n_1 - o_z * o_1)
        _add(sums, X_H, at, n_x * n_h - o_x * o_h)
        _add(sums, Y_H, at, n_y * n_h - o_y * o_h)
        _add(sums, Z_H, at, n_z * n_h - o_z * o_h)
        _add(sums, S_1, at, n_1 - o_1)
        _add(sums, S_11, at, n_1 * n_1 - o_1 * o_1)
        _add(sums, S_H, at, n_h - o_h)
        _add(sums, S_HH, at, n_h * n_h - o_h * o_h)
        _add(sums, S_1H, at, n_1 * n_h - o_1 * o_h)
        _add(sums, N, at, n_one - o_one)
        _add(sums, S_2, at, n_2 - o_2)
        _add(sums, S_22, at, n_2 * n_2 - o_2 * o_2)
        _add(sums, MOVED, at, n_m - o_m)
        _add(sums, X_2, at, n_x * n_2 - o_x * o_2)
        _add(sums, Y_2, at, n_y * n_2 - o_y * o_2)
        _add(sums, Z_2, at, n_z * n_2 - o_z * o_2)


@kernel
def _sum_over_columns(sums, begin, size, eights, tile):
    """Write the sums over `size` neighbouring columns, from each of a tile's columns on.

    sums : `[SUMS, columns]`. eights : `[TILE + size]`, scratch: sums over eight columns, which those over more are made
    of. They are made of sums over four, and these over two, without a look at memory between.
    tile : `[ROWS * TILE]`, its first rows are written.
    """
    last, left = begin + size // LANES * LANES, size % LANES
    for k in range(SUMS):
        one, after = load(sums, (k, begin + LANES)), load(sums, (k, begin + 2 * LANES))
        two, two_after = load(sums, (k, begin)), one + from_1(one, after)
        two += from_1(two, one)
        four = two + from_2(two, two_after)
        for j in range(0, TILE + size - 2 * LANES + 1, LANES):
            one, two, after = after, two_after, load(sums, (k, begin + j + 3 * LANES))
            two_after = one + from_1(one, after)
            four_after = two + from_2(two, two_after)
            store(eights, (j,), four + from_4(four, four_after))
            four = four_after
        for j in range(0, TILE, LANES):
            total = zeros(np.float64)
            for shift in range(0, size - LANES + 1, LANES):
                total += load(eights, (j + shift,))
            for column in range(last + j, last + j + left):
                total += load(sums, (k, column))
            store(tile, (k * TILE + j,), total)


# -- Planes ------------------------------------------------------------------------------------------------------------

DIRECTION = SUMS
PLANE = DIRECTION + 3
COVARIANCE = PLANE + 3
RESIDUAL = COVARIANCE + 6
GAIN, OFFSET, SHARE = RESIDUAL + 1, RESIDUAL + 2, RESIDUAL + 3
ROWS = RESIDUAL + 4
"""Rows of a tile: sums of windows, their directions, and what is fitted."""


@kernel
def _fit(tile, least, slope_weight, far, noise_of):
    """The planes of a tile's windows, by least squares in the value at x and the slopes along two tangents.

    I_1 = a (h + g m·x_i) + b: the offset b goes by taking means off, and the gain a is the ratio of the standard
    deviations. A regression would put a below 1 for the noise of I_2; the ratio treats both views alike. Of views that
    are not equally noisy the less noisy one counts as if it had the other's noise, too: its own would put a above 1 or
    below, and to take the other's off leaves nothing to rely on where there is little else.

    The residual is the noise of both views, as one is to the other. Where it exceeds the noise by which one of them is
    noisier, and what that one scatters by, the rest is something else, such as a wrong plane, and is put down to both
    alike.

    With `far` the plane lies 1 + f times as far from the field as the solution does, f being the noise's share.

    noise_of : a `FitNoise`.

    tile : `[ROWS * TILE]`, row after row; distances known when this is compiled show that columns do not depend on one
    another. Written: m; the inverse normal matrix in x's tangent coordinates, upper triangle by rows; the variance of
    the residual, infinite where there is no plane; a; b; and the noise's share in the sum of g².
    """
    of_value, of_slope, ratio, gain_squared, excess_1, excess_2, least_variance = noise_of
    more_2 = excess_2 * of_value * of_value
    for j in range(TILE):
        x, y, z = tile[DIRECTION * TILE + j], tile[(DIRECTION + 1) * TILE + j], tile[(DIRECTION + 2) * TILE + j]
        gx, gy, gz = tile[X * TILE + j], tile[Y * TILE + j], tile[Z * TILE + j]
        sum_1, sum_h, sum_2 = tile[S_1 * TILE + j], tile[S_H * TILE + j], tile[S_2 * TILE + j]
        gx_1, gy_1, gz_1 = tile[X_1 * TILE + j], tile[Y_1 * TILE + j], tile[Z_1 * TILE + j]
        n = tile[N * TILE + j]
        per_n = 1.0 / n
        variance_1 = tile[S_11 * TILE + j] - sum_1 * sum_1 * per_n
        variance_2 = tile[S_22 * TILE + j] - sum_2 * sum_2 * per_n
        a = math.sqrt((variance_1 + n * more_2) / (variance_2 + n * excess_1 / gain_squared))
        mean = sum_1 - a * sum_h
        xx, xy = tile[XX * TILE + j] - gx * gx * per_n, tile[XY * TILE + j] - gx * gy * per_n
        xz, yy = tile[XZ * TILE + j] - gx * gz * per_n, tile[YY * TILE + j] - gy * gy * per_n
        yz, zz = tile[YZ * TILE + j] - gy * gz * per_n, tile[ZZ * TILE + j] - gz * gz * per_n
        right_x = a * (gx_1 - a * tile[X_H * TILE + j] - gx * mean * per_n)
        right_y = a * (gy_1 - a * tile[Y_H * TILE + j] - gy * mean * per_n)
        right_z = a * (gz_1 - a * tile[Z_H * TILE + j] - gz * mean * per_n)
        total = tile[S_11 * TILE + j] - 2.0 * a * tile[S_1H * TILE + j] + a * a * tile[S_HH * TILE + j]
        total -= mean * mean * per_n

        # Tangents at x: along the parallel, e = (-sin phi, cos phi, 0), and along the meridian, f = x × e.
        cosine = math.sqrt(x * x + y * y)
        off_axis = cosine > 1e-9
        per_cosine = 1.0 / cosine
        e_x, e_y = -y * per_cosine if off_axis else 0.0, x * per_cosine if off_axis else 1.0
        f_x, f_y, f_z = -z * e_y, z * e_x, x * e_y - y * e_x
        # Rows of the normal matrix times each of the three vectors.
        px, py, pz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
        ex, ey, ez = xx * e_x + xy * e_y, xy * e_x + yy * e_y, xz * e_x + yz * e_y
        fx, fy, fz = xx * f_x + xy * f_y + xz * f_z, xy * f_x + yy * f_y + yz * f_z, xz * f_x + yz * f_y + zz * f_z
        scale = a * a
        ridge = slope_weight * variance_1 * per_n
        m00 = scale * (px * x + py * y + pz * z)
        m01, m02 = scale * (px * e_x + py * e_y), scale * (px * f_x + py * f_y + pz * f_z)
        m11, m12 = scale * (ex * e_x + ey * e_y) + ridge, scale * (ex * f_x + ey * f_y + ez * f_z)
        m22 = scale * (fx * f_x + fy * f_y + fz * f_z) + ridge
        c00, c01, c02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
        c11, c12, c22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
        determinant = m00 * c00 + m01 * c01 + m02 * c02
        ok = (n >= least) & (variance_1 > least_variance * n) & (variance_2 > least_variance * n)
        ok &= determinant > 1e-12 * m00 * m11 * m22

        inverse = 1.0 / determinant
        y0 = right_x * x + right_y * y + right_z * z
        y1, y2 = right_x * e_x + right_y * e_y, right_x * f_x + right_y * f_y + right_z * f_z
        p0 = (c00 * y0 + c01 * y1 + c02 * y2) * inverse
        p1 = (c01 * y0 + c11 * y1 + c12 * y2) * inverse
        p2 = (c02 * y0 + c12 * y1 + c22 * y2) * inverse
        squares = total - (p0 * y0 + p1 * y1 + p2 * y2)
        residual = max(0.0, squares) / (n - 5.0)
        interpolated = scale * of_value * of_value
        alike = 1.0 / (gain_squared + interpolated)
        noise = max(residual / (ratio + interpolated), (residual - SCATTERED * excess_1) * alike)
        noise = min(noise, (residual + SCATTERED * excess_2) * alike)
        noise *= of_value * of_slope * tile[MOVED * TILE + j]
        noise /= tile[XX * TILE + j] + tile[YY * TILE + j] + tile[ZZ * TILE + j]
        # Twice the covariance of I_1 and a I_2. Where they correlate by less than 3/sqrt(n), they may well have
        # nothing in common.
        twice = variance_1 + scale * variance_2 - residual * (n - 5.0)
        in_common = (twice > 0.0) & (twice * twice >= 36.0 * per_n * scale * variance_1 * variance_2)
        share = noise if in_common & (noise < 1.0) else 1.0
        if far:
            # The step from the field is least squares of I_1 - a I_2 - b alone.
            left = (sum_1 - a * sum_2) * per_n
            more = share * a if in_common else 0.0
            right_x = more * (gx_1 - a * tile[X_2 * TILE + j] - gx * left)
            right_y = more * (gy_1 - a * tile[Y_2 * TILE + j] - gy * left)
            right_z = more * (gz_1 - a * tile[Z_2 * TILE + j] - gz * left)
            y0 = right_x * x + right_y * y + right_z * z
            y1, y2 = right_x * e_x + right_y * e_y, right_x * f_x + right_y * f_y + right_z * f_z
            p0 += (c00 * y0 + c01 * y1 + c02 * y2) * inverse
            p1 += (c01 * y0 + c11 * y1 + c12 * y2) * inverse
            p2 += (c02 * y0 + c12 * y1 + c22 * y2) * inverse
        m_x, m_y, m_z = p0 * x + p1 * e_x + p2 * f_x, p0 * y + p1 * e_y + p2 * f_y, p0 * z + p2 * f_z
        b = (mean - a * (gx * m_x + gy * m_y + gz * m_z)) * per_n
        tile[PLANE * TILE + j] = m_x if ok else 0.0
        tile[(PLANE + 1) * TILE + j] = m_y if ok else 0.0
        tile[(PLANE + 2) * TILE + j] = m_z if ok else 0.0
        tile[COVARIANCE * TILE + j] = c00 * inverse if ok else 0.0
        tile[(COVARIANCE + 1) * TILE + j] = c01 * inverse if ok else 0.0
        tile[(COVARIANCE + 2) * TILE + j] = c02 * inverse if ok else 0.0
        tile[(COVARIANCE + 3) * TILE + j] = c11 * inverse if ok else 0.0
        tile[(COVARIANCE + 4) * TILE + j] = c12 * inverse if ok else 0.0
        tile[(COVARIANCE + 5) * TILE + j] = c22 * inverse if ok else 0.0
        tile[RESIDUAL * TILE + j] = residual if ok else math.inf
        tile[GAIN * TILE + j] = a if ok else 1.0
        tile[OFFSET * TILE + j] = b if ok else 0.0
        tile[SHARE * TILE + j] = share if ok else 1.0


@kernel
def fit_rows(
    first, end, half, least, slope_weight, far, noise_of, valid, x, w, first_image, known, value, slope, motion,
    plane, covariance, residual, gain, offset, share,
):  # fmt: skip
    """Fit a plane to the window of (2 half + 1)² mirror pixels about every pixel.

    least : samples that a window needs.
    slope_weight : of the prior that slopes are near 0, (1/(1/m per radian))² per window's variance in grey levels.
    far, noise_of : whether to go beyond the solution, and a `FitNoise`; see `_fit`.
    plane, covariance, residual, gain, offset, share : written; `[height, width, 3]`, `[..., 6]` (nothing where it has
    no pixels) and `[...]`: see `_fit`.
    """
    height, width = valid.shape
    tiles, size = (width + TILE - 1) // TILE, 2 * half + 1
    # Column j is `sums[:, half + j]`; a border of windows is 0. Vectors may begin at any column of a window.
    sums = np.zeros((SUMS, tiles * TILE + 2 * half + 3 * LANES))
    new, old = np.zeros((FACTORS, tiles * TILE)), np.zeros((FACTORS, tiles * TILE))
    tile, eights = np.zeros(ROWS * TILE), np.empty(TILE + size)
    for i in range(first - 2 * half, end):
        incoming, outgoing = i + half, i - half - 1
        if 0 <= incoming < height:
            _factors_of(incoming, known, x, w, first_image, value, slope, motion, new)
        else:
            new[:] = 0.0
        if outgoing >= max(0, first - half):
            _factors_of(outgoing, known, x, w, first_image, value, slope, motion, old)
        _replace(sums, half, new, old)
        if i < first:
            continue
        for begin in range(0, width, TILE):
            n = min(TILE, width - begin)
            if not valid[i, begin : begin + n].any():
                residual[i, begin : begin + n] = math.inf
                continue
            _sum_over_columns(sums, begin, size, eights, tile)
            for j in range(n):
                for axis in range(3):
                    tile[(DIRECTION + axis) * TILE + j] = x[i, begin + j, axis]
            _fit(tile, least, slope_weight, far, noise_of)
            for j in range(n):
                column = begin + j
                for axis in range(3):
                    plane[i, column, axis] = tile[(PLANE + axis) * TILE + j]
                residual[i, column] = tile[RESIDUAL * TILE + j] if valid[i, column] else math.inf
                gain[i, column], offset[i, column] = tile[GAIN * TILE + j], tile[OFFSET * TILE + j]
                share[i, column] = tile[SHARE * TILE + j]
            if covariance.shape[0] > 0:
                for k in range(6):
                    for j in range(n):
                        covariance[i, begin + j, k] = tile[(COVARIANCE + k) * TILE + j]
