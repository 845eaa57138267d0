"""The pixel of a point in a hyperboloid mirror, for a camera at any position: Newton's method on Fermat's principle.

Light from X by way of P on the mirror to the camera centre C takes the path whose length `L = |P - C| + |P - X|` does
not change with P. With (x, y) of P as unknowns, T = ∂P/∂(x, y) and `w_1 = (P - C)/|P - C|`, `w_2 = (P - X)/|P - X|`:

    g = T^T (w_1 + w_2) = 0
    H = ∂g/∂(x, y) = T^T (Q_1 + Q_2) T + (w_1 + w_2)_z ∂²P_z/∂(x, y)²,   Q_i = (I - w_i w_i^T)/|P - .|

L is a convex function and the mirror, filled, a convex body: there is one such P in front of it, and no other. By the
theorem of implicit functions `d(x, y) = H^-1 T^T (Q_1 dC + Q_2 dX)`, from which derivatives follow.
"""

import math

from harness.camera._lens_kernels import bend, move_bent
from harness.camera._pixel_kernels import moved_pixel, to_pixel
from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera._reflection_kernels import ReflectingCamera, is_clear, to_mirror
from harness.compiled import kernel

_LEAST = 1e-13
"""Value of |g|, a sine, below which only rounding is left."""


@kernel
def _path(x, y, X_x, X_y, X_z, camera):
    """The path by way of the mirror at (x, y): its z and slopes there, w_1 and |P - C|, w_2 and |P - X|."""
    slope = camera.a * camera.a / (camera.b * camera.b)
    height = math.sqrt(camera.a * camera.a + slope * (x * x + y * y))
    z = height - camera.e
    u_x, u_y, u_z = x - camera.c_x, y - camera.c_y, z - camera.c_z
    v_x, v_y, v_z = x - X_x, y - X_y, z - X_z
    d_1 = math.sqrt(u_x * u_x + u_y * u_y + u_z * u_z)
    d_2 = math.sqrt(v_x * v_x + v_y * v_y + v_z * v_z)
    return (
        z, slope * x / height, slope * y / height,
        u_x / d_1, u_y / d_1, u_z / d_1, d_1, v_x / d_2, v_y / d_2, v_z / d_2, d_2,
    )  # fmt: skip


@kernel
def _step(g_x, g_y, z, z_x, z_y, u_x, u_y, u_z, d_1, v_x, v_y, v_z, d_2, camera):
    """`H^-1 g`, on a path."""
    height, slope = z + camera.e, camera.a * camera.a / (camera.b * camera.b)
    s_z = u_z + v_z
    both = 1.0 / d_1 + 1.0 / d_2
    one_x, one_y = u_x + z_x * u_z, u_y + z_y * u_z
    two_x, two_y = v_x + z_x * v_z, v_y + z_y * v_z
    h_xx = (1.0 + z_x * z_x) * both - one_x * one_x / d_1 - two_x * two_x / d_2 + s_z * (slope - z_x * z_x) / height
    h_xy = z_x * z_y * both - one_x * one_y / d_1 - two_x * two_y / d_2 - s_z * z_x * z_y / height
    h_yy = (1.0 + z_y * z_y) * both - one_y * one_y / d_1 - two_y * two_y / d_2 + s_z * (slope - z_y * z_y) / height
    determinant = h_xx * h_yy - h_xy * h_xy
    return (h_yy * g_x - h_xy * g_y) / determinant, (h_xx * g_y - h_xy * g_x) / determinant


