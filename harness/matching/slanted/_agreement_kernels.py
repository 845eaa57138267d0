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
def agree(i, begin, half, apart, w_far, w_near, x, t, plane, residual, tile):
    """Write where the planes of nine windows, the own one and those moved by `half` pixels, agree to within `apart`.

    begin : the first of the row's columns. apart : radians of alpha_2.
    """
    n = min(TILE, x.shape[1] - begin)
    here = x[i, begin : begin + n]
    for j in range(n):
        tile[TILE_X + j], tile[TILE_Y + j], tile[TILE_Z + j] = here[j, 0], here[j, 1], here[j, 2]
        tile[LOWEST + j], tile[HIGHEST + j], tile[OWN + j] = math.inf, -math.inf, 0.0
    for k in range(9):
        row, shift = i + (k // 3 - 1) * half, (k % 3 - 1) * half
        if 0 <= row < x.shape[0]:
            _extend(row, begin + shift, n, w_far, w_near, plane, residual, tile, k == 4)
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
def _extend(row, begin, n, w_far, w_near, plane, residual, tile, is_own):
    """Extend the pixels' inverse ranges by those of the planes of some columns of a row, where there are planes."""
    first, end = max(0, -begin), min(n, residual.shape[1] - begin)
    if end <= first:
        return
    m, there = plane[row, begin + first : begin + end], residual[row, begin + first : begin + end]
    to = tile[first:]  # compilers know of slices that none of their columns counts from the end
    for j in range(m.shape[0]):
        value = m[j, 0] * to[TILE_X + j] + m[j, 1] * to[TILE_Y + j] + m[j, 2] * to[TILE_Z + j]
        is_plane = (there[j] < math.inf) & (w_far <= value) & (value <= w_near)
        lowest, highest = to[LOWEST + j], to[HIGHEST + j]
        to[LOWEST + j] = value if is_plane & (value < lowest) else lowest
        to[HIGHEST + j] = value if is_plane & (value > highest) else highest
        if is_own:
            to[OWN + j] = value if is_plane else 0.0
