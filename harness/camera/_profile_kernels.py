"""A perspective camera that sees the world in a mirror of revolution: the ray of a pixel by the law of reflection.

The camera's ray `C + s d` meets the profile where `F(s) = p_z - z(r) = 0`, r the distance of p from the axis. The ray
leaves in the direction `d - 2 (d·n) n`, n along `(-z' p_x/r, -z' p_y/r, 1)`.

Spheres, cones and paraboloids are quadrics, `Q(p) = r² + k z² - 2 m z = 0`: with `Q(C + s d) = A s² + 2 B s + G`, light
comes from outside at the root at which Q falls, `s = (-B - sqrt(B² - A G))/A`, and the slope there is `r/(m - k z)`.

In front of a convex mirror F is concave and starts below 0, so that Newton's method approaches the first zero from
below without a step beyond it, and from beyond comes below it at once; for others a bisection takes over once F has
changed its sign. It begins where an aligned camera's ray would meet the mirror (`_meet`).

On a profile of pieces a few steps of Halley's method, `s - F F'/(F'² - F F''/2)`, suffice from there, as many for
nearly all rays: those are computed together in vector instructions, and only the others by `_meet`. A ray does not
depend on which others are computed with it.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._lens_kernels import unbend
from harness.camera._pixel_kernels import from_pixel
from harness.camera._reflection_kernels import to_sensor
from harness.compiled import kernel

_SMALL = 1e-6
"""Largest last step of Halley's method on one piece, as a share of s: the error that remains goes with its cube."""
_BLOCK = 512
"""Rays that pass through the loops together: their data stay in the CPU's first-level cache."""


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
    """`[4, n]`: coefficients of the pieces in the distance from the left knot, the highest power first."""
    first: Any
    """`[m]`, int32: the piece in which each of m equal parts of 0 .. rim begins, or the one before it."""
    sparse: bool
    """Whether no part holds more than one knot."""
    depths: Any
    """`[n + 1]`: depths, along the axis, at which an aligned camera's rays of evenly spaced slopes meet the mirror."""
    widest: float
    """The last of these slopes; steeper rays begin at the camera."""
    steps: int
    """Steps of the iteration that suffice for nearly all rays."""
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


@kernel
def _meet(d_x, d_y, d_z, camera):
    """The intersection of a ray from the camera centre with the mirror: s, and the slope there; NaN without one."""
    c_x, c_y, c_z = camera.c_x, camera.c_y, camera.c_z
    s, least, most = 0.0, 0.0, math.inf
    across = math.sqrt(d_x * d_x + d_y * d_y)
    if not across < math.inf:  # NaN, beyond where the lens folds the image over
        return math.nan, math.nan
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
            return s_next, slope
        if excess < 0.0:
            least = s
        else:
            most = s
        if not (least <= s_next <= most and s_next < math.inf):
            if most == math.inf:
                break
            s_next = 0.5 * (least + most)
        s = s_next
    return math.nan, math.nan


@kernel
def _meet_quadric(camera, rays, s, slope, met):
    """Write for rays `[3, n]` where they meet the quadric, the slope there, and whether that is within the rim."""
    size, of_cone, widest = camera.size, camera.kind == 1, camera.rim * camera.rim
    k, m = 0.0, 0.5 / size
    if camera.kind == 0:
        k, m = 1.0, size
    elif of_cone:
        k, m = -1.0 / (size * size), 0.0
    c_x, c_y, c_z = camera.c_x, camera.c_y, camera.c_z
    G = c_x * c_x + c_y * c_y + k * c_z * c_z - 2.0 * m * c_z
    d_x_of, d_y_of, d_z_of = rays[0], rays[1], rays[2]
    for i in range(s.size):
        d_x, d_y, d_z = d_x_of[i], d_y_of[i], d_z_of[i]
        A = d_x * d_x + d_y * d_y + k * d_z * d_z
        B = c_x * d_x + c_y * d_y + (k * c_z - m) * d_z
        root = math.sqrt(B * B - A * G)
        # The same root in two forms, of which one adds numbers of one sign.
        ahead = B <= 0.0
        s_i = (G if ahead else -(B + root)) / (root - B if ahead else A)
        p_x, p_y, p_z = c_x + s_i * d_x, c_y + s_i * d_y, c_z + s_i * d_z
        across = p_x * p_x + p_y * p_y
        below = m - k * p_z
        s[i] = s_i
        slope[i] = size if of_cone else math.sqrt(across) / below
        met[i] = (s_i > 0.0) & (across <= widest) & (below > 0.0)
    if of_cone:
        # Near the tip the two roots are one, and half of the digits are lost: a step of Newton's method.
        for i in range(s.size):
            d_x, d_y, d_z, s_i = d_x_of[i], d_y_of[i], d_z_of[i], s[i]
            p_x, p_y, p_z = c_x + s_i * d_x, c_y + s_i * d_y, c_z + s_i * d_z
            r = math.sqrt(p_x * p_x + p_y * p_y)
            s_next = s_i - (p_z - size * r) / (d_z - size * (p_x * d_x + p_y * d_y) / r)
            met[i] &= abs(s_next - s_i) <= 1e-9 * s_i  # the error goes with the square
            s[i] = s_next


