"""Ground truth: range and normal of the surface in each direction, and whether a second view sees it.

Ground truth is traced along one ray through the centre of each pixel, without any filtering.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.camera.sensor import Sensor, field_of, parameters_of, project
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation._rendering_kernels import describe_surfaces, in_view, look_from, mark_jumps
from harness.simulation.cast import cast, rotated
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Geometry, Ints, check_viewpoint, geometry_near

T = TypeVar("T")

Mask = NDArray[np.bool_]

DISCONTINUITY_RATIO = 0.05
"""Neighbouring ranges that differ by more than this share of the smaller one may be a discontinuity."""

OCCLUSION_TOLERANCE = 1e-6
"""A ray that stops short of a point by more than this share of the distance is occluded. Float64 needs 1e-12; the rest
prevents surfaces that touch, such as a foot on the floor, from occluding each other."""


@dataclass(frozen=True, repr=False)
class Truth(OneLine):
    """Ground truth of an array of directions `[rows, columns]` from viewpoint 1; read-only.

    Masks are False where there is no range.
    """

    range_m: Array
    """Euclidean distance from viewpoint 1 in metres; NaN for a direction that is not valid or hits nothing."""
    normal: Array
    """`[rows, columns, 3]`: the surface's unit normal in the world, towards viewpoint 1; NaN without a range."""
    face: Ints
    """Index of the visible planar face (see `scene_geometry`); -1 without a range."""
    unoccluded: Mask
    """The point is not occluded from viewpoint 2. True everywhere without a second view."""
    in_field_2: Mask
    """The point's direction lies in the field and on the image of sensor 2, and not on a masked pixel. True everywhere
    without a second view."""
    visible: Mask
    """`unoccluded` and `in_field_2`: the second view sees the point."""
    discontinuity: Mask
    """Adjacent to a jump in range: see `discontinuities`."""
    textureless: Mask
    """The texture of the surface is a uniform grey."""


@dataclass(frozen=True, repr=False)
class Surfaces(OneLine):
    """What one view sees in an array of directions `[rows, columns]`, whatever a second one does; read-only.

    Arrays `[n]` are of the rays that hit something.
    """

    range_m: Array
    normal: Array
    face: Ints
    discontinuity: Mask
    textureless: Mask
    """As in `Truth`."""
    pixel: NDArray[np.intp]
    """`[n]`: the flat index of each ray's direction."""
    rays: Array
    """`[n, 3]`: unit vectors in the world."""


def surfaces(
    scene: Scene,
    pose: Pose,
    directions: ArrayLike,
    valid: ArrayLike,
    *,
    wrap_columns: bool = True,
    threads: int | None = None,
) -> Surfaces:
    """The surfaces seen from one view; see `truth` for the arguments."""
    valid = np.asarray(valid, dtype=bool)
    directions = np.asarray(directions, dtype=np.float64)
    geometry = geometry_near(scene, pose.position_m)
    pixel = np.flatnonzero(valid)
    rays = rotated(directions.reshape(-1, 3)[pixel], pose.R_world_from_view)
    range_hit, face_hit = _first_hits(geometry, pose, rays, threads)

    range_m = np.full(valid.shape, np.nan)
    face = np.full(valid.shape, -1, dtype=np.int32)
    normal, world = np.full((2, *directions.shape), np.nan)
    textureless = np.zeros(valid.shape, dtype=bool)
    describe_surfaces(
        pixel,
        rays,
        range_hit,
        face_hit,
        geometry.normals,
        geometry.textureless[geometry.texture_of_face],
        range_m.reshape(-1),
        face.reshape(-1),
        normal.reshape(-1, 3),
        world.reshape(-1, 3),
        textureless.reshape(-1),
    )
    met = face_hit >= 0
    if not met.all():
        pixel, rays = pixel[met], rays[met]
    jumps = discontinuities(range_m, normal, world, wrap_columns=wrap_columns)
    return _locked(Surfaces(range_m, normal, face, jumps, textureless, pixel, rays))


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
    seen: Surfaces | None = None,
) -> Truth:
    """Ground truth of directions seen from one view, and whether a second view sees the same points.

    Parameters
    ----------
    directions_v1
        `[rows, columns, 3]`, unit length, in view 1's frame; may be NaN where not valid.
    valid
        `[rows, columns]`, bool.
    pose_2, sensor_2
        The second view. With a pose alone its field is ignored.
    wrap_columns
        Whether the first and last columns are neighbours, as in a panorama of 360 degrees.
    seen
        What `surfaces` gives for view 1, if that is known.

    Raises
    ------
    InputError
        When a view is outside the scene or inside an object, or a ray escapes from a closed scene.
    """
    if seen is None:
        seen = surfaces(scene, pose_1, directions_v1, valid, wrap_columns=wrap_columns, threads=threads)
    has_range = seen.face >= 0
    unoccluded, in_field_2 = has_range.copy(), has_range.copy()
    if pose_2 is not None:
        geometry, pixel = geometry_near(scene, pose_1.position_m), seen.pixel
        range_m, face = seen.range_m.reshape(-1)[pixel], seen.face.reshape(-1)[pixel]
        towards, distance = np.empty((pixel.size, 3)), np.empty(pixel.size)
        look_from(_from_centre(geometry, pose_1), _from_centre(geometry, pose_2), seen.rays, range_m, towards, distance)
        unoccluded.reshape(-1)[pixel] = _unoccluded(geometry, pose_2, towards, distance, face, threads)
        if sensor_2 is not None:
            in_field_2.reshape(-1)[pixel] = on_sensor(sensor_2, pose_2, towards)
    return _locked(
        Truth(
            range_m=seen.range_m,
            normal=seen.normal,
            face=seen.face,
            unoccluded=unoccluded,
            in_field_2=in_field_2,
            visible=unoccluded & in_field_2,
            discontinuity=seen.discontinuity,
            textureless=seen.textureless,
        )
    )


