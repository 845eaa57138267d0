"""Compiled loops over rays and pixels. Called through `cast` and `render`, which check the arguments."""

import math

from numba import njit

TRACE = -2
"""In the map of pixel faces: the pixel must be traced sample by sample. -1 is the background."""
INVALID = -3
"""In the map of pixel faces: outside the sensor's field."""


@njit(cache=True, nogil=True, error_model="numpy")
def verify_hits(corners, normals, offsets, face_of_triangle, origin, directions, search_misses, triangle, range_m):
    """Put Embree's float32 hits right in float64; write the range along each direction, NaN for none.

    A ray is inside a triangle when the three products `d · (v_i x v_j)` have one sign. For a side that two triangles
    share this number is exactly opposite in the other one, so that in float64 no ray passes between them. Rays whose
    triangle does not hold up are searched for in all triangles, if need be with a hair of tolerance for sides that
    coincide but do not share their end points.
    """
    cx, cy, cz = origin
    for i in range(triangle.size):
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        guess = triangle[i]
        best, best_range = -1, math.inf
        if guess >= 0 or search_misses:
            for attempt in range(3):
                if attempt == 0:
                    if guess < 0:
                        continue
                    first, last, tolerance = guess, guess + 1, 0.0
                else:
                    first, last, tolerance = 0, corners.shape[0], 0.0 if attempt == 1 else 1e-9
                for k in range(first, last):
                    ax, ay, az = corners[k, 0, 0] - cx, corners[k, 0, 1] - cy, corners[k, 0, 2] - cz
                    bx, by, bz = corners[k, 1, 0] - cx, corners[k, 1, 1] - cy, corners[k, 1, 2] - cz
                    ex, ey, ez = corners[k, 2, 0] - cx, corners[k, 2, 1] - cy, corners[k, 2, 2] - cz
                    w0 = dx * (by * ez - bz * ey) + dy * (bz * ex - bx * ez) + dz * (bx * ey - by * ex)
                    w1 = dx * (ey * az - ez * ay) + dy * (ez * ax - ex * az) + dz * (ex * ay - ey * ax)
                    w2 = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
                    slack = tolerance * (abs(w0) + abs(w1) + abs(w2))
                    if (w0 >= -slack and w1 >= -slack and w2 >= -slack) or (
                        w0 <= slack and w1 <= slack and w2 <= slack
                    ):
                        f = face_of_triangle[k]
                        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
                        s = (offsets[f] - (nx * cx + ny * cy + nz * cz)) / (nx * dx + ny * dy + nz * dz)
                        if 0.0 < s < best_range:
                            best, best_range = k, s
                if best >= 0:
                    break
        triangle[i] = best
        range_m[i] = best_range if best >= 0 else math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def rotate_rays(rays, rotation, out):
    """World directions `out [n, 3]`, float32, of rays `[3, n]` in the sensor's frame."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for i in range(rays.shape[1]):
        x, y, z = rays[0, i], rays[1, i], rays[2, i]
        out[i, 0] = r00 * x + r01 * y + r02 * z
        out[i, 1] = r10 * x + r11 * y + r12 * z
        out[i, 2] = r20 * x + r21 * y + r22 * z


@njit(cache=True, nogil=True, error_model="numpy")
def mark_edges(edges, viewpoint, rotation, sensor, step, marks):
    """Set `marks [height, width]` in the 3x3 pixels around every point of every edge.

    An edge is an arc of a great circle. It is sampled at angles of at most `step`, which spans less than one
    pixel, and each sample is projected as `harness.camera.sensor.project` does it.
    """
    a, b, e, fu, fv, cu, cv, k1, k2, p1, p2, k3, fold = sensor
    height, width = marks.shape
    for k in range(edges.shape[0]):
        x, y, z = edges[k, 0, 0] - viewpoint[0], edges[k, 0, 1] - viewpoint[1], edges[k, 0, 2] - viewpoint[2]
        px = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
        py = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
        pz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
        x, y, z = edges[k, 1, 0] - viewpoint[0], edges[k, 1, 1] - viewpoint[1], edges[k, 1, 2] - viewpoint[2]
        qx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
        qy = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
        qz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
        length = math.sqrt(px * px + py * py + pz * pz)
        px, py, pz = px / length, py / length, pz / length
        along = px * qx + py * qy + pz * qz
        qx, qy, qz = qx - along * px, qy - along * py, qz - along * pz
        across = math.sqrt(qx * qx + qy * qy + qz * qz)
        if across > 0.0:
            qx, qy, qz = qx / across, qy / across, qz / across
        angle = math.atan2(across, along)
        samples = max(1, math.ceil(angle / step))
        cosine, sine = math.cos(angle / samples), math.sin(angle / samples)
        c, s = math.cos(0.5 * angle / samples), math.sin(0.5 * angle / samples)
        for _ in range(samples):
            dx, dy, dz = c * px + s * qx, c * py + s * qy, c * pz + s * qz
            c, s = c * cosine - s * sine, s * cosine + c * sine
            reach = a - e * dz
            if reach <= 0.0:
                continue
            scale = b * b / reach
            below = scale * dz + 2.0 * e
            x, y = scale * dx / below, scale * dy / below
            r2 = x * x + y * y
            if r2 > fold * fold:
                continue
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            u = fu * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cu
            v = fv * (y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)) + cv
            if not (-2.0 < u < width + 1.0 and -2.0 < v < height + 1.0):
                continue
            column, row = math.floor(u + 0.5), math.floor(v + 0.5)
            for i in range(max(0, row - 1), min(height, row + 2)):
                for j in range(max(0, column - 1), min(width, column + 2)):
                    marks[i, j] = True


@njit(cache=True, nogil=True, error_model="numpy")
def classify_pixels(corner_face, valid, marks, out):
    """Write for each pixel the one face that fills it, or TRACE, or INVALID.

    `corner_face [height + 1, width + 1]` is the face hit at each pixel corner.
    """
    height, width = valid.shape
    for i in range(height):
        for j in range(width):
            if not valid[i, j]:
                out[i, j] = INVALID
                continue
            face = corner_face[i, j]
            same = face == corner_face[i, j + 1] == corner_face[i + 1, j] and face == corner_face[i + 1, j + 1]
            out[i, j] = face if same and not marks[i, j] else TRACE


@njit(cache=True, nogil=True, error_model="numpy")
def subsample_positions(rows, columns, per_side, u, v):
    """Write the sample positions of pixels: a regular per_side x per_side grid inside each, all of a pixel
    together.
    """
    k = 0
    for i in range(rows.size):
        for a in range(per_side):
            for b in range(per_side):
                u[k] = columns[i] + ((b + 0.5) / per_side - 0.5)
                v[k] = rows[i] + ((a + 0.5) / per_side - 0.5)
                k += 1


@njit(cache=True, nogil=True, error_model="numpy")
def shade(rays, samples, face_of_sample, H, texture_of_face, texels, texture_place, background, out):
    """Write the mean grey of each pixel's samples.

    Parameters are `rays [3, pixels * samples]` in the sensor's frame; `face_of_sample`, one for each ray or one
    for each pixel; `H [faces, 3, 3]` that maps the ray to (u w, v w, w), with u and v measured from the first
    texel's centre and v down; `texels`, all textures laid end to end, each with its first two rows and columns
    repeated after the last so that a bilinear lookup needs no wrapping; and `texture_place [textures, 3]`,
    start, height and width of each.
    """
    per_pixel = face_of_sample.size == out.size
    for i in range(out.size):
        total = 0.0
        for k in range(i * samples, (i + 1) * samples):
            face = face_of_sample[i] if per_pixel else face_of_sample[k]
            if face < 0:
                total += background
                continue
            x, y, z = rays[0, k], rays[1, k], rays[2, k]
            inverse = 1.0 / (H[face, 2, 0] * x + H[face, 2, 1] * y + H[face, 2, 2] * z)
            u = (H[face, 0, 0] * x + H[face, 0, 1] * y + H[face, 0, 2] * z) * inverse
            v = (H[face, 1, 0] * x + H[face, 1, 1] * y + H[face, 1, 2] * z) * inverse
            start, height, width = texture_place[texture_of_face[face]]
            column = (u - math.floor(u)) * width
            row = (v - math.floor(v)) * height
            left, above = int(column), int(row)
            right_weight, below_weight = column - left, row - above
            corner = start + above * (width + 2) + left
            upper = texels[corner] + right_weight * (texels[corner + 1] - texels[corner])
            corner += width + 2
            lower = texels[corner] + right_weight * (texels[corner + 1] - texels[corner])
            total += upper + below_weight * (lower - upper)
        out[i] = total / samples