@kernel(inline=True)
def _look_up(r, camera, piece):
    """Write for radii `[n]` to `piece [6, n]` the distances from the left knot, those of the right one, and the cubics.

    For profiles of which every part of the radius holds at most one knot.
    """
    knots, cubics, first, rim = camera.knots, camera.cubics, camera.first, camera.rim
    parts = np.int32(first.size)
    per_metre = parts / rim
    for i in range(r.size):
        q = min(r[i], rim)
        q = q if q >= 0.0 else 0.0  # noqa: FURB136  (NaN is no index)
        part = np.int32(q * per_metre)
        j = np.uint32(first[np.uint32(part if part < parts else parts - np.int32(1))])
        j = np.uint32(j + np.uint32(q > knots[np.uint32(j + np.uint32(1))]))
        j = np.uint32(j + np.uint32(q > knots[np.uint32(j + np.uint32(1))]))
        left = knots[j]
        piece[0, i], piece[1, i] = q - left, knots[np.uint32(j + np.uint32(1))] - left
        piece[2, i], piece[3, i], piece[4, i], piece[5, i] = cubics[0, j], cubics[1, j], cubics[2, j], cubics[3, j]


@kernel
def meet_pieces(camera, rays, s, slope, met):
    """Write what `_meet_quadric` does, for a profile of pieces; false also for rays that take more steps, or end on
    another piece.

    The loops without branches and look-ups are apart, so that the compiler makes vector instructions of them.
    """
    c_x, c_y, c_z, widest, rim = camera.c_x, camera.c_y, camera.c_z, camera.widest, camera.rim
    depths, parts = camera.depths, camera.depths.size - 1.0
    radius, step, least, most = np.empty((4, _BLOCK))
    piece = np.empty((6, _BLOCK))
    for start in range(0, s.size, _BLOCK):
        n = min(_BLOCK, s.size - start)
        block = slice(start, start + n)
        d_x, d_y, d_z = rays[0, block], rays[1, block], rays[2, block]
        s_of, met_of, slope_of = s[block], met[block], slope[block]
        for i in range(n):
            at = math.sqrt(d_x[i] * d_x[i] + d_y[i] * d_y[i]) / (d_z[i] * widest) * parts
            met_of[i] = (at >= 0.0) & (at < parts)
            step[i] = at if (at >= 0.0) & (at < parts) else 0.0
            least[i], most[i] = 0.0, math.inf
        for i in range(n):
            j = np.uint32(step[i])
            depth = depths[j]
            s_of[i] = (depth + (step[i] - j) * (depths[np.uint32(j + np.uint32(1))] - depth)) / d_z[i]
        for _ in range(camera.steps):
            for i in range(n):
                p_x, p_y = c_x + s_of[i] * d_x[i], c_y + s_of[i] * d_y[i]
                radius[i] = math.sqrt(p_x * p_x + p_y * p_y)
            _look_up(radius[:n], camera, piece)
            for i in range(n):
                s_i, r, t, a, b, c = s_of[i], radius[i], piece[0, i], piece[2, i], piece[3, i], piece[4, i]
                p_x, p_y, p_z = c_x + s_i * d_x[i], c_y + s_i * d_y[i], c_z + s_i * d_z[i]
                steep = (3.0 * a * t + 2.0 * b) * t + c
                beyond = r - rim
                z = ((a * t + b) * t + c) * t + piece[5, i] + (steep * beyond if beyond > 0.0 else 0.0)
                outwards = (p_x * d_x[i] + p_y * d_y[i]) / r
                excess, rise = p_z - z, d_z[i] - steep * outwards
                bend = -(6.0 * a * t + 2.0 * b) * outwards * outwards
                bend -= steep * (d_x[i] * d_x[i] + d_y[i] * d_y[i] - outwards * outwards) / r
                s_next = s_i - excess * rise / (rise * rise - 0.5 * excess * bend)
                least[i] = s_i if excess < 0.0 else least[i]
                most[i] = most[i] if excess < 0.0 else s_i
                step[i] = abs(s_next - s_i) / s_i
                # A last step is rounding, and may leave the bounds.
                sound = (rise > 0.0) & (((least[i] <= s_next) & (s_next <= most[i])) | (step[i] <= _SMALL))
                s_of[i] = s_next if sound else math.nan
        for i in range(n):
            p_x, p_y = c_x + s_of[i] * d_x[i], c_y + s_of[i] * d_y[i]
            r, a, b = math.sqrt(p_x * p_x + p_y * p_y), piece[2, i], piece[3, i]
            # The slope there, on the piece that the last step began on, as long as it also ended there.
            t = piece[0, i] + (min(r, rim) - min(radius[i], rim))
            slope_of[i] = (3.0 * a * t + 2.0 * b) * t + piece[4, i]
            met_of[i] &= (step[i] <= _SMALL) & (s_of[i] > 0.0) & (t >= 0.0) & (t <= piece[1, i])


