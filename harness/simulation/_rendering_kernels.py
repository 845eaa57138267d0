"""Compiled loops over rays and pixels. Called through `cast` and `render`, which check the arguments."""

import math

import numpy as np

from harness.camera._field_kernels import along_axis, along_up
from harness.camera._projection_kernels import project
from harness.compiled import kernel

TRACE = -2
"""Value in the map of pixel faces of a pixel that must be traced sample by sample; -1 is the background."""
INVALID = -3
"""Value in the map of pixel faces of a pixel outside the sensor's field."""
REACH = 0.55
"""Pixels around an edge's sample that the edge may pass through before the next sample, with a margin."""

NARROW = 1.5
"""Texels between neighbouring samples, above which a pixel is sampled twice as closely either way."""
WIDE = 8.0
"""Texels between neighbouring samples, above which a pixel is sampled four times as closely either way."""


@kernel
def verify_hits(corners, normals, offsets, face_of_triangle, origins, directions, search_misses, triangle, range_m):
    """Verify Embree's float32 hits in float64, and correct them; write the range along each direction, NaN for none.

    A ray is inside a triangle when the three products `d · (v_i x v_j)` have the same sign. For a side that two
    triangles share, the product is exactly opposite in the other one, so that in float64 no ray passes between them.
    Rays that miss their triangle are tested against all triangles, if necessary with a small tolerance for sides that
    coincide but do not share their end points.

    `origins [n, 3]`, or `[1, 3]` if all rays begin in one point.
    """
    for i in range(triangle.size):
        cx, cy, cz = origins[i if origins.shape[0] > 1 else 0]
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


@kernel
def face_maps(normals, offsets, uv_maps, viewpoint, rotation, out):
    """Write the homographies `out [faces, 3, 3]` of `harness.simulation.scene_geometry.homographies`."""
    cx, cy, cz = viewpoint
    for f in range(normals.shape[0]):
        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
        distance = offsets[f] - (nx * cx + ny * cy + nz * cz)
        for row in range(3):
            if row < 2:
                ax, ay, az = uv_maps[f, row, 0], uv_maps[f, row, 1], uv_maps[f, row, 2]
                here = ax * cx + ay * cy + az * cz + uv_maps[f, row, 3]
                x, y, z = here * nx + distance * ax, here * ny + distance * ay, here * nz + distance * az
            else:
                x, y, z = nx, ny, nz
            for column in range(3):
                out[f, row, column] = x * rotation[0, column] + y * rotation[1, column] + z * rotation[2, column]


@kernel
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


@kernel
def mark_edges(edges, viewpoint, rotation, camera, field, step, goes_round, marks):
    """Set `marks [height, width]` in every pixel that an edge may pass through; with `goes_round` the image is periodic
    in azimuth.

    An edge is an arc of a great circle. It is sampled at angles of at most `step`, which spans less than 0.9 pixels, so
    that every point of it is within 0.45 of a sample; a sample marks all pixels within REACH of it, its own and often a
    neighbour. Beyond `field` nothing is seen.
    """
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
        p, q = math.sqrt(px * px + py * py + pz * pz), math.sqrt(qx * qx + qy * qy + qz * qz)
        if p == 0.0 or q == 0.0:
            continue
        px, py, pz, qx, qy, qz = px / p, py / p, pz / p, qx / q, qy / q, qz / q
        # A cap of less than half the sphere is convex: an arc whose ends are in it stays in it.
        p_up, q_up = along_up(px, py, pz, field), along_up(qx, qy, qz, field)
        if min(p_up, q_up) > max(field.highest, 0.0) or max(p_up, q_up) < min(field.lowest, 0.0):
            continue
        if max(along_axis(px, py, pz, field), along_axis(qx, qy, qz, field)) < min(field.nearest, 0.0):
            continue
        mx, my, mz = px + qx, py + qy, pz + qz
        m = math.sqrt(mx * mx + my * my + mz * mz)
        if 4.0 - m * m < step * step:
            # The chord is 2 sin(angle/2) and m is 2 cos(angle/2): a short arc, as in any fine mesh. Its midpoint
            # will do.
            samples, c, s, cosine, sine = 1, 1.0, 0.0, 1.0, 0.0
            px, py, pz = mx / m, my / m, mz / m
        else:
            along = px * qx + py * qy + pz * qz
            qx, qy, qz = qx - along * px, qy - along * py, qz - along * pz
            across = math.sqrt(qx * qx + qy * qy + qz * qz)
            qx, qy, qz = qx / across, qy / across, qz / across
            angle = math.atan2(across, along)
            samples = math.ceil(angle / step)
            cosine, sine = math.cos(angle / samples), math.sin(angle / samples)
            c, s = math.cos(0.5 * angle / samples), math.sin(0.5 * angle / samples)
        for _ in range(samples):
            dx, dy, dz = c * px + s * qx, c * py + s * qy, c * pz + s * qz
            c, s = c * cosine - s * sine, s * cosine + c * sine
            u, v, inside = project(dx, dy, dz, camera)
            if not inside:
                continue
            if not (-2.0 < u < width + 1.0 and -2.0 < v < height + 1.0):
                continue
            top, bottom = math.floor(v + 0.5 - REACH), math.floor(v + 0.5 + REACH)
            left, right = math.floor(u + 0.5 - REACH), math.floor(u + 0.5 + REACH)
            for i in range(max(0, top), min(height, bottom + 1)):
                if goes_round:
                    marks[i, left % width] = marks[i, right % width] = True
                    continue
                for j in range(max(0, left), min(width, right + 1)):
                    marks[i, j] = True


