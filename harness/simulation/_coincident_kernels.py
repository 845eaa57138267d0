"""Compiled loops over triangles in one plane. Called through `coincident`, which checks the arguments."""

import math

import numpy as np

from harness.compiled import kernel


@kernel
def overlapping(
    order, node_low, node_high, leaf, low, high, corners, face_of_triangle, normals, offsets, tolerance, most, out
):
    """Write pairs of faces whose coplanar triangles overlap, the earlier face first, up to the size of `out`.

    order, node_low, node_high, leaf : the tree over the triangles' boxes `low`, `high`, see `box_tree`.

    Returns the number of pairs, some of which occur repeatedly. Stops when there are more than `most`.
    """
    count = 0
    first_leaf = node_low.shape[0] // 2
    waiting = np.empty(64, dtype=np.int64)
    for i in range(order.size):
        t = order[i]
        waiting[0] = 1
        depth = 1
        while depth:
            depth -= 1
            node = waiting[depth]
            if _apart(node_low[node], node_high[node], low[t], high[t]):
                continue
            if node < first_leaf:
                waiting[depth], waiting[depth + 1] = 2 * node + 1, 2 * node
                depth += 2
                continue
            begin = (node - first_leaf) * leaf
            for j in range(max(begin, i + 1), min(begin + leaf, order.size)):
                u = order[j]
                if face_of_triangle[t] == face_of_triangle[u] or _apart(low[u], high[u], low[t], high[t]):
                    continue
                a, b = (t, u) if face_of_triangle[t] < face_of_triangle[u] else (u, t)
                if _coincide(a, b, corners, face_of_triangle, normals, offsets, tolerance):
                    if count < out.shape[0]:
                        out[count, 0], out[count, 1] = face_of_triangle[a], face_of_triangle[b]
                    count += 1
                    if count > most:
                        return count
    return count


@kernel
def _apart(low_1, high_1, low_2, high_2):
    apart = False
    for k in range(3):
        apart = apart or low_1[k] > high_2[k] or low_2[k] > high_1[k]
    return apart


@kernel
def _coincide(a, b, corners, face_of_triangle, normals, offsets, tolerance):
    f, g = face_of_triangle[a], face_of_triangle[b]
    in_one_plane = _in_plane(corners[a], normals[g], offsets[g], tolerance) or _in_plane(
        corners[b], normals[f], offsets[f], tolerance
    )
    return in_one_plane and _overlap(corners[a], corners[b], normals[f], tolerance)


@kernel
def _in_plane(triangle, normal, offset, tolerance):
    for k in range(3):
        p = triangle[k]
        if abs(normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset) > tolerance:
            return False
    return True


@kernel
def _overlap(a, b, normal, tolerance):
    """Whether two coplanar triangles share an area: no side of either separates them (separating axes)."""
    for swap in range(2):
        first, second = (a, b) if swap == 0 else (b, a)
        for k in range(3):
            p, q = first[k], first[(k + 1) % 3]
            ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            x, y, z = ey * normal[2] - ez * normal[1], ez * normal[0] - ex * normal[2], ex * normal[1] - ey * normal[0]
            length = math.sqrt(x * x + y * y + z * z)
            low_1, high_1, low_2, high_2 = math.inf, -math.inf, math.inf, -math.inf
            for m in range(3):
                s = (x * first[m, 0] + y * first[m, 1] + z * first[m, 2]) / length
                t = (x * second[m, 0] + y * second[m, 1] + z * second[m, 2]) / length
                low_1, high_1 = min(low_1, s), max(high_1, s)
                low_2, high_2 = min(low_2, t), max(high_2, t)
            if min(high_1, high_2) - max(low_1, low_2) <= 2.0 * tolerance:
                return False
    return True


@kernel
def settle_hits(
    starts, rivals, first_triangle, order, corners, face_of_triangle, normals, offsets, tolerance, origins, directions,
    triangle,
):  # fmt: skip
    """Write the visible triangle of every hit on a face with rivals: the nearest, or at equal range that of the latest
    face.

    starts, rivals : the rivals of face f are `rivals[starts[f] : starts[f + 1]]`, ascending.
    first_triangle, order : the triangles of face f are `order[first_triangle[f] : first_triangle[f + 1]]`.
    origins : `[n, 3]`, or `[1, 3]` if all rays begin in one point.
    """
    for i in range(triangle.size):
        cx, cy, cz = origins[i if origins.shape[0] > 1 else 0]
        if triangle[i] < 0:
            continue
        hit = face_of_triangle[triangle[i]]
        if starts[hit] == starts[hit + 1]:
            continue
        dx, dy, dz = (
            np.float64(directions[i, 0]),
            np.float64(directions[i, 1]),
            np.float64(directions[i, 2]),
        )
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        nearest = _range(normals, offsets, hit, cx, cy, cz, dx, dy, dz)
        latest, shown = hit, triangle[i]
        # First the range of the nearest, then the latest face at that range.
        for turn in range(2):
            for at in range(starts[hit], starts[hit + 1]):
                f = rivals[at]
                s = _range(normals, offsets, f, cx, cy, cz, dx, dy, dz)
                if turn == 0 and not 0.0 < s < nearest:
                    continue
                slope = abs(normals[f, 0] * dx + normals[f, 1] * dy + normals[f, 2] * dz) / length
                if turn == 1 and not (abs(s - nearest) * length * slope <= tolerance and (f > latest or latest < 0)):
                    continue
                for k in range(first_triangle[f], first_triangle[f + 1]):
                    if _inside(corners[order[k]], cx, cy, cz, dx, dy, dz):
                        if turn == 0:
                            nearest = s
                        else:
                            latest, shown = f, order[k]
                        break
            if turn == 0:
                s = _range(normals, offsets, hit, cx, cy, cz, dx, dy, dz)
                slope = abs(normals[hit, 0] * dx + normals[hit, 1] * dy + normals[hit, 2] * dz) / length
                if (s - nearest) * length * slope > tolerance:
                    latest = -1
        triangle[i] = shown


