"""Compiled loops over mirror pixels. `refine` prepares their arguments.

Every loop works on rows of view 1's mirror image and writes to these rows alone, so bands of rows may run side by side.
"""

import math

import numpy as np

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._projection_kernels import move
from harness.compiled import kernel
from harness.matching.slanted._agreement_kernels import (
    HIGHEST,
    LOWEST,
    OWN,
    PLANES,
    SAME,
    TILE,
    TILE_ROWS,
    compare_planes,
)
from harness.matching.slanted._sample_kernels import (
    AT_ONCE,
    GREY,
    MOTION,
    SIZE,
    SLOPE,
    U,
    V,
    W,
    X,
    Y,
    Z,
    gather_patch,
    misfit,
    move_samples,
    sample_with_slopes,
    see_samples,
    turn_samples,
)

# -- A point of view 1, in view 2 --------------------------------------------------------------------------------------


@kernel(inline=True)
def _in_view_2(x, y, z, w, R, s, camera):
    """Pixel (u, v) at which view 2 sees the point in direction (x, y, z) at inverse range w, how (u, v) changes with
    w, and whether the point is in the field.

    The point lies along q = R (x - w t) = R x + w s, s = -R t. u counts from the first of the columns that an image
    which goes round has been continued by.
    """
    model, field, seam, _ = camera
    qx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + w * s[0]
    qy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + w * s[1]
    qz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + w * s[2]
    norm = math.sqrt(qx * qx + qy * qy + qz * qz)
    u, v, u_w, v_w = move(qx, qy, qz, s[0], s[1], s[2], model)
    up, along = along_up(qx, qy, qz, field), along_axis(qx, qy, qz, field)
    return u + seam, v, u_w, v_w, field.lowest * norm <= up <= field.highest * norm and along >= field.nearest * norm


@kernel
def warp_rows(first, end, valid, x, w, R, s, camera, coefficients, known, value, slope, motion):
    """Sample view 2 for every pixel with an inverse range.

    valid : `[height, width]`, which pixels have a value. x : `[height, width, 3]`, unit directions.
    w : `[height, width]`, 1/m; NaN where it is not known.
    known, value, slope, motion : written; whether there is a sample, I_2, dI_2/dw, and (du/dw)² + (dv/dw)².
    """
    table, column = np.empty(SIZE), np.empty(AT_ONCE, np.int64)
    for i in range(first, end):
        for begin in range(0, valid.shape[1], AT_ONCE):
            n = 0
            for j in range(begin, min(begin + AT_ONCE, valid.shape[1])):
                known[i, j] = False
                if valid[i, j] and math.isfinite(w[i, j]):
                    column[n] = j
                    table[X + n], table[Y + n], table[Z + n] = x[i, j, 0], x[i, j, 1], x[i, j, 2]
                    table[W + n] = w[i, j]
                    n += 1
            turn_samples(table, n, R, s)
            move_samples(table, n, s, camera, coefficients)
            sample_with_slopes(table, n, coefficients)
            for k in range(n):
                if not math.isnan(table[GREY + k]):
                    j = column[k]
                    known[i, j] = True
                    value[i, j], slope[i, j], motion[i, j] = table[GREY + k], table[SLOPE + k], table[MOTION + k]


# -- Which plane a pixel lies on ---------------------------------------------------------------------------------------


