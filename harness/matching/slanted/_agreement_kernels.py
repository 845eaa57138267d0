"""Compiled loops over the nine windows that a pixel may take its plane from, some dozens of columns at a time."""

import math

from harness.compiled import kernel

TILE = 64
"""Columns side by side. Rows of a tile lie as far apart, so that compilers see that columns are independent."""
LOWEST, HIGHEST, SAME = 0, TILE, 2 * TILE
"""The least and the greatest inverse range of a pixel's planes, and by how much those of one surface differ at most."""
TILE_X, TILE_Y, TILE_Z = 3 * TILE, 4 * TILE, 5 * TILE
"""The pixels' directions."""
PLANES = 6 * TILE
"""The inverse ranges of the nine planes, a row for each; NaN where there is none."""
OWN = PLANES + 4 * TILE
TILE_ROWS = 15


@kernel
def compare_planes(i, begin, half, apart, w_far, w_near, x, t, plane, residual, planes, tile):
    """Write the inverse ranges of the planes of nine windows, the own one and those moved by `half` pixels, and how far
    apart they are.

    begin : the first of the row's columns. apart : of planes of one surface, radians of alpha_2.
    planes : `[3, TILE + 2 half]`, scratch. tile : `[TILE_ROWS * TILE]`, written.
    """
    n = min(TILE, x.shape[1] - begin)
    for j in range(TILE):
        tile[LOWEST + j], tile[HIGHEST + j] = math.inf, -math.inf
    here = x[i, begin : begin + n]
    for j in range(n):
        tile[TILE_X + j], tile[TILE_Y + j], tile[TILE_Z + j] = here[j, 0], here[j, 1], here[j, 2]
    for which in range(3):
        row = i + (which - 1) * half
        if not 0 <= row < x.shape[0]:
            tile[PLANES + 3 * which * TILE : PLANES + 3 * (which + 1) * TILE] = math.nan
        else:
            _gather(row, begin - half, plane, residual, planes)
            for k in range(3):
                _extend(planes, k * half, w_far, w_near, tile, PLANES + (3 * which + k) * TILE)
    for j in range(n):
        x_0, x_1, x_2 = tile[TILE_X + j], tile[TILE_Y + j], tile[TILE_Z + j]
        middle = 0.5 * (tile[LOWEST + j] + tile[HIGHEST + j])
        # d alpha_2/dw = |t × x|/|x - w t|²
        across = (t[1] * x_2 - t[2] * x_1) ** 2 + (t[2] * x_0 - t[0] * x_2) ** 2 + (t[0] * x_1 - t[1] * x_0) ** 2
        away = (x_0 - middle * t[0]) ** 2 + (x_1 - middle * t[1]) ** 2 + (x_2 - middle * t[2]) ** 2
        tile[SAME + j] = apart * away / math.sqrt(across)


@kernel
def _gather(row, begin, plane, residual, planes):
    """Write the planes of some columns of a row, from `begin` on, one component after the other; NaN where there is
    none.
    """
    first, end = max(0, -begin), min(planes.shape[1], residual.shape[1] - begin)
    for k in range(3):
        planes[k, :first] = math.nan
        planes[k, end:] = math.nan
    m, there = plane[row, begin + first : begin + end], residual[row, begin + first : begin + end]
    m_x, m_y, m_z = planes[0, first:], planes[1, first:], planes[2, first:]
    for j in range(there.shape[0]):
        x, y, z = m[j, 0], m[j, 1], m[j, 2]
        m_x[j] = x if there[j] < math.inf else math.nan
        m_y[j], m_z[j] = y, z


@kernel
def _extend(planes, shift, w_far, w_near, tile, to):
    """Write the inverse ranges of the planes from a column on to a row of the tile; extend the pixels' own by them."""
    m_x, m_y, m_z, out = planes[0, shift:], planes[1, shift:], planes[2, shift:], tile[to:]
    for j in range(TILE):
        value = m_x[j] * tile[TILE_X + j] + m_y[j] * tile[TILE_Y + j] + m_z[j] * tile[TILE_Z + j]
        is_plane = (w_far <= value) & (value <= w_near)
        lowest, highest = tile[LOWEST + j], tile[HIGHEST + j]
        tile[LOWEST + j] = value if is_plane & (value < lowest) else lowest
        tile[HIGHEST + j] = value if is_plane & (value > highest) else highest
        out[j] = value if is_plane else math.nan
