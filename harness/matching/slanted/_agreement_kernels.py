"""Compiled loops over the nine windows that a pixel may take its plane from, some dozens of columns at a time."""

import math

from harness.compiled import kernel

TILE = 64
"""Columns side by side. Rows of a tile lie as far apart, so that compilers see that columns are independent."""
LOWEST, HIGHEST, OWN, AGREED = 0, TILE, 2 * TILE, 3 * TILE
"""The least and the greatest inverse range of a pixel's planes, that of its own, 0 if it has none, and 1 where all
agree, else 0."""
TILE_X, TILE_Y, TILE_Z = 4 * TILE, 5 * TILE, 6 * TILE
"""The pixels' directions."""
TILE_ROWS = 7


@kernel
def agree(i, begin, half, apart, w_far, w_near, x, t, plane, residual, planes, tile):
    """Write where the planes of nine windows, the own one and those moved by `half` pixels, agree to within `apart`.

    begin : the first of the row's columns. apart : radians of alpha_2. planes : `[3, TILE + 2 half]`, scratch.
    """
    n = min(TILE, x.shape[1] - begin)
    for j in range(TILE):
        tile[LOWEST + j], tile[HIGHEST + j], tile[OWN + j] = math.inf, -math.inf, 0.0
    here = x[i, begin : begin + n]
    for j in range(n):
        tile[TILE_X + j], tile[TILE_Y + j], tile[TILE_Z + j] = here[j, 0], here[j, 1], here[j, 2]
    for row in range(i - half, i + half + 1, half):
        if 0 <= row < x.shape[0]:
            _gather(row, begin - half, plane, residual, planes)
            for k in range(3):
                _extend(planes, k * half, w_far, w_near, tile, row == i and k == 1)
    for j in range(n):
        lowest, highest, own = tile[LOWEST + j], tile[HIGHEST + j], tile[OWN + j]
        x_0, x_1, x_2 = tile[TILE_X + j], tile[TILE_Y + j], tile[TILE_Z + j]
        middle = 0.5 * (lowest + highest)
        # d alpha_2/dw = |t × x|/|x - w t|²
        across = (t[1] * x_2 - t[2] * x_1) ** 2 + (t[2] * x_0 - t[0] * x_2) ** 2 + (t[0] * x_1 - t[1] * x_0) ** 2
        away = (x_0 - middle * t[0]) ** 2 + (x_1 - middle * t[1]) ** 2 + (x_2 - middle * t[2]) ** 2
        is_same = highest - lowest <= apart * away / math.sqrt(across)
        tile[AGREED + j] = 1.0 if is_same & (own > 0.0) else 0.0


@kernel
def _gather(row, begin, plane, residual, planes):
    """Write the planes of some columns of a row, from `begin` on, one component after the other; NaN where there is
    none.
    """
    first, end = max(0, -begin), min(planes.shape[1], residual.shape[1] - begin)
    planes[:, :first] = math.nan
    planes[:, end:] = math.nan
    for j in range(first, end):
        m = plane[row, begin + j]
        planes[0, j] = m[0] if residual[row, begin + j] < math.inf else math.nan
        planes[1, j], planes[2, j] = m[1], m[2]


@kernel
def _extend(planes, shift, w_far, w_near, tile, is_own):
    """Extend the pixels' inverse ranges by those of the planes from a column on, where there are planes."""
    m_x, m_y, m_z = planes[0, shift:], planes[1, shift:], planes[2, shift:]
    for j in range(TILE):
        value = m_x[j] * tile[TILE_X + j] + m_y[j] * tile[TILE_Y + j] + m_z[j] * tile[TILE_Z + j]
        is_plane = (w_far <= value) & (value <= w_near)
        lowest, highest = tile[LOWEST + j], tile[HIGHEST + j]
        tile[LOWEST + j] = value if is_plane & (value < lowest) else lowest
        tile[HIGHEST + j] = value if is_plane & (value > highest) else highest
        if is_own:
            tile[OWN + j] = value if is_plane else 0.0
