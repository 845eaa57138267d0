"""Rendering: every pixel of a sensor's image is the mean of a regular grid of exact samples.

A grid that is too coarse for its texture aliases. So the samples of a pixel are doubled in each direction where they
are more than 1.5 texels apart, doubled twice where they are more than 8 apart (by the pixel's longest side on its
face), and doubled where they fall on faces of several textures, such as those of two objects. A pixel of several faces
of one texture, as in a fine mesh, keeps its samples.

There is no lighting: the grey of a pixel is that of the texture. Most pixels lie inside one face, whose texture
coordinates are a homography of the ray; only the others are traced sample by sample. A pixel counts as inside a face
when its four corners hit that face and no outline of a face passes near it (see `_face_of_pixels`).
All of this is for sensors with a viewpoint; for those whose mirror is misaligned see `reflected`.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, field_of, parameters_of, pixel_directions, rays_of, seam_px
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation._rendering_kernels import (
    TRACE,
    classify_pixels,
    face_ranges,
    mark_edges,
    rotate_rays,
)
from harness.simulation.cast import cast, nearest_triangles, rotated
from harness.simulation.reflected import reflected_image
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Ints
from harness.simulation.shading import RAYS, Image, Shading, View, shaded, view_from
from harness.threads import in_threads

_NARROW = 16.0
"""Largest ratio of the longest side of a pixel to the shortest for which edges are sampled."""


def render(
    scene: Scene,
    sensor: Sensor,
    pose: Pose,
    samples: int = 16,
    threads: int | None = None,
    *,
    colour: bool = False,
) -> Image:
    """The image `[height, width]` of a scene, grey levels 0 .. 255; 0 outside the sensor's field.

    Parameters
    ----------
    samples
        Samples per pixel, a square number; up to 16 times as many, at most 1,024, where they are too coarse for a
        texture or an outline (see above). A pixel whose centre is in the field has all its samples shaded, even those
        slightly beyond the mirror's rim.
    threads
        Number of threads; by default all available CPUs. The image does not depend on it.
    colour
        Render red, green and blue, `[height, width, 3]`; their luma is the grey image to rounding. What has no colour
        in the scene is grey.

    Raises
    ------
    InputError
        When the view is outside the scene or inside an object, a ray escapes from a closed scene, or a grey level is
        not a finite number.
    """
    view = view_from(scene, pose, colour=colour)
    if not sensor.is_central:
        return reflected_image(view, sensor, samples, threads)
    return _shaded(view, sensor, _face_of_pixels(view, sensor, threads), samples, threads)


def render_with_range(
    scene: Scene, sensor: Sensor, pose: Pose, samples: int = 16, threads: int | None = None
) -> tuple[Image, Array]:
    """The image, as from `render`, and the exact range at every pixel's centre.

    Faster than `truth.truth` after `render`: in a pixel inside one face, the range needs no ray.

    Returns
    -------
    image
        `[height, width]`, grey levels.
    range_m
        `[height, width]`, metres; NaN outside the field and where an open scene shows its background.
    """
    view = view_from(scene, pose)
    faces = _face_of_pixels(view, sensor, threads)
    directions, _ = pixel_directions(sensor)
    range_m = np.full(faces.shape, np.nan)
    normals = view.geometry.normals
    distances = view.geometry.offsets - normals @ view.origin
    face_ranges(faces.ravel(), directions.reshape(-1, 3), normals @ view.rotation, distances, range_m.reshape(-1))
    traced = np.flatnonzero(faces == TRACE)

    def work(start: int) -> None:
        pixels = traced[start : start + RAYS]
        world = rotated(directions.reshape(-1, 3)[pixels], view.rotation)
        range_m.reshape(-1)[pixels] = cast(view.geometry, view.origin, world, threads=1).range_m

    in_threads(work, range(0, traced.size, RAYS), threads)
    return _shaded(view, sensor, faces, samples, threads), range_m


def render_every_sample(
    scene: Scene, sensor: Sensor, pose: Pose, samples: int = 16, threads: int | None = None
) -> Image:
    """The image, as from `render`, by tracing every sample: the slow reference implementation."""
    _, valid = pixel_directions(sensor)
    faces = np.where(valid, TRACE, TRACE - 1).astype(np.int32)
    return _shaded(view_from(scene, pose), sensor, faces, samples, threads)


@dataclass(frozen=True)
class _Corners:
    """The corners of a sensor's valid pixels."""

    corner: NDArray[np.int64]
    """`[n]`: index into the grid of (height + 1) x (width + 1) corners."""
    index: NDArray[np.int32]
    """Index among the n of each corner of the grid, flat; -1 for those of no valid pixel."""
    rays: Array
    """`[3, n]`, in the sensor's frame."""
    finest_rad: float
    """The smallest angle of a pixel's side, narrow pixels excepted."""
    coarsest_rad: float
    """The largest angle of a pixel's side."""
    narrow: NDArray[np.bool_]
    """`[height, width]`: pixels with a side below a sixteenth of the largest, as near a panorama's poles."""


