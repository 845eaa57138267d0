"""Compiled loops over maps of ranges. Called through `shape_scores`, which puts a border of a pixel around a map.

What follows from a row's neighbours is worked out for the row at once, without branches and one component after the
other, so that loops become vectors; nothing of it outlives the row.
"""

import math

import numpy as np

from harness.compiled import kernel


@kernel
def _gradients(bordered, row, out):
    """Write the length of Sobel's gradient, `[width]`, of the 3 x 3 pixels around; NaN where one has no range."""
    for j in range(np.uint64(out.size)):
        middle, east = j + np.uint64(1), j + np.uint64(2)
        a, b, c = bordered[row, j], bordered[row, middle], bordered[row, east]
        d, e, f = bordered[row + 1, j], bordered[row + 1, middle], bordered[row + 1, east]
        g, h, k = bordered[row + 2, j], bordered[row + 2, middle], bordered[row + 2, east]
        across = (c + 2 * f + k) - (a + 2 * d + g)
        down = (g + 2 * h + k) - (a + 2 * b + c)
        # The pixel itself has no weight, but without a range there is nothing to be an edge.
        out[j] = math.sqrt(across * across + down * down) + 0.0 * e


@kernel
def _points(bordered, directions, row, slot, out):
    """Write the points of a row and of the border beside it, `[3, width + 2]`, to one of the slots."""
    width, one = np.uint64(directions.shape[2]), np.uint64(1)
    for axis in range(3):
        for j in range(width):
            out[slot, axis, j + one] = bordered[row + 1, j + one] * directions[axis, row, j]
        out[slot, axis, 0] = bordered[row + 1, 0] * directions[axis, row, width - one]
        out[slot, axis, width + one] = bordered[row + 1, width + one] * directions[axis, row, 0]


@kernel
def _normals_between(points, north, here, south, directions, row, out):
    """Write a row's unit normals towards the viewpoint, `[3, width]`, by the points of the four neighbours."""
    for j in range(np.uint64(out.shape[1])):
        middle, east = j + np.uint64(1), j + np.uint64(2)
        ax = points[here, 0, east] - points[here, 0, j]
        ay = points[here, 1, east] - points[here, 1, j]
        az = points[here, 2, east] - points[here, 2, j]
        bx = points[south, 0, middle] - points[north, 0, middle]
        by = points[south, 1, middle] - points[north, 1, middle]
        bz = points[south, 2, middle] - points[north, 2, middle]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = math.sqrt(x * x + y * y + z * z)
        towards = x * directions[0, row, j] + y * directions[1, row, j] + z * directions[2, row, j]
        scale = (-1.0 if towards > 0.0 else 1.0) / length
        scale = scale if length > 0.0 else math.nan
        out[0, j], out[1, j], out[2, j] = scale * x, scale * y, scale * z


@kernel
def _normals(bordered, directions, row, points, out):
    """Write a row's normals; see `_normals_between`. Rows are asked for from 0 on, one after the other.

    points : `[3, 3, width + 2]`, of the rows around, kept from row to row.
    """
    height = directions.shape[1]
    north, here, south = (row + 2) % 3, row % 3, (row + 1) % 3
    if row == 0:
        points[:] = math.nan
        _points(bordered, directions, 0, here, points)
    if row + 1 < height:
        _points(bordered, directions, row + 1, south, points)
    else:
        points[south] = math.nan
    _normals_between(points, north, here, south, directions, row, out)


@kernel
def edges_and_normals(bordered, directions, edge, normal):
    """Write the gradient, `[height, width]`, and the unit normal, `[3, height, width]`, of every pixel."""
    height, width = edge.shape
    points, row_of_normals = np.empty((3, 3, width + 2)), np.empty((3, width))
    for i in range(height):
        _gradients(bordered, i, edge[i])
        _normals(bordered, directions, i, points, row_of_normals)
        normal[:, i] = row_of_normals


@kernel
def _cosines(normal, true_normal, row, out):
    for j in range(np.uint64(out.size)):
        out[j] = (
            normal[0, j] * true_normal[0, row, j]
            + normal[1, j] * true_normal[1, row, j]
            + normal[2, j] * true_normal[2, row, j]
        )


@kernel
def _levels(values, limits, out):
    """Write how many of the limits each value is above; a NaN is above none."""
    out[:] = 0
    for limit in limits:
        for j in range(np.uint64(out.size)):
            out[j] += values[j] > limit


@kernel
def compare(bordered, directions, true_edge, true_normal, domain, smooth, limits_m, limits_deg, edges, angles, turned):
    """Count boundary pixels, and add up the angles between normals, over the domain.

    bordered : the estimate; true_edge, true_normal : of the truth, as `edges_and_normals` writes them.
    edges : written, `[limits + 1, limits + 1]`: pixels by how many of `limits_m` the true gradient is above, and the
        estimate's.
    angles : written, `[3]`: normals that both have, the sum of their angles in degrees, and of the squares of these.
    turned : written, `[limits + 1]`: angles by how many of `limits_deg` they reach.
    """
    height, width = domain.shape
    points, normal = np.empty((3, 3, width + 2)), np.empty((3, width))
    edge, cosines = np.empty((2, width))
    true_level, level = np.empty((2, width), dtype=np.int32)
    number, total, squares = 0, 0.0, 0.0
    for i in range(height):
        _gradients(bordered, i, edge)
        _normals(bordered, directions, i, points, normal)
        _cosines(normal, true_normal, i, cosines)
        _levels(true_edge[i], limits_m, true_level)
        _levels(edge, limits_m, level)
        for j in range(np.uint64(width)):
            if not domain[i, j]:
                continue
            if not math.isnan(true_edge[i, j]):
                edges[true_level[j], level[j]] += 1
            if not smooth[i, j] or math.isnan(cosines[j]):
                continue
            angle = math.degrees(math.acos(min(max(cosines[j], -1.0), 1.0)))
            number += 1
            total += angle
            squares += angle * angle
            reached = 0
            for limit in limits_deg:
                reached += angle >= limit
            turned[reached] += 1
    angles[0], angles[1], angles[2] = number, total, squares
