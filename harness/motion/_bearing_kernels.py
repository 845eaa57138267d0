"""Compiled residuals of bearing vectors. `harness.motion.residuals` and `harness.motion.robust` lay out the arguments.

With y = R^T x_2, which is x_2 in view 1's orientation, and n = t × x_1, a pair fits the motion (R, t) when y · n = 0.
Its Sampson distance is `y · n` over its standard deviation for pixels of standard deviation 1, to first order.
"""

import math

from harness.compiled import kernel


@kernel(inline=True)
def _distance(x, x_2, s_1, s_2, R, t):
    """The signed Sampson distance in pixels, and the sine of the angle by which the point is in front of both views.

    y = a x - b t with a, b > 0 for a point in front of both. (x × y) · n = b |n|² and (t × y) · n = a |n|²; returns the
    smaller of both over |n|, the sine of an angle, which is negative for a point behind a view.
    """
    y0 = R[0, 0] * x_2[0] + R[1, 0] * x_2[1] + R[2, 0] * x_2[2]
    y1 = R[0, 1] * x_2[0] + R[1, 1] * x_2[1] + R[2, 1] * x_2[2]
    y2 = R[0, 2] * x_2[0] + R[1, 2] * x_2[1] + R[2, 2] * x_2[2]
    n0 = t[1] * x[2] - t[2] * x[1]
    n1 = t[2] * x[0] - t[0] * x[2]
    n2 = t[0] * x[1] - t[1] * x[0]
    k0 = t[1] * y2 - t[2] * y1
    k1 = t[2] * y0 - t[0] * y2
    k2 = t[0] * y1 - t[1] * y0
    m0 = R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2
    m1 = R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2
    m2 = R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2
    variance = 0.0
    for j in range(2):
        along_1 = s_1[0, j] * k0 + s_1[1, j] * k1 + s_1[2, j] * k2
        along_2 = s_2[0, j] * m0 + s_2[1, j] * m1 + s_2[2, j] * m2
        variance += along_1 * along_1 + along_2 * along_2
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    before_1 = (x[1] * y2 - x[2] * y1) * n0 + (x[2] * y0 - x[0] * y2) * n1 + (x[0] * y1 - x[1] * y0) * n2
    before_2 = k0 * n0 + k1 * n1 + k2 * n2
    tiny = 1e-300
    distance = (y0 * n0 + y1 * n1 + y2 * n2) / math.sqrt(variance + tiny)
    return distance, min(before_1, before_2) / (length + tiny)


@kernel
def distances(x_1, x_2, s_1, s_2, R, t, distance, before):
    """Write the Sampson distances `[n]`, pixels, and the sines by which points are in front of both views `[n]`."""
    for i in range(x_1.shape[0]):
        distance[i], before[i] = _distance(x_1[i], x_2[i], s_1[i], s_2[i], R, t)


@kernel
def truncated_cost(x_1, x_2, s_1, s_2, slack, R, t, limit, most):
    """Sum of squared distances truncated at limit²; stops with a number above `most` as soon as the sum exceeds it.

    slack : `[n]`, the sine by which a point may appear behind a view.
    """
    total = 0.0
    square = limit * limit
    for i in range(x_1.shape[0]):
        distance, before = _distance(x_1[i], x_2[i], s_1[i], s_2[i], R, t)
        total += min(distance * distance, square) if before > -slack[i] else square
        if total > most:
            return total
    return total
