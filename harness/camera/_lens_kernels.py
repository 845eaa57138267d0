"""Compiled Brown-Conrady distortion of a point in normalised image coordinates, its derivative and its inverse."""

import math

from harness.compiled import kernel


@kernel
def bend(x, y, k1, k2, p1, p2, k3):
    """The distorted point (x', y') of an undistorted one (x, y); see `harness.camera.lens.distort`."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
    )


@kernel
def move_bent(x, y, dx, dy, k1, k2, p1, p2, k3):
    """The distorted point, and its derivative along (dx, dy)."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    along = slope * (x * dx + y * dy)
    both = dx * y + x * dy
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        dx * radial + x * along + 2.0 * p1 * both + p2 * (6.0 * x * dx + 2.0 * y * dy),
        dy * radial + y * along + 2.0 * p2 * both + p1 * (6.0 * y * dy + 2.0 * x * dx),
    )


@kernel
def bend_all(points, k1, k2, p1, p2, k3, out):
    """Write the distorted points of `[n, 2]`."""
    for i in range(points.shape[0]):
        out[i, 0], out[i, 1] = bend(points[i, 0], points[i, 1], k1, k2, p1, p2, k3)


@kernel
def unbend(x_d, y_d, k1, k2, p1, p2, k3, fold):
    """The undistorted point of a distorted one, by Newton's method; NaN when there is none within the fold.

    Plain Newton steps oscillate across the image for lenses whose k1 and k3 have opposite signs. Within the fold the
    Jacobian is positive definite, so that steps which are halved until they reduce the error and stay within the fold
    converge to the unique solution from anywhere.
    """
    # Start at the distorted point, which is close, unless it lies beyond the fold.
    radius = math.hypot(x_d, y_d)
    start = 1.0 if radius < fold else 0.5 * fold / radius
    x_next, y_next = start * x_d, start * y_d
    x = y = dx = dy = 0.0
    error, cut = math.inf, 1.0
    for _ in range(200):
        r2 = x_next * x_next + y_next * y_next
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        error_x = x_next * radial + 2.0 * p1 * x_next * y_next + p2 * (r2 + 2.0 * x_next * x_next) - x_d
        error_y = y_next * radial + 2.0 * p2 * x_next * y_next + p1 * (r2 + 2.0 * y_next * y_next) - y_d
        error_next = math.hypot(error_x, error_y)
        if r2 <= fold * fold and error_next < error:
            x, y, error = x_next, y_next, error_next
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
            j_xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            j_xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            j_yy = radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y
            determinant = j_xx * j_yy - j_xy * j_xy
            dx = (j_yy * error_x - j_xy * error_y) / determinant
            dy = (j_xx * error_y - j_xy * error_x) / determinant
            cut = 1.0
        elif error <= 1e-13 * radius:
            return x, y  # the error is rounding
        else:
            cut *= 0.5
        x_next, y_next = x - cut * dx, y - cut * dy
    return math.nan, math.nan
