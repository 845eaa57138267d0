"""Rendering: every pixel of a sensor's image is the mean of a regular grid of exact samples.

A grid that is too coarse for its texture aliases. So the samples of a pixel are doubled in each direction where they
are more than 1.5 texels apart, doubled twice where they are more than 8 apart (by the pixel's longest side on its
face), and doubled where they fall on faces of several textures, such as those of two objects. A pixel of several faces
of one texture, as in a fine mesh, keeps its samples.

There is no lighting: the grey of a pixel is that of the texture. Most pixels lie inside one face, whose texture
coordinates are a homography of the ray; only the others are traced sample by sample. A pixel counts as inside a face
when its four corners hit that face and no outline of a face passes near it (see `_face_of_pixels`).
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, field_of, parameters_of, pixel_directions, rays_of, seam_px
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation._rendering_kernels import (
    TRACE,
    classify_pixels,
    face_ranges,
    faces_in_pixels,
    faces_of_triangles,
    mark_edges,
    rotate_rays,
    sample_positions,
    sampling_levels,
    shade,
)
from harness.simulation.cast import cast, nearest_triangles, rotated
from harness.simulation.content_cache import cached_by_content
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Geometry, Ints, check_viewpoint, geometry_near, geometry_of, homographies
from harness.threads import in_threads

Image = NDArray[np.float32]

_RAYS = 1 << 15
"""Rays per thread and batch: few enough for the CPU's caches, enough to keep the interpreter's overhead small."""

_NARROW = 16.0
"""Largest ratio of the longest side of a pixel to the shortest for which edges are sampled."""

_MOST_PER_SIDE = 32
"""Most samples along each side of a pixel, unless `render.samples` asks for more."""


def render(scene: Scene, sensor: Sensor, pose: Pose, samples: int = 16, threads: int | None = None) -> Image:
    """The image `[height, width]` of a scene, grey levels 0 .. 255; 0 outside the sensor's field.

    Parameters
    ----------
    samples
        Samples per pixel, a square number; up to 16 times as many, at most 1,024, where they are too coarse for a
        texture or an outline (see above). A pixel whose centre is in the field has all its samples shaded, even those
        slightly beyond the mirror's rim.
    threads
        Number of threads; by default all available CPUs. The image does not depend on it.

    Raises
    ------
    InputError
        When the view is outside the scene or inside an object, a ray escapes from a closed scene, or a grey level is
        not a finite number.
    """
    view = _view(scene, pose)
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
    view = _view(scene, pose)
    faces = _face_of_pixels(view, sensor, threads)
    directions, _ = pixel_directions(sensor)
    range_m = np.full(faces.shape, np.nan)
    normals = view.geometry.normals
    distances = view.geometry.offsets - normals @ view.origin
    face_ranges(faces.ravel(), directions.reshape(-1, 3), normals @ view.rotation, distances, range_m.reshape(-1))
    traced = np.flatnonzero(faces == TRACE)

    def work(start: int) -> None:
        pixels = traced[start : start + _RAYS]
        world = rotated(directions.reshape(-1, 3)[pixels], view.rotation)
        range_m.reshape(-1)[pixels] = cast(view.geometry, view.origin, world, threads=1).range_m

    in_threads(work, range(0, traced.size, _RAYS), threads)
    return _shaded(view, sensor, faces, samples, threads), range_m


def render_every_sample(
    scene: Scene, sensor: Sensor, pose: Pose, samples: int = 16, threads: int | None = None
) -> Image:
    """The image, as from `render`, by tracing every sample: the slow reference implementation."""
    _, valid = pixel_directions(sensor)
    faces = np.where(valid, TRACE, TRACE - 1).astype(np.int32)
    return _shaded(_view(scene, pose), sensor, faces, samples, threads)


@dataclass(frozen=True)
class _View:
    """A geometry seen from a viewpoint."""

    geometry: Geometry
    origin: Array
    """`[3]`, metres, relative to the geometry's centre."""
    rotation: Array
    """World from view, `[3, 3]`."""
    H: Array
    """`[faces, 3, 3]`: for each face the map from a ray in the view's frame to its tile (see `_kernels.shade`)."""
    tiles: "_Tiles"


