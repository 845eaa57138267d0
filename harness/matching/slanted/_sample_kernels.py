"""Compiled samples of view 2 at many points at a time.

Samples are the columns of a table, kept row after row in one array. Its rows lie as far apart as a constant says, so
that compilers see that samples do not depend on one another, and work out several at once in vector instructions.
"""

import math

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._projection_kernels import move
from harness.camera._spline_kernels import cubic_slopes, cubic_weights
from harness.compiled import kernel
from harness.matching._vector_kernels import doubles, load_four, numbers, times

SAMPLES = 968
"""Room for samples: those of the largest patch, 31² pixels, and no power of two, which would crowd the cache."""
AT_ONCE = 64
"""Samples that fit into the fastest cache."""
QX, QY, QZ = 0, 1 * SAMPLES, 2 * SAMPLES
"""Direction of the point in view 2, of any length."""
U, V, U_W, V_W, INSIDE = 3 * SAMPLES, 4 * SAMPLES, 5 * SAMPLES, 6 * SAMPLES, 7 * SAMPLES
"""Its pixel there, from the first column that an image which goes round has been continued by; how the pixel changes
with inverse range; and 1 if it is in the field and the image, else 0."""
A0, A1, A2, A3 = 8 * SAMPLES, 9 * SAMPLES, 10 * SAMPLES, 11 * SAMPLES
B0, B1, B2, B3 = 12 * SAMPLES, 13 * SAMPLES, 14 * SAMPLES, 15 * SAMPLES
"""Weights of the spline's columns and rows."""
D0, D1, D2, D3 = 16 * SAMPLES, 17 * SAMPLES, 18 * SAMPLES, 19 * SAMPLES
E0, E1, E2, E3 = 20 * SAMPLES, 21 * SAMPLES, 22 * SAMPLES, 23 * SAMPLES
"""Their derivatives."""
GREY, ALONG_U, ALONG_V = 24 * SAMPLES, 25 * SAMPLES, 26 * SAMPLES
"""View 2 there, NaN where it is not seen, and its derivatives along u and v."""
SLOPE, MOTION = 27 * SAMPLES, 28 * SAMPLES
"""dI_2/dw and (du/dw)² + (dv/dw)²."""
X, Y, Z, W, FIRST = 29 * SAMPLES, 30 * SAMPLES, 31 * SAMPLES, 32 * SAMPLES, 33 * SAMPLES
"""Direction of the point in view 1, its inverse range, and what view 1 sees there."""
SIZE = 34 * SAMPLES
"""Length of the table."""


@kernel
def turn_samples(table, n, R, s):
    """Write q = R x + w s of the first n points."""
    for k in range(n):
        x, y, z, w = table[X + k], table[Y + k], table[Z + k], table[W + k]
        table[QX + k] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + w * s[0]
        table[QY + k] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + w * s[1]
        table[QZ + k] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + w * s[2]


@kernel
def see_samples(table, n, R, s, model):
    """Write where view 2 sees the first n points, in its field or not, counted from the image's own first column."""
    for k in range(n):
        x, y, z, w = table[X + k], table[Y + k], table[Z + k], table[W + k]
        qx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + w * s[0]
        qy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + w * s[1]
        qz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + w * s[2]
        table[U + k], table[V + k], _, _ = move(qx, qy, qz, s[0], s[1], s[2], model)


@kernel(inline=True)
def _put_place(table, k, u, v, field, coefficients):
    """Write a point's pixel, and whether it is in the field, and all taps of the spline there are in the image."""
    qx, qy, qz = table[QX + k], table[QY + k], table[QZ + k]
    norm = math.sqrt(qx * qx + qy * qy + qz * qz)
    up, along = along_up(qx, qy, qz, field), along_axis(qx, qy, qz, field)
    inside = (field.lowest * norm <= up) & (up <= field.highest * norm) & (along >= field.nearest * norm)
    inside &= (u >= 1.0) & (u < coefficients.shape[1] - 2) & (v >= 1.0) & (v < coefficients.shape[0] - 2)
    table[U + k], table[V + k], table[INSIDE + k] = u, v, 1.0 if inside else 0.0


@kernel
def place_samples(table, n, s, camera, coefficients):
    """Write where view 2 sees the first n points, and the weights of its spline there."""
    model, field, seam, _ = camera
    for k in range(n):
        u, v, _, _ = move(table[QX + k], table[QY + k], table[QZ + k], s[0], s[1], s[2], model)
        _put_place(table, k, u + seam, v, field, coefficients)
    _weigh_samples(table, n)


@kernel
def move_samples(table, n, s, camera, coefficients):
    """The same, and how the pixel changes along s."""
    model, field, seam, _ = camera
    for k in range(n):
        u, v, u_w, v_w = move(table[QX + k], table[QY + k], table[QZ + k], s[0], s[1], s[2], model)
        table[U_W + k], table[V_W + k] = u_w, v_w
        _put_place(table, k, u + seam, v, field, coefficients)
    _weigh_samples(table, n)


@kernel
def _weigh_samples(table, n):
    """Write the weights of the spline's columns and rows at the first n points."""
    for k in range(n):
        a0, a1, a2, a3 = cubic_weights(table[U + k] - math.floor(table[U + k]))
        b0, b1, b2, b3 = cubic_weights(table[V + k] - math.floor(table[V + k]))
        table[A0 + k], table[A1 + k], table[A2 + k], table[A3 + k] = a0, a1, a2, a3
        table[B0 + k], table[B1 + k], table[B2 + k], table[B3 + k] = b0, b1, b2, b3


