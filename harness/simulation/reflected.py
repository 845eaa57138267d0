"""The image of a sensor without a viewpoint (`camera.reflection`): rays that begin on the mirror, each traced.

There is no viewpoint, so that nothing can be read off a pixel's corners, and a face has no homography. Embree finds the
triangle of every sample's ray; where it meets the face's plane is worked out in float64. Seen from any one point, the
points that rays meet are directions again, and are shaded as those of a central sensor. That point is the
viewpoint of the aligned sensor, the mirror's inner focus, or one beside it where it lies in the plane of a face.

How closely a pixel is sampled is judged as if its rays began in that focus: they begin a few centimetres from it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from harness.camera.reflection import reflected_pixels, reflected_rays, write_reflected_rays
from harness.camera.sensor import Sensor
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation._reflected_kernels import points_on_faces, world_rays
from harness.simulation._rendering_kernels import (
    INVALID,
    TRACE,
    faces_of_triangles,
    sample_positions,
)
from harness.simulation.cast import cast, nearest_triangles, rotated
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Ints, check_viewpoint, geometry_near, homographies
from harness.simulation.shading import Image, Shading, View, shaded

_CLEAR_M = 1e-5
"""A plane so near to the point that faces are seen from costs five of sixteen digits."""
_ASIDE_M = 1e-3
"""Distance by which that point is moved if necessary, metres."""


def reflected_image(view: View, sensor: Sensor, samples: int, threads: int | None = None) -> Image:
    """The image `[height, width]`; 0 where the camera sees no mirror, itself, or beyond the mirror's rim.

    Parameters
    ----------
    sensor
        With a hyperboloid mirror, misaligned or not.
    samples
        As for `render.render`. A pixel whose centre is seen has all its samples shaded.
    """
    _, _, valid = reflected_pixels(sensor)
    index, rays = _corners_of(sensor)
    face = np.where(valid, np.int32(TRACE), np.int32(INVALID)).ravel()
    offset = _seen_from(view)
    geometry = view.geometry
    seen_from = view.origin + view.rotation @ offset
    shading = ReflectedShading(
        view=view,
        sensor=sensor,
        corner_index=index,
        corner_rays=rays,
        face=face,
        image=np.zeros((len(view.bands), face.size), dtype=np.float32),
        normals=geometry.normals @ view.rotation,
        distances=geometry.offsets - geometry.normals @ view.origin,
        offset=offset,
        H_at_offset=tuple(homographies(geometry, each.maps, seen_from, view.rotation) for each in view.bands),
    )
    return shaded(shading, valid.shape, samples, threads)


@dataclass(frozen=True, eq=False)
class Points:
    """The surface points that the rays of a sensor's pixel centres meet; arrays are read-only."""

    point_m: Array
    """`[height, width, 3]`: the point that the pixel's ray meets, metres, in the sensor's frame; NaN for none."""
    range_m: Array
    """`[height, width]`: its distance from the sensor's origin, the mirror's inner focus, metres; NaN for none."""
    face: Ints
    """`[height, width]`: the face that it lies on; -1 for none."""


def points_seen(scene: Scene, sensor: Sensor, pose: Pose, *, threads: int | None = None) -> Points:
    """The exact point that each pixel's centre sees, by the law of reflection.

    Ranges are measured as everywhere, from the effective viewpoint of the aligned sensor, and not along the ray, which
    begins on the mirror.

    Raises
    ------
    InputError
        As `truth.truth`.
    """
    geometry = geometry_near(scene, pose.position_m)
    origin = np.asarray(pose.position_m, dtype=np.float64) - geometry.centre
    check_viewpoint(geometry, origin)
    begin, towards, valid = reflected_pixels(sensor)
    rotation = pose.R_world_from_view
    hits = cast(geometry, origin + rotated(begin[valid], rotation), rotated(towards[valid], rotation), threads=threads)
    point_m, range_m = np.full((*valid.shape, 3), np.nan), np.full(valid.shape, np.nan)
    face = np.full(valid.shape, -1, dtype=np.int32)
    point_m[valid] = begin[valid] + hits.range_m[:, None] * towards[valid]
    range_m[valid] = np.linalg.norm(point_m[valid], axis=-1)
    face[valid] = np.where(hits.triangle < 0, np.int32(-1), geometry.face_of_triangle[hits.triangle])
    for array in (point_m, range_m, face):
        array.flags.writeable = False
    return Points(point_m, range_m, face)