def _view(scene: Scene, pose: Pose) -> _View:
    geometry = geometry_near(scene, pose.position_m)
    origin = np.asarray(pose.position_m, dtype=np.float64) - geometry.centre
    check_viewpoint(geometry, origin)
    rotation = pose.R_world_from_view
    tiles = _tiles_of(scene)
    maps = _maps_of_tiles(geometry, tiles)
    return _View(geometry, origin, rotation, homographies(geometry, maps, origin, rotation), tiles)


@dataclass(frozen=True)
class _Tiles:
    """The textures of a scene in the form of the shading kernel's arguments."""

    texels: NDArray[np.float32]
    """All textures end to end, each padded by its first two rows and columns: one for the bilinear lookup, the other
    for coordinates that round up to the tile's size."""
    layout: NDArray[np.int64]
    """`[textures, 3]`: start, height and width of each, without the padding."""


@cached_by_content(2)
def _tiles_of(scene: Scene) -> _Tiles:
    geometry = geometry_of(scene)
    padded: list[NDArray[np.float32]] = []
    layout, starts, start = [], {}, 0
    for texels in geometry.textures:
        if id(texels) not in starts:  # one array on many faces is stored once
            starts[id(texels)] = start
            padded.append(np.pad(texels, ((0, 2), (0, 2)), mode="wrap").ravel())
            start += padded[-1].size
        layout.append((starts[id(texels)], *texels.shape))
    return _Tiles(np.concatenate(padded), np.array(layout, dtype=np.int64))


def _maps_of_tiles(geometry: Geometry, tiles: _Tiles) -> Array:
    """The faces' texture maps `[faces, 2, 4]`, with v down, and both from the first texel's centre."""
    size = tiles.layout[geometry.texture_of_face]
    maps = geometry.uv_maps * np.array([1.0, -1.0])[:, None]
    maps[:, 0, 3] -= 0.5 / size[:, 2]
    maps[:, 1, 3] += 1 - 0.5 / size[:, 1]
    return maps


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


def _face_of_pixels(view: _View, sensor: Sensor, threads: int | None, *, with_edges: bool = True) -> Ints:
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
    marks = corners.narrow.copy()  # those are traced, lest edges be sampled ever more closely on their account
    goes_round = seam_px(sensor) > 0

    def mark(start: int) -> None:
        edges = view.geometry.edges[start : start + _RAYS]
        mark_edges(edges, view.origin, view.rotation, camera, field, step, goes_round, marks)

    if with_edges:
        in_threads(mark, range(0, len(view.geometry.edges), _RAYS), threads)

    # In a fine mesh nearly every pixel has an edge, and few corners remain to be traced.
    needed = _corners_around(valid & ~marks).ravel()
    face = np.full(needed.size, TRACE, dtype=np.int32)

    def trace(start: int) -> None:
        corner, rays = corners.corner[start : start + _RAYS], corners.rays[:, start : start + _RAYS]
        some = needed[corner]
        if not some.all():
            corner, rays = corner[some], rays[:, some]
        directions = np.empty((corner.size, 3), dtype=np.float32)
        rotate_rays(rays, view.rotation, directions)
        triangle = nearest_triangles(view.geometry, view.origin, directions)
        face[corner] = view.geometry.face_of_triangle[triangle]

    in_threads(trace, range(0, corners.corner.size, _RAYS), threads)
    out = np.empty(valid.shape, dtype=np.int32)
    classify_pixels(face.reshape(valid.shape[0] + 1, -1), valid, marks, out)
    if view.geometry.closed:
        # Corners whose rays slipped through a crack; their samples are traced with more care.
        out[out == -1] = TRACE
    return out


def _shaded(view: _View, sensor: Sensor, faces: Ints, samples: int, threads: int | None) -> Image:
    """The mean of every pixel's samples, given the face that fills it, or TRACE."""
    per_side = math.isqrt(max(samples, 0))
    if samples < 1 or per_side * per_side != samples:
        raise ValueError(f"samples must be a square number, such as 4, 16 or 64; found {samples}")
    shading = _Shading(view, sensor, _corners_of(sensor), faces.ravel(), np.zeros(faces.size, dtype=np.float32))
    pieces = _in_pieces(np.flatnonzero(shading.face == TRACE), per_side)
    pieces += _in_pieces(np.flatnonzero(shading.face > TRACE), per_side)
    in_threads(lambda pixels: shading.write(pixels, per_side), pieces, threads)
    image = shading.image
    if not np.isfinite(image).all():
        raise InputError(
            f"the image from {_where(view)} has {np.count_nonzero(~np.isfinite(image))} pixels whose grey level is not "
            "a finite number; check the textures and the sizes of the objects",
            file=view.geometry.name,
        )
    return image.reshape(faces.shape)


