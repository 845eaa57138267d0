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
def points_on_faces(rays, face, normals, distances, offset, points):
    """Write `points [3, n]`: where rays meet the planes of their faces, from `offset`, a point of the sensor's frame.

    `normals [faces, 3]` are in the sensor's frame, `distances [faces]` those of the planes from its origin. A ray
    without a face has its direction.
    """
    ox, oy, oz = offset
    for i in range(face.size):
        px, py, pz = rays[0, i], rays[1, i], rays[2, i]
        x, y, z = rays[3, i], rays[4, i], rays[5, i]
        f = face[i]
        if f < 0:
            points[0, i], points[1, i], points[2, i] = x, y, z
            continue
        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
        s = (distances[f] - (nx * px + ny * py + nz * pz)) / (nx * x + ny * y + nz * z)
        points[0, i], points[1, i], points[2, i] = px + s * x - ox, py + s * y - oy, pz + s * z - oz
