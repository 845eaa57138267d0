"""Coplanar faces that overlap, and their rule: the later object of the scene is visible.

In float32 it is random, ray by ray, which of two such faces Embree hits. So every hit on a face that has a rival is
decided again in float64, in the same way in every view, for images and for ground truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.simulation._coincident_kernels import crossings, crossings_of_all, overlapping, settle_hits
from harness.simulation.box_tree import LEAF, box_tree

Ints = NDArray[np.int32]

NEAR = 1e-6
"""Distance, as a share of the scene's size, within which float32 may confuse two faces. The nearer one is then
determined in float64."""
COINCIDENT = 1e-9
"""Distance, as a share of the scene's size, within which both are at the same range, and the later one is visible."""
MOST_PAIRS = 1 << 20
"""Pairs of triangles that may overlap. A thousand copies of a mesh in one place have a thousand times a thousand."""


@dataclass(frozen=True)
class Rivals:
    """The pairs of faces of a geometry that overlap in one plane; arrays are read-only."""

    pairs: Ints
    """`[pairs, 2]`: two faces, the earlier first."""
    visible_from: NDArray[np.int8]
    """`[pairs, 2]`: the side of its plane from which each face may be seen: 1 for that of its normal, -1 for the other,
    0 for both."""
    tolerance_m: float
    """Faces closer to each other than this are at the same range, metres."""


def rivals_of(
    corners: Array,
    face_of_triangle: Ints,
    normals: Array,
    offsets: Array,
    inside_of_face: Sequence[Array | None],
    scene: str = "scene",
) -> Rivals:
    """The rivals among faces.

    Parameters
    ----------
    corners
        `[triangles, 3, 3]`.
    face_of_triangle
        `[triangles]`.
    normals, offsets
        Planes `[faces, 3]` and `[faces]`.
    inside_of_face
        For each face the corners of the solid that it bounds, whose inside is never visible; None for a face that is
        visible from both sides.
    scene
        Its name, for messages.

    Raises
    ------
    InputError
        When more than `MOST_PAIRS` pairs of triangles overlap.
    """
    size = float(np.abs(corners).max())
    overlapping = _overlapping(corners, face_of_triangle, normals, offsets, NEAR * size, scene)
    pairs = np.unique(overlapping, axis=0).astype(np.int32).reshape(-1, 2)
    visible = _visible_from(np.unique(pairs), corners, face_of_triangle, normals, inside_of_face)[pairs]
    pairs.flags.writeable = False
    visible.flags.writeable = False
    return Rivals(pairs, visible, COINCIDENT * size)


def _overlapping(
    corners: Array, face_of_triangle: Ints, normals: Array, offsets: Array, tolerance: float, scene: str
) -> NDArray[np.int64]:
    """Pairs of faces `[n, 2]`, the earlier first and some repeatedly, of which triangles overlap in one plane."""
    low, high = corners.min(axis=1) - tolerance, corners.max(axis=1) + tolerance
    faces = (corners, face_of_triangle, normals, offsets)
    tree = box_tree(low, high)
    room = 1024
    while True:
        out = np.empty((room, 2), dtype=np.int64)
        count = overlapping(*tree, LEAF, low, high, *faces, tolerance, MOST_PAIRS, out)
        if count > MOST_PAIRS:
            raise InputError(
                "more than a million pairs of its triangles coincide; remove the copies of an object or mesh",
                file=scene,
            )
        if count <= room:
            return out[:count]
        room = count


def _visible_from(
    faces: NDArray[np.integer],
    corners: Array,
    face_of_triangle: Ints,
    normals: Array,
    inside_of_face: Sequence[Array | None],
) -> NDArray[np.int8]:
    """`[all faces]`: the side from which each of `faces` may be visible, as in `Rivals.visible_from`."""
    sides = np.zeros(len(normals), dtype=np.int8)
    middles = corners[np.unique(face_of_triangle, return_index=True)[1][faces]].mean(axis=1)
    faces_of_solid: dict[int, list[int]] = {}
    for index, face in enumerate(faces.tolist()):
        faces_of_solid.setdefault(id(inside_of_face[face]), []).append(index)
    for members in faces_of_solid.values():
        solid = inside_of_face[faces[members[0]]]
        if solid is not None:
            step = 1e-5 * float(np.ptp(solid.reshape(-1, 3), axis=0).max())
            inside = enclosed(solid, middles[members] + step * normals[faces[members]])
            sides[faces[members]] = np.where(inside, -1, 1)
    return sides


def visible_pairs(rivals: Rivals, normals: Array, offsets: Array, viewpoint: Array) -> Ints:
    """The pairs `[n, 2]` with a viewpoint on the visible side of both faces.

    The bottom of a box on a floor is not among them: it is visible from below, and the floor from above.
    """
    side = np.sign(normals @ viewpoint - offsets)[rivals.pairs]
    visible = ((rivals.visible_from == 0) | (rivals.visible_from == side)) & (side != 0)
    return rivals.pairs[visible.all(axis=1)]


def settle(
    pairs: Ints,
    corners: Array,
    face_of_triangle: Ints,
    normals: Array,
    offsets: Array,
    tolerance_m: float,
    origins: Array,
    directions: NDArray[np.floating],
    triangle: Ints,
) -> None:
    """Replace hits on hidden rivals by the visible triangles.

    Parameters
    ----------
    pairs
        From `visible_pairs`.
    face_of_triangle
        `[triangles]` or more.
    origins
        `[n, 3]`, or `[1, 3]` if all rays begin in one point.
    directions
        `[n, 3]`, of any length.
    triangle
        `[n]`, written; -1 for a miss.
    """
    faces = len(normals)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    starts = np.searchsorted(both[:, 0], np.arange(faces + 1))
    order = np.argsort(face_of_triangle[: len(corners)], kind="stable")
    first_triangle = np.searchsorted(face_of_triangle[order], np.arange(faces + 1))
    settle_hits(
        starts,
        np.ascontiguousarray(both[:, 1]),
        first_triangle,
        order,
        corners,
        face_of_triangle,
        normals,
        offsets,
        tolerance_m,
        origins,
        directions,
        triangle,
    )


def encloses(corners: Array, p: Array) -> bool:
    """Whether a watertight surface `[triangles, 3, 3]` encloses a point: a ray crosses it an odd number of times.

    The winding of the triangles does not matter; the ray's direction is generic, so that no edge is aligned with it.
    """
    return crossings(np.ascontiguousarray(corners), np.ascontiguousarray(p)) % 2 == 1


def enclosed(corners: Array, points: Array) -> NDArray[np.bool_]:
    """Whether a watertight surface encloses each of many points `[n, 3]`, by a tree over the triangles."""
    margin = 1e-9 * float(np.abs(corners).max() + np.abs(points).max(initial=0.0))
    tree = box_tree(corners.min(axis=1) - margin, corners.max(axis=1) + margin)
    count = np.empty(len(points), dtype=np.int64)
    crossings_of_all(*tree, LEAF, np.ascontiguousarray(corners), np.ascontiguousarray(points), count)
    return count % 2 == 1