@kernel
def _solve(X_x, X_y, X_z, camera):
    """The mirror's point that shows X, both in the mirror's frame: `x, y, z`, and whether there is one."""
    a, b, e = camera.a, camera.b, camera.e
    reach = a * math.sqrt(X_x * X_x + X_y * X_y + X_z * X_z) - e * X_z
    if not reach > 0.0:
        return math.nan, math.nan, math.nan, False
    # Begin where an aligned camera would see it.
    x_next, y_next = b * b / reach * X_x, b * b / reach * X_y
    x = y = z = dx = dy = 0.0
    front = False
    error, cut = math.inf, 1.0
    for _ in range(100):
        z_next, z_x, z_y, u_x, u_y, u_z, d_1, v_x, v_y, v_z, d_2 = _path(x_next, y_next, X_x, X_y, X_z, camera)
        g_x, g_y = u_x + v_x + z_x * (u_z + v_z), u_y + v_y + z_y * (u_z + v_z)
        error_next = math.hypot(g_x, g_y)
        if error_next < error:
            x, y, z, error = x_next, y_next, z_next, error_next
            # Light arrives and leaves in front of the mirror.
            front = u_z - z_x * u_x - z_y * u_y > 0.0 and v_z - z_x * v_x - z_y * v_y > 0.0
            dx, dy = _step(g_x, g_y, z, z_x, z_y, u_x, u_y, u_z, d_1, v_x, v_y, v_z, d_2, camera)
            cut = 1.0
        elif error <= _LEAST:
            return x, y, z, front
        else:
            cut *= 0.5
        x_next, y_next = x - cut * dx, y - cut * dy
    return math.nan, math.nan, math.nan, False


@kernel(inline=True)
def _to_camera(x, y, z, camera):
    """A vector of the mirror's frame in the camera's."""
    return (
        camera.r_xx * x + camera.r_yx * y + camera.r_zx * z,
        camera.r_xy * x + camera.r_yy * y + camera.r_zy * z,
        camera.r_xz * x + camera.r_yz * y + camera.r_zz * z,
    )


@kernel
def _pixel(p_x, p_y, p_z, camera):
    """The pixel of a point of the mirror, and whether it is in front of the camera and within the lens's fold."""
    q_x, q_y, q_z = _to_camera(p_x - camera.c_x, p_y - camera.c_y, p_z - camera.c_z, camera)
    m, n = q_x / q_z, q_y / q_z
    inside = q_z > 0.0 and math.sqrt(m * m + n * n) <= camera.fold
    m, n = bend(m, n, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3)
    u, v = to_pixel(m, n, camera)
    return u, v, inside


@kernel
def _moved_pixel(p_x, p_y, p_z, q_x_d, q_y_d, q_z_d, camera):
    """The pixel of a point of the mirror, and its derivative where (q_x_d, ...) is that in the camera's frame."""
    q_x, q_y, q_z = _to_camera(p_x - camera.c_x, p_y - camera.c_y, p_z - camera.c_z, camera)
    m, n = q_x / q_z, q_y / q_z
    m, n, m_d, n_d = move_bent(
        m, n, (q_x_d - m * q_z_d) / q_z, (q_y_d - n * q_z_d) / q_z,
        camera.k1, camera.k2, camera.p1, camera.p2, camera.k3,
    )  # fmt: skip
    return moved_pixel(m, n, m_d, n_d, camera)


@kernel
def _moved_point(p_x, p_y, X_x, X_y, X_z, x_d, y_d, z_d, of_camera, camera):
    """The derivative of P for the motion (x_d, y_d, z_d) of X, or of the camera centre; all in the mirror's frame."""
    z, z_x, z_y, u_x, u_y, u_z, d_1, v_x, v_y, v_z, d_2 = _path(p_x, p_y, X_x, X_y, X_z, camera)
    w_x, w_y, w_z, distance = (u_x, u_y, u_z, d_1) if of_camera else (v_x, v_y, v_z, d_2)
    length = w_x * x_d + w_y * y_d + w_z * z_d
    x_d, y_d, z_d = (x_d - w_x * length) / distance, (y_d - w_y * length) / distance, (z_d - w_z * length) / distance
    g_x, g_y = x_d + z_x * z_d, y_d + z_y * z_d
    dx, dy = _step(g_x, g_y, z, z_x, z_y, u_x, u_y, u_z, d_1, v_x, v_y, v_z, d_2, camera)
    return dx, dy, z_x * dx + z_y * dy