@kernel
def faces_of_triangles(triangle, face_of_triangle, out):
    """Write the face of each triangle, and return the number of misses."""
    misses = 0
    for i in range(triangle.size):
        if triangle[i] < 0:
            misses += 1
            out[i] = -1
        else:
            out[i] = face_of_triangle[triangle[i]]
    return misses


@kernel
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


@kernel
def sampling_levels(
    pixels, width, face_of_pixel, per_side, corner_index, corner_rays, H, texture_of_face, texture_layout, level
):
    """Write how many times the samples of pixels, each inside one face, are doubled in each direction: 0, 1 or 2.

    The measure is the longest side of a pixel on its face's tile, in texels, shared among the `per_side` samples along
    it.

    corner_index : `[height + 1, width + 1]`, flat: the column of `corner_rays [3, n]` that holds a pixel corner's ray.
    H, texture_of_face, texture_layout : see `shade`.
    """
    last, last_face = -2, -1
    u_b, v_b, w_b, u_d, v_d, w_d = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(pixels.size):
        pixel, face = pixels[i], face_of_pixel[i]
        level[i] = 0
        if face < 0:
            continue
        column = pixel % width
        corner = pixel + pixel // width
        if pixel == last + 1 and face == last_face and column:
            u_a, v_a, w_a, u_c, v_c, w_c = u_b, v_b, w_b, u_d, v_d, w_d
        else:
            u_a, v_a, w_a = _on_tile(H[face], corner_rays, corner_index[corner])
            u_c, v_c, w_c = _on_tile(H[face], corner_rays, corner_index[corner + width + 1])
        u_b, v_b, w_b = _on_tile(H[face], corner_rays, corner_index[corner + 1])
        u_d, v_d, w_d = _on_tile(H[face], corner_rays, corner_index[corner + width + 2])
        last, last_face = pixel, face
        texture = texture_of_face[face]
        rows, columns = float(texture_layout[texture, 1]), float(texture_layout[texture, 2])
        top = ((u_b - u_a) * columns) ** 2 + ((v_b - v_a) * rows) ** 2
        bottom = ((u_d - u_c) * columns) ** 2 + ((v_d - v_c) * rows) ** 2
        left = ((u_c - u_a) * columns) ** 2 + ((v_c - v_a) * rows) ** 2
        right = ((u_d - u_b) * columns) ** 2 + ((v_d - v_b) * rows) ** 2
        spacing = math.sqrt(max(top, bottom, left, right)) / per_side
        # Where a corner is beyond the plane's horizon, the pixel extends to infinity on the plane.
        positive = w_a > 0.0
        beyond = (w_b > 0.0) != positive or (w_c > 0.0) != positive or (w_d > 0.0) != positive
        if beyond or not spacing <= WIDE:
            level[i] = 2
        elif spacing > NARROW:
            level[i] = 1


@kernel
def faces_in_pixels(face_of_sample, samples, texture_of_face, several, differ):
    """Write whether each pixel's samples lie on several faces, and whether those show different textures."""
    for i in range(several.size):
        first = face_of_sample[i * samples]
        texture = texture_of_face[first] if first >= 0 else -1
        several[i] = differ[i] = False
        for k in range(i * samples + 1, (i + 1) * samples):
            face = face_of_sample[k]
            if face != first:
                several[i] = True
                differ[i] |= (texture_of_face[face] if face >= 0 else -1) != texture