@kernel
def reflect_at_profile(u, v, camera, origins, directions, valid):
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
    for i in range(u.size):
        x, y = x_out[i], y_out[i]
        rx_out[i] = camera.r_xx * x + camera.r_xy * y + camera.r_xz
        ry_out[i] = camera.r_yx * x + camera.r_yy * y + camera.r_yz
        rz_out[i] = camera.r_zx * x + camera.r_zy * y + camera.r_zz
    s, slope = x_out, y_out
    if camera.kind != 3:
        _meet_quadric(camera, directions, s, slope, valid)
    elif camera.sparse:
        meet_pieces(camera, directions, s, slope, valid)
    else:
        valid[:] = False
    for i in range(u.size):
        if not valid[i]:
            s[i], slope[i] = _meet(rx_out[i], ry_out[i], rz_out[i], camera)
    field, widest, viewpoint = camera.field, camera.rim * camera.rim, camera.viewpoint
    # Without a branch, as above.
    for i in range(u.size):
        d_x, d_y, d_z, steep = rx_out[i], ry_out[i], rz_out[i], y_out[i]
        p_x, p_y, p_z = camera.c_x + x_out[i] * d_x, camera.c_y + x_out[i] * d_y, camera.c_z + x_out[i] * d_z
        across = p_x * p_x + p_y * p_y
        r = math.sqrt(across)
        # A tip has no normal; NaN where there is no mirror.
        steep = steep / r if r > 0.0 else 0.0 if abs(steep) <= 1e-9 else math.nan
        n_x, n_y = -steep * p_x, -steep * p_y
        twice = 2.0 * (d_x * n_x + d_y * n_y + d_z) / (n_x * n_x + n_y * n_y + 1.0)
        scale = 1.0 / math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
        r_x, r_y, r_z = scale * (d_x - twice * n_x), scale * (d_y - twice * n_y), scale * (d_z - twice)
        p_x, p_y, p_z = to_sensor(p_x, p_y, p_z - viewpoint, camera)
        r_x, r_y, r_z = to_sensor(r_x, r_y, r_z, camera)
        up, ahead = along_up(r_x, r_y, r_z, field), along_axis(r_x, r_y, r_z, field)
        hits = twice == twice  # noqa: PLR0124  (not NaN)
        valid[i] = (across <= widest) & (up >= field.lowest) & (up <= field.highest) & (ahead >= field.nearest)
        x_out[i] = p_x if hits else math.nan
        y_out[i] = p_y if hits else math.nan
        z_out[i] = p_z if hits else math.nan
        rx_out[i], ry_out[i], rz_out[i] = r_x, r_y, r_z
