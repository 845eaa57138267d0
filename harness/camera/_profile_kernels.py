"""A perspective camera that sees the world in a mirror of revolution: the ray of a pixel by the law of reflection.

The camera's ray `C + s d` meets the profile where `F(s) = p_z - z(r) = 0`, r the distance of p from the axis. In front
of a convex mirror F is concave and starts below 0, so that Newton's method approaches the first zero from below without
a step beyond it, and from beyond comes below it at once; for others a bisection takes over once F has changed its sign.
It begins where an aligned camera's ray would meet the mirror. The ray leaves in the direction `d - 2 (d·n) n`, n along
`(-z' p_x/r, -z' p_y/r, 1)`.
"""

import math
from typing import Any, NamedTuple

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._lens_kernels import unbend
from harness.camera._pixel_kernels import from_pixel
from harness.camera._reflection_kernels import to_sensor
from harness.compiled import kernel


class ProfileCamera(NamedTuple):
    """Mirror, camera and lens as numbers. Lengths in metres; the mirror's frame has its origin at the apex."""

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
    kind: int
    """0 sphere, 1 cone, 2 paraboloid, 3 pieces of cubics."""
    size: float
    """Radius of a sphere, slope of a cone, z/r² of a paraboloid."""
    rim: float
    """Radius of the mirror's rim; beyond it the surface is continued along its slope."""
    knots: Any
    """`[n + 1]`: radii at which the pieces join."""
    cubics: Any
    """`[4, n]`: their coefficients in the distance from the left knot, the highest power first."""
    first: Any
    """`[m]`: the piece in which each of m equal parts of 0 .. rim begins."""
    depths: Any
    """`[n + 1]`: depths, along the axis, at which an aligned camera's rays of evenly spaced slopes meet the mirror."""
    widest: float
    """The last of these slopes; steeper rays begin at the camera."""
    viewpoint: float
    """Height of the sensor's origin above the apex."""
    c_x: float
    """The camera centre."""
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
    """`FieldLimits` of the directions that rays leave in."""


@kernel(inline=True)
def _height(r, camera):
    """z(r), and its slope."""
    q = min(r, camera.rim)
    if camera.kind == 0:
        root = math.sqrt(camera.size * camera.size - q * q)
        z, slope = q * q / (camera.size + root), q / root
    elif camera.kind == 1:
        z, slope = camera.size * q, camera.size
    elif camera.kind == 2:
        z, slope = camera.size * q * q, 2.0 * camera.size * q
    else:
        parts = camera.first.size
        part = q / camera.rim * parts
        i = camera.first[min(int(part), parts - 1)] if part >= 0.0 else 0  # NaN is no index
        while i < camera.knots.size - 2 and q > camera.knots[i + 1]:
            i += 1
        t = q - camera.knots[i]
        a, b, c = camera.cubics[0, i], camera.cubics[1, i], camera.cubics[2, i]
        z, slope = ((a * t + b) * t + c) * t + camera.cubics[3, i], (3.0 * a * t + 2.0 * b) * t + c
    return z + slope * (r - q), slope


@kernel
def heights(r, camera, z, slope):
    """Write z(r) and its slope at radii `[n]`."""
    for i in range(r.size):
        z[i], slope[i] = _height(r[i], camera)


@kernel(inline=True)
def _meet(d_x, d_y, d_z, camera):
    """Where a ray from the camera centre meets the mirror: `p_x, p_y, p_z`, the slope there, and whether it does."""
    c_x, c_y, c_z = camera.c_x, camera.c_y, camera.c_z
    s, least, most = 0.0, 0.0, math.inf
    across = math.sqrt(d_x * d_x + d_y * d_y)
    if not across < math.inf:  # NaN, beyond where the lens folds the image over
        return math.nan, math.nan, math.nan, math.nan, False
    if across < camera.widest * d_z:
        parts = camera.depths.size - 1
        at = across / (d_z * camera.widest) * parts
        i = min(int(at), parts - 1)
        s = (camera.depths[i] + (at - i) * (camera.depths[i + 1] - camera.depths[i])) / d_z
    for _ in range(200):
        p_x, p_y, p_z = c_x + s * d_x, c_y + s * d_y, c_z + s * d_z
        r = math.sqrt(p_x * p_x + p_y * p_y)
        z, slope = _height(r, camera)
        excess = p_z - z
        outwards = (p_x * d_x + p_y * d_y) / r if r > 0.0 else across
        rise = d_z - slope * outwards
        s_next = s - excess / rise if rise > 0.0 else math.inf
        if abs(s_next - s) <= 1e-14 * s:  # the slope is that of the step before
            return c_x + s_next * d_x, c_y + s_next * d_y, c_z + s_next * d_z, slope, True
        if excess < 0.0:
            least = s
        else:
            most = s
        if not (least <= s_next <= most and s_next < math.inf):
            if most == math.inf:
                break
            s_next = 0.5 * (least + most)
        s = s_next
    return math.nan, math.nan, math.nan, math.nan, False


@kernel(inline=True)
def _reflect(x, y, camera):
    """As `_reflection_kernels.meet_mirror`, about the apex."""
    d_x = camera.r_xx * x + camera.r_xy * y + camera.r_xz
    d_y = camera.r_yx * x + camera.r_yy * y + camera.r_yz
    d_z = camera.r_zx * x + camera.r_zy * y + camera.r_zz
    p_x, p_y, p_z, slope, hits = _meet(d_x, d_y, d_z, camera)
    r = math.sqrt(p_x * p_x + p_y * p_y)
    n_x = n_y = 0.0
    if r > 0.0:
        n_x, n_y = -slope * p_x / r, -slope * p_y / r
    elif abs(slope) > 1e-9:
        hits = False
    twice = 2.0 * (d_x * n_x + d_y * n_y + d_z) / (n_x * n_x + n_y * n_y + 1.0)
    scale = 1.0 / math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
    return p_x, p_y, p_z, scale * (d_x - twice * n_x), scale * (d_y - twice * n_y), scale * (d_z - twice), hits


@kernel
def reflect_at_profile(u, v, camera, origins, directions, valid):
    """Write where each pixel's ray leaves the mirror, metres, its unit direction, and whether there is one.

    `[3, n]` in the sensor's frame; NaN where there is no mirror, however far its surface is continued.
    """
    k1, k2, p1, p2, k3, fold = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.fold
    bent = k1 != 0.0 or k2 != 0.0 or k3 != 0.0 or p1 != 0.0 or p2 != 0.0
    field = camera.field
    for i in range(u.size):
        x, y = from_pixel(u[i], v[i], camera)
        if bent:
            x, y = unbend(x, y, k1, k2, p1, p2, k3, fold)
        p_x, p_y, p_z, r_x, r_y, r_z, hits = _reflect(x, y, camera)
        if not hits:
            origins[0, i] = origins[1, i] = origins[2, i] = math.nan
            directions[0, i] = directions[1, i] = directions[2, i] = math.nan
            valid[i] = False
            continue
        reaches = p_x * p_x + p_y * p_y <= camera.rim * camera.rim
        p_x, p_y, p_z = to_sensor(p_x, p_y, p_z - camera.viewpoint, camera)
        r_x, r_y, r_z = to_sensor(r_x, r_y, r_z, camera)
        up, ahead = along_up(r_x, r_y, r_z, field), along_axis(r_x, r_y, r_z, field)
        valid[i] = reaches and field.lowest <= up <= field.highest and ahead >= field.nearest
        origins[0, i], origins[1, i], origins[2, i] = p_x, p_y, p_z
        directions[0, i], directions[1, i], directions[2, i] = r_x, r_y, r_z
