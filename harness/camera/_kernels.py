"""Compiled loop over pixels. Called through `harness.camera.sensor`, which checks the arguments."""

import math

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def rays_of_pixels(u, v, parameters, x_out, y_out, z_out):
    """Write the direction of each pixel's ray, of any length; NaN where the lens has no inverse.

    A camera ray q = (x, y, 1) from F1 meets the mirror at F1 + s q with s = b²/(e - a |q|). Seen from F0 that is the
    direction (s x, s y, s - 2e). Dividing by s > 0 leaves one square root and no division:
    (x, y, 1 - 2e²/b² + (2 a e/b²) |q|).
    """
    fu, fv, cx, cy, a, b, e, k1, k2, p1, p2, k3, fold = parameters
    z_constant = 1.0 - 2.0 * e * e / (b * b)
    z_slope = 2.0 * a * e / (b * b)
    if k1 == 0.0 and k2 == 0.0 and k3 == 0.0 and p1 == 0.0 and p2 == 0.0:
        for i in range(u.size):
            x = (u[i] - cx) / fu
            y = (v[i] - cy) / fv
            x_out[i] = x
            y_out[i] = y
            z_out[i] = z_constant + z_slope * math.sqrt(1.0 + x * x + y * y)
        return
    for i in range(u.size):
        x_d = (u[i] - cx) / fu
        y_d = (v[i] - cy) / fv
        x, y = x_d, y_d
        step = math.inf
        for _ in range(50):
            # Newton on the distortion, from the distorted point: monotonic in the radius below the fold.
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
            error_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - x_d
            error_y = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) - y_d
            j_xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            j_xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            j_yy = radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y
            determinant = j_xx * j_yy - j_xy * j_xy
            dx = (j_yy * error_x - j_xy * error_y) / determinant
            dy = (j_xx * error_y - j_xy * error_x) / determinant
            x -= dx
            y -= dy
            previous, step = step, abs(dx) + abs(dy)
            # At the last digits the step stops shrinking: that is the end, not a failure.
            if step == 0.0 or (step < 1e-13 and step >= previous):
                break
        if step < 1e-12 and x * x + y * y <= fold * fold:
            x_out[i] = x
            y_out[i] = y
            z_out[i] = z_constant + z_slope * math.sqrt(1.0 + x * x + y * y)
        else:
            x_out[i] = math.nan
            y_out[i] = math.nan
            z_out[i] = math.nan