@kernel(inline=True)
def _range(normals, offsets, f, cx, cy, cz, dx, dy, dz):
    nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
    return (offsets[f] - (nx * cx + ny * cy + nz * cz)) / (nx * dx + ny * dy + nz * dz)


@kernel(inline=True)
def _inside(corners, cx, cy, cz, dx, dy, dz):
    """Whether a ray passes through a triangle: the three products `d · (v_i x v_j)` have one sign."""
    ax, ay, az = corners[0, 0] - cx, corners[0, 1] - cy, corners[0, 2] - cz
    bx, by, bz = corners[1, 0] - cx, corners[1, 1] - cy, corners[1, 2] - cz
    ex, ey, ez = corners[2, 0] - cx, corners[2, 1] - cy, corners[2, 2] - cz
    w0 = dx * (by * ez - bz * ey) + dy * (bz * ex - bx * ez) + dz * (bx * ey - by * ex)
    w1 = dx * (ey * az - ez * ay) + dy * (ez * ax - ex * az) + dz * (ex * ay - ey * ax)
    w2 = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
    return (w0 >= 0.0 and w1 >= 0.0 and w2 >= 0.0) or (w0 <= 0.0 and w1 <= 0.0 and w2 <= 0.0)


@kernel
def crossings(corners, p):
    """Number of triangles `[triangles, 3, 3]` that a ray from p intersects, in a generic direction."""
    count = 0
    for i in range(len(corners)):
        count += _goes_through(corners[i], p)
    return count


@kernel
def crossings_of_all(order, node_low, node_high, leaf, corners, points, out):
    """Write the number of `crossings` of every point.

    order, node_low, node_high, leaf : the tree over the triangles' boxes, see `box_tree`. Boxes have a margin, so that
    no rounding here leaves one out.
    """
    first_leaf = node_low.shape[0] // 2
    waiting = np.empty(64, dtype=np.int64)
    for i in range(len(points)):
        p = points[i]
        count = 0
        waiting[0] = 1
        depth = 1
        while depth:
            depth -= 1
            node = waiting[depth]
            if not _meets(node_low[node], node_high[node], p):
                continue
            if node < first_leaf:
                waiting[depth], waiting[depth + 1] = 2 * node + 1, 2 * node
                depth += 2
                continue
            begin = (node - first_leaf) * leaf
            for j in range(begin, min(begin + leaf, order.size)):
                count += _goes_through(corners[order[j]], p)
        out[i] = count


@kernel
def _meets(low, high, p):
    """Whether the ray from p intersects a box; all components of its direction are positive."""
    enter, leave = 0.0, math.inf
    for k in range(3):
        r = (0.537761, 0.279103, 0.795541)[k]
        enter, leave = max(enter, (low[k] - p[k]) / r), min(leave, (high[k] - p[k]) / r)
    return enter <= leave


@kernel
def _goes_through(corners, p):
    """Whether the ray from p intersects a triangle, 1 or 0."""
    r0, r1, r2 = 0.537761, 0.279103, 0.795541
    a0, a1, a2 = corners[0, 0] - p[0], corners[0, 1] - p[1], corners[0, 2] - p[2]
    b0, b1, b2 = corners[1, 0] - p[0], corners[1, 1] - p[1], corners[1, 2] - p[2]
    c0, c1, c2 = corners[2, 0] - p[0], corners[2, 1] - p[1], corners[2, 2] - p[2]
    n0, n1, n2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
    u = n0 * r0 + n1 * r1 + n2 * r2
    v = (c1 * a2 - c2 * a1) * r0 + (c2 * a0 - c0 * a2) * r1 + (c0 * a1 - c1 * a0) * r2
    w = (a1 * b2 - a2 * b1) * r0 + (a2 * b0 - a0 * b2) * r1 + (a0 * b1 - a1 * b0) * r2
    # On one side of all three, and ahead: the determinant has the sign of their sum.
    through = (u > 0 and v > 0 and w > 0) or (u < 0 and v < 0 and w < 0)
    return 1 if through and (a0 * n0 + a1 * n1 + a2 * n2) * (u + v + w) > 0 else 0
