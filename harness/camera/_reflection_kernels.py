"""A camera that sees the world in a hyperboloid mirror from anywhere: the ray of a pixel by the law of reflection.

With `p' = p + (0, 0, e)` the mirror is `q(p') = p'_z²/a² - (p'_x² + p'_y²)/b² = 1`, p'_z > 0. The camera's ray
`C + s d` meets it where `A s² + 2 B s + G = 0`, `A = q(d)`, `B` the bilinear form of C' and d, `G = q(C') - 1`. A ray
with A > 0 meets each sheet once, the upper one at the larger s; one with A < 0 meets one sheet twice, in front at the
smaller s > 0. Both are `s = (-B + sqrt(B² - A G))/A`. It leaves in the direction `r = d - 2 (d·n) n`, n along the
gradient of q.
"""

import math
from typing import Any, NamedTuple

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._lens_kernels import unbend
from harness.camera._pixel_kernels import from_pixel
from harness.compiled import kernel


class ReflectingCamera(NamedTuple):
    """Mirror, camera and lens as numbers, and the body that shades the mirror. Lengths in metres."""

    fu: float
    fv: float
    skew: float
    cu: float
    cv: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    fold: float
    """Radius at which the lens folds the image over."""
    a: float
    b: float
    e: float
    c_x: float
    """The camera centre in the mirror's frame, origin at its inner focus."""
    c_y: float
    c_z: float
    r_xx: float
    """The rotation that takes directions of the camera's frame to the mirror's, row by row."""
    r_xy: float
    r_xz: float
    r_yx: float
    r_yy: float
    r_yz: float
    r_zx: float
    r_zy: float
    r_zz: float
    m_xx: float
    """The matrix that takes directions of the sensor's frame to the mirror's, row by row."""
    m_xy: float
    m_xz: float
    m_yx: float
    m_yy: float
    m_yz: float
    m_zx: float
    m_zy: float
    m_zz: float
    field: Any
    """`FieldLimits` of where the mirror is, as seen from its inner focus."""
    body: float
    """Radius of the disc around the camera centre, across the optical axis, that hides what is behind it."""


@kernel(inline=True)
def to_sensor(x, y, z, camera):
    """A vector of the mirror's frame in the sensor's."""
    return (
        camera.m_xx * x + camera.m_yx * y + camera.m_zx * z,
        camera.m_xy * x + camera.m_yy * y + camera.m_zy * z,
        camera.m_xz * x + camera.m_yz * y + camera.m_zz * z,
    )


@kernel(inline=True)
def to_mirror(x, y, z, camera):
    """A vector of the sensor's frame in the mirror's."""
    return (
        camera.m_xx * x + camera.m_xy * y + camera.m_xz * z,
        camera.m_yx * x + camera.m_yy * y + camera.m_yz * z,
        camera.m_zx * x + camera.m_zy * y + camera.m_zz * z,
    )


@kernel(inline=True)
def meet_mirror(x, y, camera):
    """The point at which the camera's ray through (x, y) of the undistorted normalised image meets the mirror, and the
    direction in which it leaves.

    Returns `p_x, p_y, p_z, r_x, r_y, r_z, hits` in the mirror's frame; r is of unit length.
    """
    d_x = camera.r_xx * x + camera.r_xy * y + camera.r_xz
    d_y = camera.r_yx * x + camera.r_yy * y + camera.r_yz
    d_z = camera.r_zx * x + camera.r_zy * y + camera.r_zz
    across, along = 1.0 / (camera.b * camera.b), 1.0 / (camera.a * camera.a)
    c_x, c_y, c_z = camera.c_x, camera.c_y, camera.c_z + camera.e
    A = d_z * d_z * along - (d_x * d_x + d_y * d_y) * across
    B = c_z * d_z * along - (c_x * d_x + c_y * d_y) * across
    G = c_z * c_z * along - (c_x * c_x + c_y * c_y) * across - 1.0
    root = math.sqrt(B * B - A * G)
    # The same root in two forms, of which one adds numbers of one sign.
    upwards = B <= 0.0
    s = (root - B if upwards else -G) / (A if upwards else B + root)
    p_x, p_y, p_z = c_x + s * d_x, c_y + s * d_y, c_z + s * d_z
    hits = (s > 0.0) & (p_z > 0.0) & (s < math.inf)
    n_x, n_y, n_z = -p_x * across, -p_y * across, p_z * along
    twice = 2.0 * (d_x * n_x + d_y * n_y + d_z * n_z) / (n_x * n_x + n_y * n_y + n_z * n_z)
    scale = 1.0 / math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
    r_x, r_y, r_z = scale * (d_x - twice * n_x), scale * (d_y - twice * n_y), scale * (d_z - twice * n_z)
    return p_x, p_y, p_z - camera.e, r_x, r_y, r_z, hits


