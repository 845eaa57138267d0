"""Compiled loop over pixels. Called through `harness.camera.sensor`, which checks the arguments."""

import math

from harness.compiled import kernel


@kernel
def rays_of_pixels(u, v, parameters, x_out, y_out, z_out):
    """Write the direction of each pixel's ray, of any length; NaN where the lens has no inverse.

    A camera ray q = (x, y, 1) from F1 meets the mirror at F1 + s q with s = b²/(e - a |q|). Seen from F0 that is the
    direction (s x, s y, s - 2e). Dividing by s > 0 leaves (x, y, 1 - 2e²/b² + (2 a e/b²) |q|), in which large
    numbers cancel when b is small beside a. With |q| = 1 + r²/(1 + |q|) nothing cancels but at the horizon:
    (x, y, (2 a e/b²) r²/(1 + |q|) - b²/(a + e)²).
    """
    fu, fv, cx, cy, a, b, e, k1, k2, p1, p2, k3, fold = parameters
    z_axis = -b * b / ((a + e) * (a + e))
    z_slope = 2.0 * a * e / (b * b)
    if k1 == 0.0 and k2 == 0.0 and k3 == 0.0 and p1 == 0.0 and p2 == 0.0:
        for i in range(u.size):
            x = (u[i] - cx) / fu
            y = (v[i] - cy) / fv
            x_out[i] = x
            y_out[i] = y
            r2 = x * x + y * y
            z_out[i] = z_axis + z_slope * r2 / (1.0 + math.sqrt(1.0 + r2))
        return
    for i in range(u.size):
        x, y = _unbend((u[i] - cx) / fu, (v[i] - cy) / fv, k1, k2, p1, p2, k3, fold)
        r2 = x * x + y * y
        x_out[i] = x
        y_out[i] = y
        z_out[i] = z_axis + z_slope * r2 / (1.0 + math.sqrt(1.0 + r2))


@kernel
def _unbend(x_d, y_d, k1, k2, p1, p2, k3, fold):
    """Undistorted point of a distorted one, by Newton's method; NaN when there is none within the fold.

    Plain Newton swings from side to side of the image for lenses that bend both ways (k1 and k3 of opposite sign).
    Within the fold the Jacobian is positive definite, so a step that is cut until it brings the error down and stays
    inside comes to the one solution from anywhere.
    """
    # Begin at the distorted point, which is near, unless it lies beyond the fold.
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
            return x, y  # only rounding is left
        else:
            cut *= 0.5
        x_next, y_next = x - cut * dx, y - cut * dy
    return math.nan, math.nan
