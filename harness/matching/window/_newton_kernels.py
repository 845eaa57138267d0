"""Compiled Gauss-Newton steps along epipolar curves. `newton` lays out their arguments.

View 2 is a cubic B-spline, given by its coefficients. Its values and slopes in a window are made in two goes, first
between columns and then between rows, as the weights of both are products.
"""

import math

import numpy as np

from harness.camera._spline_kernels import cubic_slopes, cubic_weights
from harness.compiled import kernel
from harness.matching._matching_kernels import PHI

STEPS = 4
"""Most steps. From within half a sample, textures of the LoG's size are met to 1e-3 samples by the second or third."""
ENOUGH = 5e-3
"""A step shorter than this, in samples, is the last one: the remaining error is about a tenth of it."""


@kernel(inline=True)
def _shift(number, i1, i11, i2, i12, s, s1, s2, ss, invariant):
    """The shift that aligns the windows; NaN where the images do not determine it.

    i1, i11, i2, i12, s, s1, s2, ss : sums over the windows' `number` pixels of I_1, I_1², I_2, I_1 I_2, of the slope s
        of I_2, and of s I_1, s I_2 and s².
    invariant : least squares over shift, gain and offset of I_1; otherwise over the shift alone.
    """
    if not invariant:
        return (s1 - s2) / ss if ss > 0 else math.nan
    v11, v12, vs1, vs2 = i11 - i1 * i1 / number, i12 - i1 * i2 / number, s1 - s * i1 / number, s2 - s * i2 / number
    if not v11 > 0:
        return math.nan
    rest = ss - s * s / number - vs1 * vs1 / v11
    return (vs1 * v12 / v11 - vs2) / rest if rest > 0 else math.nan


@kernel
def refine_squares(
    rows,
    mode,
    invariant,
    farthest,
    first,
    spline,
    matched,
    usable,
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
    offset,
    refined,
):
    """Square windows that move along the curve of their middle.

    farthest : how many samples the result may lie from the best whole sample.

    first : `[height, width + 2 half]`, padded around the seam.
    spline : `[height, width + 2 half + 4]`, coefficients, padded by two more on both sides.
    usable : `[height, width]`: a window two pixels larger on all sides is valid around this pixel of view 2.
    """
    height, width = matched.shape
    size = 2 * half + 1
    number = float(size * size)
    values, slopes = np.empty((size + 3, size)), np.empty((size + 3, size))
    sums, total = np.empty((8, size)), np.empty(8)
    for row in rows:
        for column in range(width):
            if not matched[row, column]:
                continue
            k = float(k_best[row, column])
            length = step[row, column]
            good = False
            for _ in range(STEPS):
                n_x, n_y, n_z = n[row, column, 0], n[row, column, 1], n[row, column, 2]
                if mode == PHI:
                    angle = phi[column] + k * length
                    c, s = math.cos(angle), math.sin(angle)
                    z, dz, turn = -(n_x * c + n_y * s) / n_z, length * (n_x * s - n_y * c) / n_z, length
                else:
                    angle = alpha_1[row, column] + k * length
                    c, s = math.cos(angle), math.sin(angle)
                    x, dx = c * t_hat[0] + s * m[row, column, 0], c * m[row, column, 0] - s * t_hat[0]
                    y, dy = c * t_hat[1] + s * m[row, column, 1], c * m[row, column, 1] - s * t_hat[1]
                    h, dh = c * t_hat[2] + s * m[row, column, 2], c * m[row, column, 2] - s * t_hat[2]
                    radius = math.sqrt(x * x + y * y)
                    angle, turn = math.atan2(y, x), length * (x * dy - y * dx) / (radius * radius)
                    z, dz = h / radius, length * (dh - h * (x * dx + y * dy) / (radius * radius)) / radius
                v, u = (z_max - z) / z_pitch - 0.5, (angle + math.pi) / phi_pitch - 0.5
                dv, du = -dz / z_pitch, turn / phi_pitch
                good = False
                if not 0 <= v < height:
                    break
                row_2, column_2 = int(v), math.floor(u)
                across, down = cubic_weights(u - column_2), cubic_weights(v - row_2)
                across_slope, down_slope = cubic_slopes(u - column_2), cubic_slopes(v - row_2)
                column_2 %= width
                if not usable[row_2, column_2]:
                    break
                for i in range(np.uint64(size + 3)):
                    r = np.uint64(row_2 - half - 1) + i
                    for j in range(np.uint64(size)):
                        p = np.uint64(column_2 + 1) + j
                        a, b = spline[r, p], spline[r, p + np.uint64(1)]
                        d, e = spline[r, p + np.uint64(2)], spline[r, p + np.uint64(3)]
                        values[i, j] = (across[0] * a + across[1] * b) + (across[2] * d + across[3] * e)
                        slopes[i, j] = (across_slope[0] * a + across_slope[1] * b) + (
                            across_slope[2] * d + across_slope[3] * e
                        )
                sums[:] = 0
                for i in range(np.uint64(size)):
                    one, two, three = i + np.uint64(1), i + np.uint64(2), i + np.uint64(3)
                    for j in range(np.uint64(size)):
                        a, b, d, e = values[i, j], values[one, j], values[two, j], values[three, j]
                        value = (down[0] * a + down[1] * b) + (down[2] * d + down[3] * e)
                        slope = dv * ((down_slope[0] * a + down_slope[1] * b) + (down_slope[2] * d + down_slope[3] * e))
                        a, b, d, e = slopes[i, j], slopes[one, j], slopes[two, j], slopes[three, j]
                        slope += du * ((down[0] * a + down[1] * b) + (down[2] * d + down[3] * e))
                        grey_1 = np.float64(first[np.uint64(row - half) + i, np.uint64(column) + j])
                        sums[0, j] += grey_1
                        sums[1, j] += grey_1 * grey_1
                        sums[2, j] += value
                        sums[3, j] += grey_1 * value
                        sums[4, j] += slope
                        sums[5, j] += slope * grey_1
                        sums[6, j] += slope * value
                        sums[7, j] += slope * slope
                total[:] = 0
                for i in range(8):
                    for j in range(size):
                        total[i] += sums[i, j]
                move = _shift(
                    number, total[0], total[1], total[2], total[3], total[4], total[5], total[6], total[7], invariant
                )
                k += move
                good = abs(k - k_best[row, column]) <= farthest
                if not good or abs(move) < ENOUGH:
                    break
            if good:
                offset[row, column], refined[row, column] = k - k_best[row, column], True


