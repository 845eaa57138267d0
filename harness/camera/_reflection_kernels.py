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
    """Mirror, camera and lens as numbers, and what shades the mirror. Lengths in metres."""

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


@kernel
def meet_mirror(x, y, camera):
    """Where the camera's ray through (x, y) of the undistorted normalised image meets the mirror, and where it goes.

    Returns `p_x, p_y, p_z, r_x, r_y, r_z, hits` in the mirror's frame; r is of unit length.
    """
    d_x = camera.r_xx * x + camera.r_xy * y + camera.r_xz
    d_y = camera.r_yx * x + camera.r_yy * y + camera.r_yz
    d_z = camera.r_zx * x + camera.r_zy * y + camera.r_zz
    norm = math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
    d_x, d_y, d_z = d_x / norm, d_y / norm, d_z / norm
    across, along = 1.0 / (camera.b * camera.b), 1.0 / (camera.a * camera.a)
    c_x, c_y, c_z = camera.c_x, camera.c_y, camera.c_z + camera.e
    A = d_z * d_z * along - (d_x * d_x + d_y * d_y) * across
    B = c_z * d_z * along - (c_x * d_x + c_y * d_y) * across
    G = c_z * c_z * along - (c_x * c_x + c_y * c_y) * across - 1.0
    root = math.sqrt(B * B - A * G)
    # The same root twice, so that numbers of one sign are added.
    s = (root - B) / A if B <= 0.0 else -G / (B + root)
    p_x, p_y, p_z = c_x + s * d_x, c_y + s * d_y, c_z + s * d_z
    hits = s > 0.0 and p_z > 0.0 and s < math.inf
    n_x, n_y, n_z = -p_x * across, -p_y * across, p_z * along
    twice = 2.0 * (d_x * n_x + d_y * n_y + d_z * n_z) / (n_x * n_x + n_y * n_y + n_z * n_z)
    r_x, r_y, r_z = d_x - twice * n_x, d_y - twice * n_y, d_z - twice * n_z
    return p_x, p_y, p_z - camera.e, r_x, r_y, r_z, hits


@kernel(inline=True)
def is_seen(p_x, p_y, p_z, r_x, r_y, r_z, camera):
    """Whether the mirror reaches to p, and the ray that leaves in direction r clears the camera's body."""
    x, y, z = to_sensor(p_x, p_y, p_z, camera)
    field = camera.field
    norm = math.sqrt(x * x + y * y + z * z)
    sine = along_up(x, y, z, field) / norm
    clear = field.lowest <= sine <= field.highest and along_axis(x, y, z, field) >= field.nearest * norm
    if clear and camera.body > 0.0:
        # Where the ray meets the plane across the optical axis.
        g_x, g_y, g_z = p_x - camera.c_x, p_y - camera.c_y, p_z - camera.c_z
        height = camera.r_xz * g_x + camera.r_yz * g_y + camera.r_zz * g_z
        fall = -(camera.r_xz * r_x + camera.r_yz * r_y + camera.r_zz * r_z)
        if fall > 0.0:
            t = height / fall
            g_x, g_y, g_z = g_x + t * r_x, g_y + t * r_y, g_z + t * r_z
            clear = g_x * g_x + g_y * g_y + g_z * g_z >= camera.body * camera.body
    return clear


@kernel
def reflect_pixels(u, v, camera, origins, directions, valid):
    """Write where each pixel's ray leaves the mirror, metres, its unit direction, and whether there is one.

    `[3, n]` in the sensor's frame; NaN where there is no mirror, however far its surface is continued.
    """
    k1, k2, p1, p2, k3, fold = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.fold
    bends = k1 != 0.0 or k2 != 0.0 or k3 != 0.0 or p1 != 0.0 or p2 != 0.0
    for i in range(u.size):
        x, y = from_pixel(u[i], v[i], camera)
        if bends:
            x, y = unbend(x, y, k1, k2, p1, p2, k3, fold)
        p_x, p_y, p_z, r_x, r_y, r_z, hits = meet_mirror(x, y, camera)
        if hits:
            valid[i] = is_seen(p_x, p_y, p_z, r_x, r_y, r_z, camera)
            origins[0, i], origins[1, i], origins[2, i] = to_sensor(p_x, p_y, p_z, camera)
            directions[0, i], directions[1, i], directions[2, i] = to_sensor(r_x, r_y, r_z, camera)
        else:
            valid[i] = False
            for k in range(3):
                origins[k, i] = math.nan
                directions[k, i] = math.nan