@kernel
def _on_tile(h, rays, i):
    """Tile coordinates (u, v) at which a ray `rays[:, i]` meets a face's plane, and w; see `shade`."""
    x, y, z = rays[0, i], rays[1, i], rays[2, i]
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2] * z
    inverse = 1.0 / w
    return (h[0, 0] * x + h[0, 1] * y + h[0, 2] * z) * inverse, (h[1, 0] * x + h[1, 1] * y + h[1, 2] * z) * inverse, w


@kernel
def sample_positions(pixels, width, offsets, u, v):
    """Write the sample positions of pixels, all of a pixel together: a regular grid with the given offsets
    either way.

    `pixels` are flat indices into an image of this width.
    """
    k = 0
    for i in range(pixels.size):
        row, column = pixels[i] // width, pixels[i] % width
        for a in range(offsets.size):
            for b in range(offsets.size):
                u[k] = column + offsets[b]
                v[k] = row + offsets[a]
                k += 1


@kernel
def shade(chosen, rays, samples, face_of_sample, H, texture_of_face, texels, texture_layout, background, pixels, image):
    """Write the mean grey of the samples of chosen pixels, indices into `pixels`, into the flat `image`.

    `rays [3, pixels * samples]` are in the sensor's frame. `face_of_sample` has an entry for each ray, or one
    for each pixel. `H [faces, 3, 3]` maps a ray to (u w, v w, w), with u and v in repetitions from the first
    texel's centre and v down. `texels` are all textures laid end to end, each with its first two rows and
    columns repeated after the last so that a bilinear lookup needs no wrapping; `texture_layout [textures, 3]` is
    the start, height and width of each.

    Runs of samples on one face go through three loops without branches, which the compiler makes vector instructions
    of; the last one adds in a fixed order.
    """
    one_face = face_of_sample.size == pixels.size
    corner = np.empty(samples, dtype=np.int32)
    right_weight = np.empty(samples)
    below_weight = np.empty(samples)
    grey = np.empty(samples)
    for i in chosen:
        first = 0
        while first < samples:
            face = face_of_sample[i] if one_face else face_of_sample[i * samples + first]
            last = samples if one_face else first + 1
            while last < samples and face_of_sample[i * samples + last] == face:
                last += 1
            if face < 0:
                grey[first:last] = background
                first = last
                continue
            u_x, u_y, u_z = H[face, 0, 0], H[face, 0, 1], H[face, 0, 2]
            v_x, v_y, v_z = H[face, 1, 0], H[face, 1, 1], H[face, 1, 2]
            w_x, w_y, w_z = H[face, 2, 0], H[face, 2, 1], H[face, 2, 2]
            texture = texture_of_face[face]
            start, height, width = texture_layout[texture, 0], texture_layout[texture, 1], texture_layout[texture, 2]
            stride = np.int32(width + 2)
            tile = texels[start : start + (height + 2) * (width + 2)]
            rows, columns = float(height), float(width)
            run = slice(i * samples + first, i * samples + last)
            x_of, y_of, z_of, grey_of = rays[0, run], rays[1, run], rays[2, run], grey[first:last]
            for k in range(last - first):
                x, y, z = x_of[k], y_of[k], z_of[k]
                inverse = 1.0 / (w_x * x + w_y * y + w_z * z)
                u = (u_x * x + u_y * y + u_z * z) * inverse
                v = (v_x * x + v_y * y + v_z * z) * inverse
                column = (u - np.floor(u)) * columns
                row = (v - np.floor(v)) * rows
                # NaN where a ray is parallel to its plane: never read outside the tile.
                column = column if column >= 0.0 else 0.0  # noqa: FURB136  (max() may let it through)
                row = row if row >= 0.0 else 0.0  # noqa: FURB136
                left, above = np.int32(column), np.int32(row)
                right_weight[k], below_weight[k] = column - left, row - above
                corner[k] = above * stride + left
            for k in range(last - first):
                upper_left = np.uint32(corner[k])
                lower_left = upper_left + np.uint32(stride)
                upper, lower = tile[upper_left], tile[lower_left]
                upper += right_weight[k] * (tile[upper_left + np.uint32(1)] - upper)
                lower += right_weight[k] * (tile[lower_left + np.uint32(1)] - lower)
                grey_of[k] = upper + below_weight[k] * (lower - upper)
            first = last
        total = 0.0
        for k in range(samples):
            total += grey[k]
        image[pixels[i]] = total / samples