@kernel
def choose_rows(
    first, end, half, reach, apart, centre_bonus, residual_weight, w_far, w_near, valid, x, t, R, s, camera,
    first_image, coefficients, plane, residual, gain, offset, w, chosen,
):  # fmt: skip
    """Give every pixel the plane of one of nine windows that it lies in: its own, or one moved by `half` pixels.

    Windows at the border of a surface see two of them; one of those moved does not. Where all others agree with the own
    plane, to within `apart`, that is taken. Otherwise it is the one that fits best, by a patch about the pixel and by
    its own window (weight `residual_weight`). Without a patch (`reach` < 0) only windows are compared.

    apart : radians of alpha_2. centre_bonus : factor on the score of the own window.
    w, chosen : written; the inverse range (NaN: none), and the window's flat index (-1: none).
    """
    width = valid.shape[1]
    window, w_there, score = np.empty(9, np.int64), np.empty(9), np.empty(9)
    table, size = np.empty(SIZE), float((2 * reach + 1) * (2 * reach + 1))
    planes, tile = np.empty((3, TILE + 2 * half)), np.empty(TILE_ROWS * TILE)
    for i in range(first, end):
        for j in range(width):
            if j % TILE == 0 and valid[i, j : j + TILE].any():
                compare_planes(i, j, half, apart, w_far, w_near, x, t, plane, residual, planes, tile)
            w[i, j], chosen[i, j] = math.nan, -1
            if not valid[i, j]:
                continue
            at = j % TILE
            mine, same = tile[OWN + at], tile[SAME + at]
            if max(tile[HIGHEST + at] - mine, mine - tile[LOWEST + at]) <= same:
                w[i, j], chosen[i, j] = mine, i * width + j
                continue
            n, own = 0, -1
            for k in range(9):
                value = tile[PLANES + k * TILE + at]
                if not math.isnan(value):
                    row, column = i + (k // 3 - 1) * half, j + (k % 3 - 1) * half
                    own = n if k == 4 else own
                    window[n], w_there[n] = row * width + column, value
                    score[n] = residual_weight * residual[row, column] * (centre_bonus if k == 4 else 1.0)
                    n += 1
            if n == 0:
                continue
            # Planes that agree here are tried once: the best of their windows, or the own one.
            pick, least = -1, math.inf
            untried = n
            pixels = gather_patch(i, j, reach, valid, x, first_image, table) if reach >= 0 else 0
            while untried > 0:
                k = own
                if k < 0 or untried < n:
                    k = 0
                    for other in range(1, n):
                        if score[other] < score[k]:
                            k = other
                    if score[k] >= least:
                        break
                row, column = window[k] // width, window[k] % width
                tried = score[k]
                if reach >= 0:
                    bonus = centre_bonus if k == own else 1.0
                    tried += bonus * misfit(
                        table, pixels, 0.5 * size, plane[row, column], gain[row, column], offset[row, column],
                        (least - tried) / bonus, R, s, camera, coefficients,
                    )  # fmt: skip
                if tried < least:
                    pick, least = k, tried
                for other in range(n):
                    if score[other] < math.inf and abs(w_there[other] - w_there[k]) <= same:
                        score[other] = math.inf
                        untried -= 1
            if pick < 0:
                continue
            w[i, j], chosen[i, j] = w_there[pick], window[pick]


@kernel
def judge_rows(
    first, end, valid, x, R, s, camera, first_image, known, value, slope, plane, chosen, gain, offset, score, area
):  # fmt: skip
    """What `_inflation` needs: each pixel's term of the normal equations, and how dense samples lie.

    score : written; g (I_1 - a I_2 - b), 0 where there is none.
    area : written; the area of a pixel of view 2 in pixels of view 1, on the pixel's plane; 1 where it is not known.
    """
    height, width = valid.shape
    table, column = np.empty(SIZE), np.empty(AT_ONCE, np.int64)
    for i in range(first, end):
        for begin in range(0, width, AT_ONCE):
            n = 0
            for j in range(begin, min(begin + AT_ONCE, width)):
                score[i, j], area[i, j] = 0.0, 1.0
                if not (known[i, j] and chosen[i, j] >= 0):
                    continue
                row, taken = chosen[i, j] // width, chosen[i, j] % width
                difference = first_image[i, j] - gain[row, taken] * value[i, j] - offset[row, taken]
                score[i, j] = slope[i, j] * difference
                if i + 1 < height and j + 1 < width:
                    m = plane[row, taken, 0], plane[row, taken, 1], plane[row, taken, 2]
                    _put_on_plane(table, n, x, i, j, m)
                    _put_on_plane(table, n + AT_ONCE, x, i, j + 1, m)
                    _put_on_plane(table, n + 2 * AT_ONCE, x, i + 1, j, m)
                    column[n] = j
                    n += 1
            for part in range(0, 3 * AT_ONCE if n > 0 else 0, AT_ONCE):
                see_samples(table[part:], n, R, s, camera[0])
            _put_areas(table, n, camera[3])
            for k in range(n):
                area[i, column[k]] = table[GREY + k]


@kernel
def _put_on_plane(table, k, x, i, j, m):
    """Write the point of plane m in the direction of pixel (i, j)."""
    table[X + k], table[Y + k], table[Z + k] = x[i, j, 0], x[i, j, 1], x[i, j, 2]
    table[W + k] = m[0] * x[i, j, 0] + m[1] * x[i, j, 1] + m[2] * x[i, j, 2]


@kernel
def _put_areas(table, n, turn):
    """Write areas of a pixel of view 2 in those of view 1, from where it sees a pixel, the next and the one below."""
    for k in range(n):
        u, v = table[U + k], table[V + k]
        right, below = table[U + AT_ONCE + k] - u, table[U + 2 * AT_ONCE + k] - u
        if turn > 0.0:
            right -= turn * math.floor(right / turn + 0.5)
            below -= turn * math.floor(below / turn + 0.5)
        down, along = table[V + 2 * AT_ONCE + k] - v, table[V + AT_ONCE + k] - v
        table[GREY + k] = 1.0 / abs(right * down - below * along)


# -- Into the other view -----------------------------------------------------------------------------------------------


@kernel
def transfer(valid, x, w, residual, chosen, R, s, camera, w_2, misfit_2):
    """Transfer inverse ranges to view 2's mirror pixels; of several the one whose window fits best.

    residual, chosen : of view 1's windows, and the window that each pixel takes.
    w_2, misfit_2 : `[height, width]`, NaN and infinite at first; written where a point of view 1 falls.
    """
    for i in range(valid.shape[0]):
        for j in range(valid.shape[1]):
            if not (valid[i, j] and math.isfinite(w[i, j])):
                continue
            u, v, _, _, inside = _in_view_2(x[i, j, 0], x[i, j, 1], x[i, j, 2], w[i, j], R, s, camera)
            row, column = math.floor(v + 0.5), math.floor(u + 0.5)
            if not (inside and 0 <= row < w_2.shape[0] and 0 <= column < w_2.shape[1]):
                continue
            # |x - w t| is d_2/d_1; R leaves the length as it is, and s = -R t.
            q = 0.0
            for k in range(3):
                c = R[k, 0] * x[i, j, 0] + R[k, 1] * x[i, j, 1] + R[k, 2] * x[i, j, 2] + w[i, j] * s[k]
                q += c * c
            misfit = residual[chosen[i, j] // valid.shape[1], chosen[i, j] % valid.shape[1]]
            if misfit < misfit_2[row, column]:
                w_2[row, column], misfit_2[row, column] = w[i, j] / math.sqrt(q), misfit
