"""Compiled loops over rays that begin on a mirror. Called through `reflected`, which checks the arguments."""

from harness.compiled import kernel


@kernel
def world_rays(rays, rotation, viewpoint, origins, directions):
    """Write where rays begin and go in the world, `[n, 3]` each, float32.

    `rays [6, n]` are origins and directions in the sensor's frame, whose own origin is the viewpoint.
    """
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    cx, cy, cz = viewpoint
    for i in range(rays.shape[1]):
        x, y, z = rays[0, i], rays[1, i], rays[2, i]
        origins[i, 0] = cx + r00 * x + r01 * y + r02 * z
        origins[i, 1] = cy + r10 * x + r11 * y + r12 * z
        origins[i, 2] = cz + r20 * x + r21 * y + r22 * z
        x, y, z = rays[3, i], rays[4, i], rays[5, i]
        directions[i, 0] = r00 * x + r01 * y + r02 * z
        directions[i, 1] = r10 * x + r11 * y + r12 * z
        directions[i, 2] = r20 * x + r21 * y + r22 * z


@kernel
def points_on_faces(chosen, samples, rays, face, normals, distances, offset, points):
    """Write `points [3, n]`: where rays meet the planes of their faces, from `offset`, a point of the sensor's frame.

    Only for the samples of chosen pixels, of which each has `samples` in a row. `normals [faces, 3]` are in the
    sensor's frame, `distances [faces]` those of the planes from its origin. A ray without a face has its direction.
    """
    ox, oy, oz = offset
    for pixel in chosen:
        first, end = pixel * samples, (pixel + 1) * samples
        while first < end:
            f = face[first]
            last = first + 1
            while last < end and face[last] == f:
                last += 1
            # Runs of samples on one face, without a branch within.
            x_of, y_of, z_of = rays[3, first:last], rays[4, first:last], rays[5, first:last]
            x_out, y_out, z_out = points[0, first:last], points[1, first:last], points[2, first:last]
            if f < 0:
                x_out[:], y_out[:], z_out[:] = x_of, y_of, z_of
            else:
                px_of, py_of, pz_of = rays[0, first:last], rays[1, first:last], rays[2, first:last]
                nx, ny, nz, distance = normals[f, 0], normals[f, 1], normals[f, 2], distances[f]
                for i in range(last - first):
                    px, py, pz, x, y, z = px_of[i], py_of[i], pz_of[i], x_of[i], y_of[i], z_of[i]
                    s = (distance - (nx * px + ny * py + nz * pz)) / (nx * x + ny * y + nz * z)
                    x_out[i], y_out[i], z_out[i] = px + s * x - ox, py + s * y - oy, pz + s * z - oz
            first = last
