"""Compiled loops over tiles of view 1's image. `harness.motion.direct` lays out their arguments.

A tile is a square of pixels with a plane of its own: inverse range w = m · x, in units of 1/|t|. Its point in direction
x of view 1 lies along q = R p of view 2, p = x - w t; there view 2 has a I_2 + b of view 1's grey level.
"""

import math

from harness.camera._projection_kernels import move, project
from harness.camera._spline_kernels import cubic_spline
from harness.compiled import kernel

GEOMETRIC = 9
PARAMETERS = 11
"""Parameters of a tile: omega (3), t (3), m (3), a, b."""


@kernel(inline=True)
def _turned(R, p0, p1, p2):
    return (
        R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2,
        R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2,
        R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2,
    )


@kernel
def sampled(x, w, R, t, camera, coefficients):
    """View 2's grey level of a point; NaN outside its field."""
    model, seam = camera
    q0, q1, q2 = _turned(R, x[0] - w * t[0], x[1] - w * t[1], x[2] - w * t[2])
    u, v, inside = project(q0, q1, q2, model)
    if not inside:
        return math.nan
    grey, _, _ = cubic_spline(coefficients, u + seam, v)
    return grey


@kernel(inline=True)
def added(n, s_1, s_2, s_11, s_22, s_12, a, b):
    """The number of pairs, and the sums of a, b, a², b² and a b, with one more pair: what a correlation is made of."""
    return n + 1.0, s_1 + a, s_2 + b, s_11 + a * a, s_22 + b * b, s_12 + a * b


@kernel
def try_planes(tiles, side, stride, least, view, x, grey, R, t, camera, coefficients, planes, share, best, score):
    """Write for each tile the candidate plane whose grey levels in view 2 correlate best with view 1's.

    tiles : `[T, 2]`, row and column of the first pixel. stride : step between the pixels that are compared.
    planes : `[T, K, 3]`; NaN for none. least, share : the least w, and the least share of visible pixels.
    best, score : `[T, 3]` and `[T]`, written where a plane has a better correlation than `score`.
    """
    for i in range(tiles.shape[0]):
        for k in range(planes.shape[1]):
            m = planes[i, k]
            if math.isnan(m[0]):
                continue
            n = s_1 = s_2 = s_11 = s_22 = s_12 = 0.0
            all_pixels = 0.0
            for row in range(tiles[i, 0], tiles[i, 0] + side, stride):
                for column in range(tiles[i, 1], tiles[i, 1] + side, stride):
                    all_pixels += 1.0
                    if not view[row, column]:
                        continue
                    d = x[row, column]
                    w = m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
                    if w < least:
                        continue
                    other = sampled(d, w, R, t, camera, coefficients)
                    if math.isnan(other):
                        continue
                    value = grey[row, column]
                    n, s_1, s_2, s_11, s_22, s_12 = added(n, s_1, s_2, s_11, s_22, s_12, value, other)
            if n < share * all_pixels:
                continue
            v_1, v_2, v_12 = s_11 - s_1 * s_1 / n, s_22 - s_2 * s_2 / n, s_12 - s_1 * s_2 / n
            correlation = v_12 / math.sqrt(v_1 * v_2 + 1e-12)
            if correlation > score[i]:
                score[i] = correlation
                best[i] = m


@kernel
def normal_equations(
    tiles, side, least, view, x, grey, R, t, camera, coefficients, planes, gain, offset, H, N, g, sums
):  # fmt: skip
    """Write the normal equations of every tile, for I_1 = a I_2 + b at the planes, gains and offsets given.

    H, g : `[T, 11, 11]` and `[T, 11]`: sums of J^T J (upper triangle) and J^T r over the tile's pixels; J has columns
    for omega (of R exp([omega]×)), t, m, a and b.
    N : `[T, 9, 9]`: the block of H of the first nine for a gradient of covariance 1/a² (upper triangle).
    sums : `[T, 4]`: the number of pixels, r², I_1 and I_1².
    """
    model, seam = camera
    column, along_u, along_v = [0.0] * PARAMETERS, [0.0] * GEOMETRIC, [0.0] * GEOMETRIC
    for i in range(tiles.shape[0]):
        m, a, b = planes[i], gain[i], offset[i]
        H[i, :, :] = 0.0
        N[i, :, :] = 0.0
        g[i, :] = 0.0
        sums[i, :] = 0.0
        for row in range(tiles[i, 0], tiles[i, 0] + side):
            for col in range(tiles[i, 1], tiles[i, 1] + side):
                if not view[row, col]:
                    continue
                d = x[row, col]
                w = m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
                if not w >= least:
                    continue
                p0, p1, p2 = d[0] - w * t[0], d[1] - w * t[1], d[2] - w * t[2]
                q0, q1, q2 = _turned(R, p0, p1, p2)
                _, _, inside = project(q0, q1, q2, model)
                if not inside:
                    continue
                # The derivative of (u, v) as q moves along R e_k.
                u, v, u0, v0 = move(q0, q1, q2, R[0, 0], R[1, 0], R[2, 0], model)
                _, _, u1, v1 = move(q0, q1, q2, R[0, 1], R[1, 1], R[2, 1], model)
                _, _, u2, v2 = move(q0, q1, q2, R[0, 2], R[1, 2], R[2, 2], model)
                other, i_u, i_v = cubic_spline(coefficients, u + seam, v)
                if math.isnan(other):
                    continue
                for part in range(2):
                    e0, e1, e2 = (u0, u1, u2) if part == 0 else (v0, v1, v2)
                    into = along_u if part == 0 else along_v
                    into[0] = p1 * e2 - p2 * e1
                    into[1] = p2 * e0 - p0 * e2
                    into[2] = p0 * e1 - p1 * e0
                    into[3], into[4], into[5] = -w * e0, -w * e1, -w * e2
                    slope = -(e0 * t[0] + e1 * t[1] + e2 * t[2])
                    into[6], into[7], into[8] = slope * d[0], slope * d[1], slope * d[2]
                for j in range(GEOMETRIC):
                    column[j] = a * (i_u * along_u[j] + i_v * along_v[j])
                column[9], column[10] = other, 1.0
                value = grey[row, col]
                r = value - a * other - b
                for j in range(PARAMETERS):
                    g[i, j] += column[j] * r
                    for k in range(j, PARAMETERS):
                        H[i, j, k] += column[j] * column[k]
                for j in range(GEOMETRIC):
                    for k in range(j, GEOMETRIC):
                        N[i, j, k] += along_u[j] * along_u[k] + along_v[j] * along_v[k]
                sums[i, 0] += 1.0
                sums[i, 1] += r * r
                sums[i, 2] += value
                sums[i, 3] += value * value