@kernel
def face_ranges(face_of_pixel, directions, w_rows, distances, out):
    """Write the range of each pixel inside one face; others are unchanged.

    `w_rows [faces, 3]` are the normals in the sensor's frame, `distances [faces]` those of the planes from the
    viewpoint.
    """
    for i in range(face_of_pixel.size):
        face = face_of_pixel[i]
        if face >= 0:
            out[i] = distances[face] / (
                w_rows[face, 0] * directions[i, 0]
                + w_rows[face, 1] * directions[i, 1]
                + w_rows[face, 2] * directions[i, 2]
            )


@kernel
def describe_surfaces(
    pixel_of_ray,
    rays,
    range_of_ray,
    face_of_ray,
    normals,
    textureless_of_face,
    range_m,
    face,
    normal,
    world,
    textureless,
):
    """Write the surfaces that rays hit to the pixels of an image; others are unchanged.

    pixel_of_ray, rays, range_of_ray, face_of_ray : of each ray, `[n]`: a flat index into the picture, its world
        direction, and its hit.
    range_m, face, normal, world, textureless : written, flat. The normal is turned towards the viewpoint; world is the
        ray itself.
    """
    for i in range(pixel_of_ray.size):
        pixel, f = pixel_of_ray[i], face_of_ray[i]
        x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
        world[pixel, 0], world[pixel, 1], world[pixel, 2] = x, y, z
        if f < 0:
            continue
        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
        along = nx * x + ny * y + nz * z
        sign = -1.0 if along > 0.0 else 1.0 if along < 0.0 else 0.0
        normal[pixel, 0], normal[pixel, 1], normal[pixel, 2] = sign * nx, sign * ny, sign * nz
        range_m[pixel] = range_of_ray[i]
        face[pixel] = f
        textureless[pixel] = textureless_of_face[f]


@kernel
def look_from(from_1, from_2, rays, range_m, towards, distance):
    """Write unit directions and distances from a second viewpoint to the points that rays from a first one hit."""
    for i in range(range_m.size):
        x = from_1[0] + range_m[i] * rays[i, 0] - from_2[0]
        y = from_1[1] + range_m[i] * rays[i, 1] - from_2[1]
        z = from_1[2] + range_m[i] * rays[i, 2] - from_2[2]
        length = math.sqrt(x * x + y * y + z * z)
        distance[i] = length
        towards[i, 0], towards[i, 1], towards[i, 2] = x / length, y / length, z / length


@kernel
def mark_jumps(range_m, normal, directions, wrap_columns, ratio, jump):
    """Mark both pixels of every pair with a jump in range between them; see `truth.discontinuities`."""
    height, width = range_m.shape
    for i in range(height):
        for j in range(width):
            for below in range(2):
                i_2, j_2 = (i + 1, j) if below else (i, j + 1)
                if j_2 == width and wrap_columns:
                    j_2 = 0
                if i_2 == height or j_2 == width:
                    continue
                r_1, r_2 = range_m[i, j], range_m[i_2, j_2]
                if not abs(r_1 - r_2) > ratio * min(r_1, r_2):
                    continue
                behind_2 = _continued(r_1, normal[i, j], directions[i, j], directions[i_2, j_2]) - r_2
                behind_1 = _continued(r_2, normal[i_2, j_2], directions[i_2, j_2], directions[i, j]) - r_1
                same_plane = abs(behind_2) <= 1e-9 * r_2 or abs(behind_1) <= 1e-9 * r_1
                if not same_plane and (behind_1 > 0.0) != (behind_2 > 0.0):
                    jump[i, j] = jump[i_2, j_2] = True


@kernel
def _continued(range_m, normal, direction, other):
    """Range along another direction to the tangent plane at a point; infinite if there is no intersection."""
    towards = normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2]
    if not towards < 0.0:
        return math.inf
    along = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    return range_m * along / towards


@kernel
def in_view(directions, rotation, camera, field, width, height, out):
    """Write whether world directions `[n, 3]` are in a sensor's field and on its image.

    As `valid` of `harness.camera.sensor.project`. `rotation` turns the sensor's frame into the world's.
    """
    for i in range(out.size):
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        x = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
        y = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
        z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
        norm = math.sqrt(x * x + y * y + z * z)
        out[i] = False
        if not field.lowest <= along_up(x, y, z, field) / norm <= field.highest:
            continue
        if not along_axis(x, y, z, field) / norm >= field.nearest:
            continue
        u, v, inside = project(x, y, z, camera)
        out[i] = inside and -0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5