@lru_cache(maxsize=8)
def _corners_of(sensor: Sensor) -> _Corners:
    _, valid = pixel_directions(sensor)
    needed = _corners_around(valid)
    v, u = np.nonzero(needed)
    rays = rays_of(sensor, np.asarray(u - 0.5, dtype=np.float64), np.asarray(v - 0.5, dtype=np.float64))
    unit = np.full((*needed.shape, 3), np.nan)
    unit[needed] = (rays / np.linalg.norm(rays, axis=0)).T
    tall, wide = (np.linalg.norm(np.diff(unit, axis=axis), axis=-1) for axis in (0, 1))
    coarsest = float(max(np.nanmax(tall), np.nanmax(wide)))
    least = coarsest / _NARROW
    narrow = np.minimum(np.minimum(tall[:, 1:], tall[:, :-1]), np.minimum(wide[1:], wide[:-1])) < least
    corner = np.flatnonzero(needed)
    index = np.full(needed.size, -1, dtype=np.int32)
    index[corner] = np.arange(corner.size)
    return _Corners(
        corner=corner,
        index=index,
        rays=rays,
        finest_rad=max(float(min(np.nanmin(tall), np.nanmin(wide))), least),
        coarsest_rad=coarsest,
        narrow=narrow,
    )


def _corners_around(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The corners `[height + 1, width + 1]` of selected pixels `[height, width]`."""
    corners = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1), dtype=bool)
    for rows in (slice(0, -1), slice(1, None)):
        for columns in (slice(0, -1), slice(1, None)):
            corners[rows, columns] |= pixels
    return corners


def _face_of_pixels(view: View, sensor: Sensor, threads: int | None, *, with_edges: bool = True) -> Ints:
    """The face that fills each pixel `[height, width]`, -1 for the background, or TRACE, or INVALID.

    Outlines are detected from their points, which are sampled more densely than pixels. Where two faces intersect there
    is no outline, but then the corners of a pixel lie on both: within one pixel the line of intersection is straight to
    far less than the margin between the outermost samples and the pixel's border.
    """
    _, valid = pixel_directions(sensor)
    corners = _corners_of(sensor)
    camera = parameters_of(sensor)
    step = 0.9 * corners.finest_rad
    # Two pixels beyond the field, as the corners of pixels at the rim lie outside.
    field = field_of(sensor, margin_rad=2 * corners.coarsest_rad)
    marks = corners.narrow.copy()  # traced instead, so that edges need not be sampled too closely
    goes_round = seam_px(sensor) > 0

    def mark(start: int) -> None:
        edges = view.geometry.edges[start : start + RAYS]
        mark_edges(edges, view.origin, view.rotation, camera, field, step, goes_round, marks)

    if with_edges:
        in_threads(mark, range(0, len(view.geometry.edges), RAYS), threads)

    # In a fine mesh nearly every pixel has an edge, and few corners remain to be traced.
    needed = _corners_around(valid & ~marks).ravel()
    face = np.full(needed.size, TRACE, dtype=np.int32)

    def trace(start: int) -> None:
        corner, rays = corners.corner[start : start + RAYS], corners.rays[:, start : start + RAYS]
        some = needed[corner]
        if not some.all():
            corner, rays = corner[some], rays[:, some]
        directions = np.empty((corner.size, 3), dtype=np.float32)
        rotate_rays(rays, view.rotation, directions)
        triangle = nearest_triangles(view.geometry, view.origin, directions)
        face[corner] = view.geometry.face_of_triangle[triangle]

    in_threads(trace, range(0, corners.corner.size, RAYS), threads)
    out = np.empty(valid.shape, dtype=np.int32)
    classify_pixels(face.reshape(valid.shape[0] + 1, -1), valid, marks, out)
    if view.geometry.closed:
        # Corners whose rays slipped through a crack; their samples are traced with more care.
        out[out == -1] = TRACE
    return out


def _shaded(view: View, sensor: Sensor, faces: Ints, samples: int, threads: int | None) -> Image:
    """The mean of every pixel's samples, given the face that fills it, or TRACE."""
    corners = _corners_of(sensor)
    image = np.zeros((len(view.bands), faces.size), dtype=np.float32)
    shading = Shading(view, sensor, corners.index, corners.rays, faces.ravel(), image)
    return shaded(shading, faces.shape, samples, threads)