@kernel(inline=True)
def is_clear(p_x, p_y, p_z, r_x, r_y, r_z, camera):
    """Whether the mirror reaches to p, and the ray that leaves in direction r clears the camera's body."""
    x, y, z = to_sensor(p_x, p_y, p_z, camera)
    field = camera.field
    norm = math.sqrt(x * x + y * y + z * z)
    up, ahead = along_up(x, y, z, field), along_axis(x, y, z, field)
    reaches = (up >= field.lowest * norm) & (up <= field.highest * norm) & (ahead >= field.nearest * norm)
    # The ray meets the plane across the optical axis at `p + (height/fall) r`.
    g_x, g_y, g_z = p_x - camera.c_x, p_y - camera.c_y, p_z - camera.c_z
    height = camera.r_xz * g_x + camera.r_yz * g_y + camera.r_zz * g_z
    fall = -(camera.r_xz * r_x + camera.r_yz * r_y + camera.r_zz * r_z)
    t_x, t_y, t_z = fall * g_x + height * r_x, fall * g_y + height * r_y, fall * g_z + height * r_z
    body = camera.body * fall
    return reaches & ((fall <= 0.0) | (t_x * t_x + t_y * t_y + t_z * t_z >= body * body))


@kernel
def reflect_pixels(u, v, camera, origins, directions, valid):
    """Write where each pixel's ray leaves the mirror, metres, its unit direction, and whether there is one.

    `[3, n]` in the sensor's frame; NaN where there is no mirror, however far its surface is continued.
    """
    k1, k2, p1, p2, k3, fold = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.fold
    x_out, y_out, z_out = origins[0], origins[1], origins[2]
    rx_out, ry_out, rz_out = directions[0], directions[1], directions[2]
    for i in range(u.size):
        x_out[i], y_out[i] = from_pixel(u[i], v[i], camera)
    if k1 != 0.0 or k2 != 0.0 or k3 != 0.0 or p1 != 0.0 or p2 != 0.0:
        for i in range(u.size):
            x_out[i], y_out[i] = unbend(x_out[i], y_out[i], k1, k2, p1, p2, k3, fold)
    # Without a branch, so that several pixels are computed at once.
    for i in range(u.size):
        p_x, p_y, p_z, r_x, r_y, r_z, hits = meet_mirror(x_out[i], y_out[i], camera)
        valid[i] = hits & is_clear(p_x, p_y, p_z, r_x, r_y, r_z, camera)
        p_x, p_y, p_z = to_sensor(p_x, p_y, p_z, camera)
        r_x, r_y, r_z = to_sensor(r_x, r_y, r_z, camera)
        x_out[i] = p_x if hits else math.nan
        y_out[i] = p_y if hits else math.nan
        z_out[i] = p_z if hits else math.nan
        rx_out[i] = r_x if hits else math.nan
        ry_out[i] = r_y if hits else math.nan
        rz_out[i] = r_z if hits else math.nan