@kernel(inline=True)
def column_sums(coefficients, i, j, w0, w1, w2, w3):
    """Weighted sums down four columns of coefficients, from row i - 1 and column j - 1 on."""
    k = j - 1
    above, own = doubles(load_four(coefficients, (i - 1, k))), doubles(load_four(coefficients, (i, k)))
    below, last = doubles(load_four(coefficients, (i + 1, k))), doubles(load_four(coefficients, (i + 2, k)))
    return numbers(times(w0, above) + times(w1, own) + times(w2, below) + times(w3, last))


@kernel(inline=True)
def grey_at(table, k, coefficients):
    """View 2 at sample k; NaN where a tap of the spline is missing, or the point is not in the field."""
    if table[INSIDE + k] == 0.0:
        return math.nan
    i, j = int(table[V + k]), int(table[U + k])
    c0, c1, c2, c3 = column_sums(coefficients, i, j, table[B0 + k], table[B1 + k], table[B2 + k], table[B3 + k])
    return c0 * table[A0 + k] + c1 * table[A1 + k] + c2 * table[A2 + k] + c3 * table[A3 + k]


@kernel
def sample_with_slopes(table, n, coefficients):
    """Write view 2 at the first n points, and its derivatives."""
    for k in range(n):
        d0, d1, d2, d3 = cubic_slopes(table[U + k] - math.floor(table[U + k]))
        e0, e1, e2, e3 = cubic_slopes(table[V + k] - math.floor(table[V + k]))
        table[D0 + k], table[D1 + k], table[D2 + k], table[D3 + k] = d0, d1, d2, d3
        table[E0 + k], table[E1 + k], table[E2 + k], table[E3 + k] = e0, e1, e2, e3
    for k in range(n):
        if table[INSIDE + k] == 0.0:
            table[GREY + k] = math.nan
            continue
        i, j = int(table[V + k]), int(table[U + k])
        b0, b1, b2, b3 = table[B0 + k], table[B1 + k], table[B2 + k], table[B3 + k]
        e0, e1, e2, e3 = table[E0 + k], table[E1 + k], table[E2 + k], table[E3 + k]
        c0, c1, c2, c3 = column_sums(coefficients, i, j, b0, b1, b2, b3)
        f0, f1, f2, f3 = column_sums(coefficients, i, j, e0, e1, e2, e3)
        a0, a1, a2, a3 = table[A0 + k], table[A1 + k], table[A2 + k], table[A3 + k]
        d0, d1, d2, d3 = table[D0 + k], table[D1 + k], table[D2 + k], table[D3 + k]
        table[GREY + k] = c0 * a0 + c1 * a1 + c2 * a2 + c3 * a3
        table[ALONG_U + k] = c0 * d0 + c1 * d1 + c2 * d2 + c3 * d3
        table[ALONG_V + k] = f0 * a0 + f1 * a1 + f2 * a2 + f3 * a3
    for k in range(n):
        u_w, v_w = table[U_W + k], table[V_W + k]
        table[SLOPE + k] = table[ALONG_U + k] * u_w + table[ALONG_V + k] * v_w
        table[MOTION + k] = u_w * u_w + v_w * v_w


# -- A patch -----------------------------------------------------------------------------------------------------------


@kernel
def gather_patch(i, j, reach, valid, x, first_image, table):
    """Write the directions and grey levels of the pixels about (i, j), and return how many there are."""
    n = 0
    for row in range(max(0, i - reach), min(valid.shape[0], i + reach + 1)):
        for column in range(max(0, j - reach), min(valid.shape[1], j + reach + 1)):
            if valid[row, column]:
                table[X + n], table[Y + n], table[Z + n] = x[row, column, 0], x[row, column, 1], x[row, column, 2]
                table[FIRST + n] = first_image[row, column]
                n += 1
    return n


@kernel
def misfit(table, n, least, m, a, b, limit, R, s, camera, coefficients):
    """Mean square of I_1 - a I_2 - b over the n pixels of a patch, for plane m; infinite where view 2 sees fewer than
    `least`. Stops, infinite, as soon as it must be above `limit`.
    """
    # q = R x + (m·x) s is linear in x.
    m_x, m_y, m_z = m[0], m[1], m[2]
    xx, xy, xz = R[0, 0] + s[0] * m_x, R[0, 1] + s[0] * m_y, R[0, 2] + s[0] * m_z
    yx, yy, yz = R[1, 0] + s[1] * m_x, R[1, 1] + s[1] * m_y, R[1, 2] + s[1] * m_z
    zx, zy, zz = R[2, 0] + s[2] * m_x, R[2, 1] + s[2] * m_y, R[2, 2] + s[2] * m_z
    for k in range(n):
        x, y, z = table[X + k], table[Y + k], table[Z + k]
        table[QX + k], table[QY + k], table[QZ + k] = (
            xx * x + xy * y + xz * z,
            yx * x + yy * y + yz * z,
            zx * x + zy * y + zz * z,
        )
    place_samples(table, n, s, camera, coefficients)
    total, seen = 0.0, 0.0
    for k in range(n):
        grey = grey_at(table, k, coefficients)
        if not math.isnan(grey):
            difference = table[FIRST + k] - a * grey - b
            total += difference * difference
            seen += 1.0
            if total > limit * n:
                return math.inf
    return total / seen if seen >= least else math.inf
