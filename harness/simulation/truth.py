"""The exact answer: how far away each direction's surface is, which way it faces, and whether a second view sees it.

Truth is one ray through the centre of a direction's pixel, never filtered, never averaged.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.camera.angles import Array
from harness.camera.pose import Pose
from harness.camera.sensor import Sensor, project
from harness.simulation.cast import cast, rotated
from harness.simulation.geometry import Geometry, Ints, check_viewpoint, geometry_of
from harness.simulation.scene import Scene

Mask = NDArray[np.bool_]

DISCONTINUITY_RATIO = 0.05
"""Neighbouring ranges that differ by more than this share of the nearer one may be a discontinuity."""

OCCLUSION_TOLERANCE = 1e-6
"""Relative: a ray that stops short of a point by more than this share of the distance is blocked. Float64 needs
1e-12; the rest keeps things that touch, such as a foot on the floor, from hiding each other's points."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of an array of directions `[rows, columns]` from viewpoint 1; read-only.

    Masks are False where there is no range.
    """

    range_m: Array
    """Euclidean distance from viewpoint 1 in metres; NaN for a direction that is not valid or meets nothing."""
    normal: Array
    """`[rows, columns, 3]`: the surface's unit normal in the world, towards viewpoint 1; NaN where range is."""
    face: Ints
    """Index of the planar face that is seen (see `geometry`); -1 where range is NaN."""
    unoccluded: Mask
    """Nothing stands between the point and viewpoint 2. True everywhere when there is no second view."""
    in_field_2: Mask
    """The point's direction lies in the field and on the image of sensor 2. True everywhere when there is none."""
    visible: Mask
    """Both: the second view sees the point."""
    discontinuity: Mask
    """Beside a jump in range: see `discontinuities`."""
    textureless: Mask
    """The texture that is seen is one grey everywhere."""


def truth(
    scene: Scene,
    pose_1: Pose,
    directions_v1: ArrayLike,
    valid: ArrayLike,
    *,
    pose_2: Pose | None = None,
    sensor_2: Sensor | None = None,
    wrap_columns: bool = True,
    threads: int | None = None,
) -> Truth:
    """Ground truth of directions seen from one view, and whether a second view sees the same points.

    Parameters
    ----------
    directions_v1
        `[rows, columns, 3]`, unit length, in view 1's frame; what is not valid may be NaN.
    valid
        `[rows, columns]`, bool.
    pose_2, sensor_2
        The second view. With a pose alone the field is not asked after.
    wrap_columns
        The first and last columns are neighbours, as in a panorama of 360 degrees. Wrong for a mirror image.

    Raises
    ------
    InputError
        When a view is outside the scene or inside an object, or a ray escapes from a closed scene.
    """
    valid = np.asarray(valid, dtype=bool)
    directions = np.asarray(directions_v1, dtype=np.float64)
    geometry = geometry_of(scene)
    rays = rotated(directions[valid], pose_1.R_world_from_view)
    range_valid, face_valid = _seen(geometry, pose_1, rays, threads)

    range_m = np.full(valid.shape, np.nan)
    range_m[valid] = range_valid
    face = np.full(valid.shape, -1, dtype=np.int32)
    face[valid] = face_valid
    has_range = face >= 0
    world = np.full(directions.shape, np.nan)
    world[valid] = rays
    normal = np.full(directions.shape, np.nan)
    n = geometry.normals[face[has_range]]
    towards = -np.sign(np.sum(n * world[has_range], axis=-1, keepdims=True))
    normal[has_range] = n * towards

    unoccluded, in_field_2 = has_range.copy(), has_range.copy()
    if pose_2 is not None:
        points = pose_1.position_m + range_m[has_range, None] * world[has_range]
        unoccluded[has_range] = _unoccluded(geometry, pose_2, points, face[has_range], threads)
        if sensor_2 is not None:
            seen_from_2 = rotated(points - pose_2.position_m, pose_2.R_world_from_view.T)
            in_field_2[has_range] = project(sensor_2, seen_from_2)[1]
    textureless = np.zeros(valid.shape, dtype=bool)
    textureless[has_range] = geometry.textureless[geometry.texture_of_face[face[has_range]]]
    result = Truth(
        range_m=range_m,
        normal=normal,
        face=face,
        unoccluded=unoccluded,
        in_field_2=in_field_2,
        visible=unoccluded & in_field_2,
        discontinuity=discontinuities(range_m, normal, world, wrap_columns=wrap_columns),
        textureless=textureless,
    )
    for array in vars(result).values():
        array.flags.writeable = False
    return result