@dataclass(frozen=True)
class ReflectedShading(Shading):
    """An image in the making, whose rays `[6, n]` begin on the mirror: origins and unit directions."""

    normals: Array
    """`[faces, 3]`, in the sensor's frame."""
    distances: Array
    """`[faces]`: of the planes from the sensor's origin."""
    offset: Array
    """`[3]`: the point that `H_at_offset` belongs to, in the sensor's frame."""
    H_at_offset: tuple[Array, ...]
    """For each band `[faces, 3, 3]`, as `View.H`."""

    def _rays(self, pixels: np.ndarray, per_side: int) -> Array:
        offsets = (np.arange(per_side) + 0.5) / per_side - 0.5
        u, v = np.empty((2, pixels.size * per_side**2))
        sample_positions(pixels, self.sensor.camera.width_px, offsets, u, v)
        rays = np.empty((6, u.size))
        valid = np.empty(u.size, dtype=np.bool_)
        write_reflected_rays(self.sensor, u, v, rays, valid)
        return rays

    def _faces(self, rays: Array) -> Ints:
        view = self.view
        origins, directions = np.empty((2, rays.shape[1], 3), dtype=np.float32)
        world_rays(rays, view.rotation, view.origin, origins, directions)
        triangle = nearest_triangles(view.geometry, origins, directions)
        face = np.empty(triangle.size, dtype=np.int32)
        misses = faces_of_triangles(triangle, view.geometry.face_of_triangle, face)
        if view.geometry.closed and misses:
            missed = np.flatnonzero(face < 0)
            rays = rays[:, missed]
            begin = rotated(rays[:3].T, view.rotation)
            towards = rotated(rays[3:].T, view.rotation)
            hits = cast(view.geometry, view.origin + begin, towards, threads=1)
            face[missed] = view.geometry.face_of_triangle[hits.triangle]
        return face

    def _shade(self, pixels: np.ndarray, chosen: np.ndarray, rays: Array, face: Ints, per_side: int) -> None:
        points = np.empty((3, face.size))
        points_on_faces(chosen, per_side**2, rays, face, self.normals, self.distances, self.offset, points)
        for i, H in enumerate(self.H_at_offset):
            self._shade_band(pixels, chosen, points, face, per_side, H, i)


def _seen_from(view: View) -> Array:
    """A point `[3]` in the sensor's frame, its origin or next to it, that lies in no face's plane."""
    geometry = view.geometry
    distance = geometry.offsets - geometry.normals @ view.origin
    if np.abs(distance).min() > _CLEAR_M:
        return np.zeros(3)
    aside = np.array([[0.53, 0.61, 0.59], [0.71, -0.37, 0.6], [-0.43, 0.83, -0.36], [0.19, 0.29, -0.94]]) * _ASIDE_M
    tried = np.abs(distance - aside @ view.rotation.T @ geometry.normals.T).min(axis=1)
    return aside[np.argmax(tried)]


@lru_cache(maxsize=8)
def _corners_of(sensor: Sensor) -> tuple[np.ndarray, Array]:
    """The column of each pixel corner, flat, among directions `[3, n]`; and these directions."""
    height, width = sensor.camera.height_px, sensor.camera.width_px
    v, u = (np.ascontiguousarray(each.ravel() - 0.5) for each in np.indices((height + 1, width + 1), dtype=np.float64))
    _, directions, _ = reflected_rays(sensor, u, v)
    return np.arange(u.size, dtype=np.int32), directions