def _locked(made: T) -> T:
    """The same arrays, read-only."""
    for array in vars(made).values():
        array.flags.writeable = False
    return made


def on_sensor(sensor: Sensor, pose: Pose, directions: Array) -> Mask:
    """Whether world directions `[n, 3]` are seen by a sensor, as `valid` of `project`."""
    if sensor.mask is not None:
        return np.asarray(project(sensor, directions @ pose.R_world_from_view)[1])
    out = np.empty(len(directions), dtype=bool)
    in_view(
        directions,
        pose.R_world_from_view,
        parameters_of(sensor),
        field_of(sensor),
        sensor.camera.width_px,
        sensor.camera.height_px,
        out,
    )
    return out


def ranges(scene: Scene, pose: Pose, directions: ArrayLike, valid: ArrayLike, *, threads: int | None = None) -> Array:
    """The range alone, as in `truth`, metres: NaN for a direction that is not valid or hits nothing."""
    valid = np.asarray(valid, dtype=bool)
    range_m = np.full(valid.shape, np.nan)
    rays = rotated(np.asarray(directions, dtype=np.float64)[valid], pose.R_world_from_view)
    range_m[valid], _ = _first_hits(geometry_near(scene, pose.position_m), pose, rays, threads)
    return range_m


def discontinuities(range_m: Array, normal: Array, directions: Array, *, wrap_columns: bool) -> Mask:
    """Pixels adjacent to a jump in range, `[rows, columns]`; both pixels of a pair are marked.

    There is a jump between two neighbours when their ranges differ by more than `DISCONTINUITY_RATIO` and their tangent
    planes do not intersect between them. On one plane the ranges may differ by any amount (a floor at a grazing angle),
    and so they may across the crease between two planes: there both planes, extended, pass behind the other point (a
    concave crease) or both pass in front of it (a convex one). At an outline one passes behind and one in front.

    Parameters
    ----------
    range_m
        `[rows, columns]`, metres; a pair with NaN is not a jump.
    normal, directions
        `[rows, columns, 3]`, in one frame; directions of unit length.
    """
    jump = np.zeros(range_m.shape, dtype=bool)
    mark_jumps(range_m, normal, directions, wrap_columns, DISCONTINUITY_RATIO, jump)
    return jump


def _from_centre(geometry: Geometry, pose: Pose) -> Array:
    return np.asarray(pose.position_m, dtype=np.float64) - geometry.centre


def _first_hits(geometry: Geometry, pose: Pose, rays: Array, threads: int | None) -> tuple[Array, Ints]:
    origin = _from_centre(geometry, pose)
    check_viewpoint(geometry, origin)
    hits = cast(geometry, origin, rays, threads=threads)
    return hits.range_m, geometry.face_of_triangle[hits.triangle]


def _unoccluded(
    geometry: Geometry, pose_2: Pose, towards: Array, distance: Array, face: Ints, threads: int | None
) -> Mask:
    """Whether the rays from view 2 to points on faces at a distance are not occluded."""
    origin = _from_centre(geometry, pose_2)
    check_viewpoint(geometry, origin)
    hits = cast(geometry, origin, towards, threads=threads)
    reached = geometry.face_of_triangle[hits.triangle] == face
    # In an open scene a ray may miss a point exactly on an outline: then it is not occluded.
    return np.asarray(reached | ~(hits.range_m < (1 - OCCLUSION_TOLERANCE) * distance))