def ranges(scene: Scene, pose: Pose, directions: ArrayLike, valid: ArrayLike, *, threads: int | None = None) -> Array:
    """Range in metres alone, as in `truth`: NaN for a direction that is not valid or meets nothing."""
    valid = np.asarray(valid, dtype=bool)
    range_m = np.full(valid.shape, np.nan)
    rays = rotated(np.asarray(directions, dtype=np.float64)[valid], pose.R_world_from_view)
    range_m[valid], _ = _seen(geometry_of(scene), pose, rays, threads)
    return range_m


def discontinuities(range_m: Array, normal: Array, directions: Array, *, wrap_columns: bool) -> Mask:
    """Pixels beside a jump in range, `[rows, columns]`; both pixels of a pair are marked.

    Two neighbours jump when their ranges differ by more than `DISCONTINUITY_RATIO` and their tangent planes do
    not meet between them. On one plane the ranges may differ by any amount (a floor seen at a grazing angle),
    and so they may across the crease of two planes: then either plane, continued, passes behind the other one's
    point (a concave crease) or either passes before it (a convex one). At an outline one passes behind and one
    before.

    Parameters
    ----------
    range_m
        `[rows, columns]`; a pair with NaN is no jump.
    normal, directions
        `[rows, columns, 3]`, in one frame; directions of unit length.
    """
    jump = np.zeros(range_m.shape, dtype=bool)
    for axis in (0, 1):
        wraps = wrap_columns and axis == 1
        here = np.arange(range_m.shape[axis] - (0 if wraps else 1))
        there = (here + 1) % range_m.shape[axis]
        r1, n1, d1 = (np.take(a, here, axis=axis) for a in (range_m, normal, directions))
        r2, n2, d2 = (np.take(a, there, axis=axis) for a in (range_m, normal, directions))
        differ = np.abs(r1 - r2) > DISCONTINUITY_RATIO * np.minimum(r1, r2)
        pair = np.zeros(differ.shape, dtype=bool)
        pair[differ] = _do_not_meet(r1[differ], n1[differ], d1[differ], r2[differ], n2[differ], d2[differ])
        first, second = np.nonzero(pair)
        if axis == 0:
            jump[here[first], second] = jump[there[first], second] = True
        else:
            jump[first, here[second]] = jump[first, there[second]] = True
    return jump


def _do_not_meet(r1: Array, n1: Array, d1: Array, r2: Array, n2: Array, d2: Array) -> Mask:
    behind_2 = _continued(r1, n1, d1, d2) - r2
    behind_1 = _continued(r2, n2, d2, d1) - r1
    same_plane = (np.abs(behind_2) <= 1e-9 * r2) | (np.abs(behind_1) <= 1e-9 * r1)
    return np.asarray(~same_plane & ((behind_1 > 0) != (behind_2 > 0)))


def _continued(range_m: Array, normal: Array, direction: Array, other: Array) -> Array:
    """Range along another direction of the plane through a point; infinite where it is never met."""
    towards = np.sum(normal * other, axis=-1)
    with np.errstate(divide="ignore"):
        reach = range_m * np.sum(normal * direction, axis=-1) / towards
    return np.where(towards < 0, reach, np.inf)


def _seen(geometry: Geometry, pose: Pose, rays: Array, threads: int | None) -> tuple[Array, Ints]:
    check_viewpoint(geometry, pose.position_m)
    hits = cast(geometry, pose.position_m, rays, threads=threads)
    return hits.range_m, geometry.face_of_triangle[hits.triangle]


def _unoccluded(geometry: Geometry, pose_2: Pose, points: Array, face: Ints, threads: int | None) -> Mask:
    check_viewpoint(geometry, pose_2.position_m)
    towards = points - pose_2.position_m
    distance = np.linalg.norm(towards, axis=-1)
    hits = cast(geometry, pose_2.position_m, towards / distance[:, None], threads=threads)
    reached = geometry.face_of_triangle[hits.triangle] == face
    # In an open scene a ray may miss a point on the very outline: nothing stopped it before the point.
    return np.asarray(reached | ~(hits.range_m < (1 - OCCLUSION_TOLERANCE) * distance))