@kernel
def refine_columns(
    rows,
    invariant,
    farthest,
    first,
    spline,
    matched,
    usable,
    half,
    sign,
    away,
    cotangent,
    lift,
    pitch,
    z_max,
    z_pitch,
    phi_pitch,
    k_best,
    offset,
    refined,
):
    """Windows whose columns follow their own maps `z_2 = g z_1 + h`, with w = k pitch the azimuth away from t.

    g = cos w + cot u sin w and h = -(t_z/|t_xy|) sin w/sin u, in a column at the azimuth u from t.

    first : `[height, width + 2 half]`, padded around the seam.
    spline : `[width + 3, height]`, coefficients by columns, with one before the first and two after the last.
    usable : `[width, height]`: whether the four by four coefficients from this one on are valid.
    sign, away, cotangent, lift : `[width]`: the sense of phi away from t, u, cot u, and -(t_z/|t_xy|)/sin u.
    """
    height, width = matched.shape
    size = 2 * half + 1
    number = float(size * size)
    values, slopes = np.empty(height), np.empty(height)
    for row in rows:
        for column in range(width):
            if not matched[row, column]:
                continue
            k = float(k_best[row, column])
            good = False
            for _ in range(STEPS):
                w = k * pitch
                c, s = math.cos(w), math.sin(w)
                columns_away = w / phi_pitch
                i1 = i11 = i2 = i12 = s0 = s1 = s2 = ss = 0.0
                good = True
                for j in range(size):
                    own_column = (column - half + j) % width
                    if not 0 < away[own_column] + w < math.pi:
                        good = False
                        break
                    gain, d_gain = c + cotangent[own_column] * s, cotangent[own_column] * c - s
                    h, dh = lift[own_column] * s, lift[own_column] * c
                    shift = ((1 - gain) * z_max - h) / z_pitch - 0.5
                    top, bottom = gain * (row - half + 0.5) + shift, gain * (row + half + 0.5) + shift
                    if not (gain > 0 and top >= 1 and bottom < height - 2):
                        good = False
                        break
                    u = own_column + sign[own_column] * columns_away
                    column_2 = math.floor(u)
                    across, across_slope = cubic_weights(u - column_2), cubic_slopes(u - column_2)
                    p = np.uint64(column_2 % width)
                    one, two, three = p + np.uint64(1), p + np.uint64(2), p + np.uint64(3)
                    for r in range(np.uint64(int(top) - 1), np.uint64(int(bottom) + 3)):
                        a, b, d, e = spline[p, r], spline[one, r], spline[two, r], spline[three, r]
                        values[r] = (across[0] * a + across[1] * b) + (across[2] * d + across[3] * e)
                        slopes[r] = (across_slope[0] * a + across_slope[1] * b) + (
                            across_slope[2] * d + across_slope[3] * e
                        )
                    du = sign[own_column] * pitch / phi_pitch
                    for i in range(size):
                        v = gain * (row - half + i + 0.5) + shift
                        dv = pitch * (d_gain * (row - half + i + 0.5) - (d_gain * z_max + dh) / z_pitch)
                        row_2 = int(v)
                        good &= usable[p, row_2]
                        down, down_slope = cubic_weights(v - row_2), cubic_slopes(v - row_2)
                        r0 = np.uint64(row_2 - 1)
                        r1, r2, r3 = r0 + np.uint64(1), r0 + np.uint64(2), r0 + np.uint64(3)
                        a, b, d, e = values[r0], values[r1], values[r2], values[r3]
                        value = (down[0] * a + down[1] * b) + (down[2] * d + down[3] * e)
                        slope = dv * ((down_slope[0] * a + down_slope[1] * b) + (down_slope[2] * d + down_slope[3] * e))
                        a, b, d, e = slopes[r0], slopes[r1], slopes[r2], slopes[r3]
                        slope += du * ((down[0] * a + down[1] * b) + (down[2] * d + down[3] * e))
                        grey_1 = np.float64(first[np.uint64(row - half + i), np.uint64(column + j)])
                        i1, i11, i2, i12 = i1 + grey_1, i11 + grey_1 * grey_1, i2 + value, i12 + grey_1 * value
                        s0, s1, s2, ss = s0 + slope, s1 + slope * grey_1, s2 + slope * value, ss + slope * slope
                if not good:
                    break
                move = _shift(number, i1, i11, i2, i12, s0, s1, s2, ss, invariant)
                k += move
                good = abs(k - k_best[row, column]) <= farthest
                if not good or abs(move) < ENOUGH:
                    break
            if good:
                offset[row, column], refined[row, column] = k - k_best[row, column], True