@kernel
def _project(x, y, z, camera):
    X_x, X_y, X_z = to_mirror(x, y, z, camera)
    p_x, p_y, p_z, met = _solve(X_x, X_y, X_z, camera)
    if not met:
        return math.nan, math.nan, False
    return _pixel(p_x, p_y, p_z, camera)


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    X_x, X_y, X_z = to_mirror(x, y, z, camera)
    dx, dy, dz = to_mirror(dx, dy, dz, camera)
    p_x, p_y, p_z, _ = _solve(X_x, X_y, X_z, camera)
    dx, dy, dz = _moved_point(p_x, p_y, X_x, X_y, X_z, dx, dy, dz, False, camera)
    dx, dy, dz = _to_camera(dx, dy, dz, camera)
    return _moved_pixel(p_x, p_y, p_z, dx, dy, dz, camera)


@kernel
def project_reflected(points, camera, pixels, valid):
    """Write the pixels `[n, 2]` of points `[n, 3]` of the sensor's frame, and whether they are seen.

    NaN where no light arrives, however far the mirror is continued. Rim and body count for `valid` alone.
    """
    for i in range(points.shape[0]):
        X_x, X_y, X_z = to_mirror(points[i, 0], points[i, 1], points[i, 2], camera)
        p_x, p_y, p_z, met = _solve(X_x, X_y, X_z, camera)
        u, v, inside = math.nan, math.nan, False
        if met:
            u, v, inside = _pixel(p_x, p_y, p_z, camera)
        pixels[i, 0], pixels[i, 1] = (u, v) if inside else (math.nan, math.nan)
        r_x, r_y, r_z = X_x - p_x, X_y - p_y, X_z - p_z
        valid[i] = inside and is_clear(p_x, p_y, p_z, r_x, r_y, r_z, camera)


@kernel
def differentiate_reflected(points, axes, camera, by_point, by_camera):
    """Write the derivatives of the pixels of points `[n, 3]` by the points, `[n, 2, 3]`, and by the camera's pose,
    `[n, 2, 6]`: pixels per metre and per radian.

    `axes` `[3, 3]`: a row for each of the three turns, its axis in the mirror's frame.
    """
    for i in range(points.shape[0]):
        X_x, X_y, X_z = to_mirror(points[i, 0], points[i, 1], points[i, 2], camera)
        p_x, p_y, p_z, met = _solve(X_x, X_y, X_z, camera)
        if not met:
            by_point[i] = math.nan
            by_camera[i] = math.nan
            continue
        g_x, g_y, g_z = p_x - camera.c_x, p_y - camera.c_y, p_z - camera.c_z
        for k in range(3):
            dx = 1.0 if k == 0 else 0.0
            dy = 1.0 if k == 1 else 0.0
            dz = 1.0 if k == 2 else 0.0
            x, y, z = to_mirror(dx, dy, dz, camera)
            x, y, z = _moved_point(p_x, p_y, X_x, X_y, X_z, x, y, z, False, camera)
            x, y, z = _to_camera(x, y, z, camera)
            _, _, by_point[i, 0, k], by_point[i, 1, k] = _moved_pixel(p_x, p_y, p_z, x, y, z, camera)
            x, y, z = _moved_point(p_x, p_y, X_x, X_y, X_z, dx, dy, dz, True, camera)
            x, y, z = _to_camera(x - dx, y - dy, z - dz, camera)
            _, _, by_camera[i, 0, k], by_camera[i, 1, k] = _moved_pixel(p_x, p_y, p_z, x, y, z, camera)
            # A turn w of the camera turns what it sees by -w.
            w_x, w_y, w_z = axes[k, 0], axes[k, 1], axes[k, 2]
            x, y, z = _to_camera(g_y * w_z - g_z * w_y, g_z * w_x - g_x * w_z, g_x * w_y - g_y * w_x, camera)
            _, _, by_camera[i, 0, 3 + k], by_camera[i, 1, 3 + k] = _moved_pixel(p_x, p_y, p_z, x, y, z, camera)


# These project points, not directions: the rays of the pixels meet in no viewpoint.
add_compiled_model(ReflectingCamera, CompiledModel(_project, _move, None))
