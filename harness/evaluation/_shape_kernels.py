"""Compiled loops over maps of ranges, whose first and last columns are neighbours. Called through `shape_scores`."""

import math

from harness.compiled import kernel


@kernel
def sobel(range_m, out):
    """Write the length of Sobel's gradient, `[height, width]`, of the 3 x 3 pixels around; NaN where one has no range,
    and in the first and last rows.
    """
    height, width = range_m.shape
    for i in range(height):
        for j in range(width):
            if i == 0 or i == height - 1:
                out[i, j] = math.nan
                continue
            west, east = (j - 1) % width, (j + 1) % width
            a, b, c = range_m[i - 1, west], range_m[i - 1, j], range_m[i - 1, east]
            d, f = range_m[i, west], range_m[i, east]
            g, h, k = range_m[i + 1, west], range_m[i + 1, j], range_m[i + 1, east]
            across = (c + 2 * f + k) - (a + 2 * d + g)
            down = (g + 2 * h + k) - (a + 2 * b + c)
            # The pixel itself has no weight, but without a range there is nothing to be an edge.
            out[i, j] = math.sqrt(across * across + down * down) + 0.0 * range_m[i, j]


@kernel
def normals(range_m, directions, out):
    """Write unit normals towards the viewpoint, `[height, width, 3]`, by the points of the four neighbours; NaN where
    one has no range, and in the first and last rows.
    """
    height, width = range_m.shape
    for i in range(height):
        for j in range(width):
            if i == 0 or i == height - 1:
                out[i, j, 0] = out[i, j, 1] = out[i, j, 2] = math.nan
                continue
            west, east = (j - 1) % width, (j + 1) % width
            e, w, s, n = range_m[i, east], range_m[i, west], range_m[i + 1, j], range_m[i - 1, j]
            ax = e * directions[i, east, 0] - w * directions[i, west, 0]
            ay = e * directions[i, east, 1] - w * directions[i, west, 1]
            az = e * directions[i, east, 2] - w * directions[i, west, 2]
            bx = s * directions[i + 1, j, 0] - n * directions[i - 1, j, 0]
            by = s * directions[i + 1, j, 1] - n * directions[i - 1, j, 1]
            bz = s * directions[i + 1, j, 2] - n * directions[i - 1, j, 2]
            x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length = math.sqrt(x * x + y * y + z * z)
            towards = x * directions[i, j, 0] + y * directions[i, j, 1] + z * directions[i, j, 2]
            scale = (-1.0 if towards > 0.0 else 1.0) / length if length > 0.0 else math.nan
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = scale * x, scale * y, scale * z
