"""Compiled loops over tiles that may leave their epipolar planes. `harness.motion.across` lays out their arguments.

As in `_direct_kernels` a tile of view 1 has a plane, w = m · x. Its points lie along q = R p of view 2, p = x - w t;
here all of them are turned by a small angle about an axis of their own, which takes them across the epipolar plane.
"""

import math

from harness.camera._projection_kernels import move, project
from harness.camera._spline_kernels import cubic_spline
from harness.compiled import kernel

PARAMETERS = 6
"""Unknowns of a tile: the angle across, m (3), a, b."""


@kernel(inline=True)
def _turned(R, p0, p1, p2):
    return (
        R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2,
        R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2,
        R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2,
    )


@kernel
def equations_across(
    tiles, side, least, known, x, grey, R, t, axis, camera, coefficients, planes, gain, offset, weights, H, g, sums,
    parts, residuals,
):  # fmt: skip
    """Write the normal equations of every tile, for I_1 = a I_2 + b.

    R : `[T, 3, 3]`, the rotation into view 2 with each tile's own turn. axis : `[T, 3]`, what it is turned about, in
    view 1's orientation. weights : `[T, 6]`, of the columns of J in `parts`.
    H, g : `[T, 6, 6]` and `[T, 6]`: sums of J^T J (upper triangle) and J^T r over the tile's pixels.
    sums : `[T, 4]`: the number of pixels, r², I_1 and I_1².
    parts, residuals : `[T, side, side]`: J · weights and r of each pixel, 0 for those that do not count.
    """
    model, seam = camera
    column = [0.0] * PARAMETERS
    for i in range(tiles.shape[0]):
        m, a, b, turn, c = planes[i], gain[i], offset[i], R[i], axis[i]
        s0, s1, s2 = _turned(turn, -t[0], -t[1], -t[2])
        H[i, :, :] = 0.0
        g[i, :] = 0.0
        sums[i, :] = 0.0
        parts[i, :, :] = 0.0
        residuals[i, :, :] = 0.0
        for row in range(tiles[i, 0], tiles[i, 0] + side):
            for col in range(tiles[i, 1], tiles[i, 1] + side):
                if not known[row, col]:
                    continue
                d = x[row, col]
                w = m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
                if not w >= least:
                    continue
                p0, p1, p2 = d[0] - w * t[0], d[1] - w * t[1], d[2] - w * t[2]
                q0, q1, q2 = _turned(turn, p0, p1, p2)
                _, _, inside = project(q0, q1, q2, model)
                if not inside:
                    continue
                e0, e1, e2 = _turned(turn, c[1] * p2 - c[2] * p1, c[2] * p0 - c[0] * p2, c[0] * p1 - c[1] * p0)
                u, v, u_across, v_across = move(q0, q1, q2, e0, e1, e2, model)
                _, _, u_w, v_w = move(q0, q1, q2, s0, s1, s2, model)
                other, i_u, i_v = cubic_spline(coefficients, u + seam, v)
                if math.isnan(other):
                    continue
                along = a * (i_u * u_w + i_v * v_w)
                column[0] = a * (i_u * u_across + i_v * v_across)
                column[1], column[2], column[3] = along * d[0], along * d[1], along * d[2]
                column[4], column[5] = other, 1.0
                value = grey[row, col]
                r = value - a * other - b
                part = 0.0
                for j in range(PARAMETERS):
                    part += weights[i, j] * column[j]
                    g[i, j] += column[j] * r
                    for k in range(j, PARAMETERS):
                        H[i, j, k] += column[j] * column[k]
                sums[i, 0] += 1.0
                sums[i, 1] += r * r
                sums[i, 2] += value
                sums[i, 3] += value * value
                parts[i, row - tiles[i, 0], col - tiles[i, 1]] = part
                residuals[i, row - tiles[i, 0], col - tiles[i, 1]] = r
