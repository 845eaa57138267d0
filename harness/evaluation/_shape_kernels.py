"""Compiled loops over maps of ranges. Called through `shape_scores`.

Where a map goes around, its first and last columns are neighbours.
"""

import math

from harness.compiled import kernel


@kernel
def sobel(range_m, around, out):
    """Write the length of Sobel's gradient, `[height, width]`, of the 3 x 3 pixels around; NaN where one has no range,
    and at the map's border.
    """
    height, width = range_m.shape
    for i in range(height):
        for j in range(width):
            if i == 0 or i == height - 1 or (not around and (j == 0 or j == width - 1)):
                out[i, j] = math.nan
                continue
            west, east = j - 1 if j else width - 1, j + 1 if j < width - 1 else 0
            a, b, c = range_m[i - 1, west], range_m[i - 1, j], range_m[i - 1, east]
            d, f = range_m[i, west], range_m[i, east]
            g, h, k = range_m[i + 1, west], range_m[i + 1, j], range_m[i + 1, east]
            across = (c + 2 * f + k) - (a + 2 * d + g)
            down = (g + 2 * h + k) - (a + 2 * b + c)
            # The pixel itself has no weight, but without a range there is nothing to be an edge.
            out[i, j] = math.sqrt(across * across + down * down) + 0.0 * range_m[i, j]


@kernel
def normals(range_m, directions, around, out):
    """Write unit normals towards the viewpoint, `[height, width, 3]`, by the points of the four neighbours; NaN where
    one has no range, and at the border.
    """
    height, width = range_m.shape
    for i in range(height):
        for j in range(width):
            if i == 0 or i == height - 1 or (not around and (j == 0 or j == width - 1)):
                out[i, j, 0] = out[i, j, 1] = out[i, j, 2] = math.nan
                continue
            west, east = j - 1 if j else width - 1, j + 1 if j < width - 1 else 0
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


@kernel
def compare(
    edge, normal, true_edge, true_normal, domain, smooth, limits_m, limits_deg, boundaries, angles, within
):  # fmt: skip
    """Count boundary pixels, and add up the angles between normals, over the domain.

    edge, normal, true_edge, true_normal : of estimate and truth, as `sobel` and `normals` write them.
    boundaries : written, `[limits, 3]`: boundary pixels of the truth, of the estimate, of both.
    angles : written, `[3]`: normals that both have, the sum of their angles in degrees, and of the squares of these.
    within : written, `[limits]`: angles below each of `limits_deg`.
    """
    height, width = edge.shape
    for i in range(height):
        for j in range(width):
            if not domain[i, j]:
                continue
            true, found = true_edge[i, j], edge[i, j]
            if not math.isnan(true):
                for k in range(limits_m.size):
                    in_truth, in_estimate = true > limits_m[k], found > limits_m[k]  # a NaN is not
                    boundaries[k, 0] += in_truth
                    boundaries[k, 1] += in_estimate
                    boundaries[k, 2] += in_truth and in_estimate
            if not smooth[i, j]:
                continue
            cosine = (
                normal[i, j, 0] * true_normal[i, j, 0]
                + normal[i, j, 1] * true_normal[i, j, 1]
                + normal[i, j, 2] * true_normal[i, j, 2]
            )
            if math.isnan(cosine):
                continue
            angle = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
            angles[0] += 1.0
            angles[1] += angle
            angles[2] += angle * angle
            for k in range(limits_deg.size):
                within[k] += angle < limits_deg[k]