@dataclass(frozen=True)
class _Shading:
    """An image that is being shaded."""

    view: _View
    sensor: Sensor
    corners: _Corners
    face: Ints
    """The face that fills each pixel, -1 for the background, or TRACE, or INVALID; flat."""
    image: Image
    """Flat."""

    def write(self, pixels: NDArray[np.int64], per_side: int) -> None:
        """Write the grey of pixels that are either all traced or all not, with more samples where needed."""
        traced = self.face[pixels[0]] == TRACE
        if traced:
            rays = self._rays(pixels, per_side)
            face = _traced_faces(self.view, rays)
            several, differ = np.empty((2, pixels.size), dtype=np.bool_)
            faces_in_pixels(face, per_side**2, self.view.geometry.texture_of_face, several, differ)
            of_pixel = face.reshape(pixels.size, -1)
            level = np.where(several, differ, self._levels(pixels, of_pixel[:, 0], per_side))
            done = level == 0
            self._shade(pixels[done], rays.reshape(3, pixels.size, -1)[:, done], of_pixel[done].ravel(), per_side)
        else:
            level = self._levels(pixels, self.face[pixels], per_side)
        for each in (1, 2) if traced else (0, 1, 2):
            finer = max(per_side, min(per_side * 2**each, _MOST_PER_SIDE))
            for some in _in_pieces(pixels[level == each], finer):
                rays = self._rays(some, finer)
                self._shade(some, rays, _traced_faces(self.view, rays) if traced else self.face[some], finer)

    def _levels(self, pixels: NDArray[np.int64], face: Ints, per_side: int) -> NDArray[np.int64]:
        """How many times the samples of pixels are doubled, if one face `[pixels]` fills each."""
        level = np.empty(pixels.size, dtype=np.int64)
        sampling_levels(
            pixels,
            self.sensor.camera.width_px,
            np.ascontiguousarray(face),
            per_side,
            self.corners.index,
            self.corners.rays,
            self.view.H,
            self.view.geometry.texture_of_face,
            self.view.tiles.layout,
            level,
        )
        return level

    def _rays(self, pixels: NDArray[np.int64], per_side: int) -> Array:
        """The rays `[3, pixels * per_side²]` of the pixels' samples, in the sensor's frame."""
        offsets = (np.arange(per_side) + 0.5) / per_side - 0.5
        u, v = np.empty((2, pixels.size * per_side**2))
        sample_positions(pixels, self.sensor.camera.width_px, offsets, u, v)
        return rays_of(self.sensor, u, v)

    def _shade(self, pixels: NDArray[np.int64], rays: Array, face: Ints, per_side: int) -> None:
        geometry, tiles = self.view.geometry, self.view.tiles
        shade(
            rays.reshape(3, -1),
            per_side**2,
            face,
            self.view.H,
            geometry.texture_of_face,
            tiles.texels,
            tiles.layout,
            geometry.background_grey,
            pixels,
            self.image,
        )


def _in_pieces(pixels: NDArray[np.int64], per_side: int) -> list[NDArray[np.int64]]:
    """Batches of pixels, of the size in which they are shaded together with so many samples."""
    at_once = max(1, _RAYS // per_side**2)
    return [pixels[start : start + at_once] for start in range(0, pixels.size, at_once)]


def _where(view: _View) -> str:
    return f"({', '.join(f'{value:.10g}' for value in view.origin + view.geometry.centre)}) m"


def _traced_faces(view: _View, rays: Array) -> Ints:
    """The face that each ray `[3, n]` hits, -1 for none."""
    directions = np.empty((rays.shape[1], 3), dtype=np.float32)
    rotate_rays(rays, view.rotation, directions)
    triangle = nearest_triangles(view.geometry, view.origin, directions)
    face = np.empty(triangle.size, dtype=np.int32)
    misses = faces_of_triangles(triangle, view.geometry.face_of_triangle, face)
    if view.geometry.closed and misses:
        missed = np.flatnonzero(face < 0)
        unit = rotated((rays[:, missed] / np.linalg.norm(rays[:, missed], axis=0)).T, view.rotation)
        hits = cast(view.geometry, view.origin, unit, threads=1)
        face[missed] = view.geometry.face_of_triangle[hits.triangle]
    return face
