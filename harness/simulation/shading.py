"""The grey of an image's pixels: the mean over a regular grid of samples, given what their rays meet."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, rays_of
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.images import COLOURS, Weights
from harness.simulation._rendering_kernels import (
    TRACE,
    faces_in_pixels,
    faces_of_triangles,
    rotate_rays,
    sample_positions,
    sampling_levels,
    shade,
)
from harness.simulation.cast import cast, nearest_triangles, rotated
from harness.simulation.content_cache import cached_by_content
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import (
    Geometry,
    Ints,
    band_of,
    check_viewpoint,
    geometry_near,
    geometry_of,
    homographies,
)
from harness.simulation.texture import Texels
from harness.threads import in_threads

Image = NDArray[np.float32]

RAYS = 1 << 15
"""Rays per thread and batch: few enough for the CPU's caches, enough to keep the interpreter's overhead small."""

_MOST_PER_SIDE = 32
"""Most samples along each side of a pixel, unless `render.samples` asks for more."""


@dataclass(frozen=True)
class View:
    """A geometry seen from a viewpoint."""

    geometry: Geometry
    origin: Array
    """`[3]`, metres, relative to the geometry's centre."""
    rotation: Array
    """World from view, `[3, 3]`."""
    H: Array
    """`[faces, 3, 3]`: for each face the map from a ray in the view's frame to its tile (see `_kernels.shade`)."""
    tiles: "Tiles"
    bands: tuple["Band", ...]
    """The bands to shade: the luma alone, or red, green and blue."""


@dataclass(frozen=True)
class Band:
    """A band of the colours of a geometry's textures."""

    maps: Array
    """`[faces, 2, 4]`, as of `maps_of_tiles`."""
    H: Array
    """The maps from rays to tiles of this band, as `View.H`."""
    tiles: "Tiles"


def view_from(scene: Scene, pose: Pose, *, colour: bool = False) -> View:
    """The scene as seen by a view.

    Parameters
    ----------
    colour
        Whether red, green and blue are shaded. How closely pixels are sampled depends on the luma in any case.

    Raises
    ------
    InputError
        When the view's position is not valid, as from `check_viewpoint`.
    """
    geometry = geometry_near(scene, pose.position_m)
    origin = np.asarray(pose.position_m, dtype=np.float64) - geometry.centre
    check_viewpoint(geometry, origin)
    rotation = pose.R_world_from_view
    tiles = _tiles_of(scene)
    maps = maps_of_tiles(geometry, tiles)
    H = homographies(geometry, maps, origin, rotation)
    bands = [Band(maps, H, tiles)]
    if colour:
        bands = []
        for weights in COLOURS:
            x, y, z = geometry.centre.tolist()
            uv_maps, its_tiles = _band_of(scene, (x, y, z), weights)
            maps = maps_of_tiles(geometry, its_tiles, uv_maps)
            bands.append(Band(maps, homographies(geometry, maps, origin, rotation), its_tiles))
    return View(geometry, origin, rotation, H, tiles, tuple(bands))


@dataclass(frozen=True)
class Tiles:
    """The textures of a scene in the form of the shading kernel's arguments."""

    texels: NDArray[np.float32]
    """All textures end to end, each padded by its first two rows and columns: one for the bilinear lookup, the other
    for coordinates that round up to the tile's size."""
    layout: NDArray[np.int64]
    """`[textures, 3]`: start, height and width of each, without the padding."""


@cached_by_content(2)
def _tiles_of(scene: Scene) -> Tiles:
    return _tiles(geometry_of(scene).textures)


@cached_by_content(6)
def _band_of(scene: Scene, centre: tuple[float, float, float], weights: Weights) -> tuple[Array, Tiles]:
    uv_maps, textures = band_of(scene, centre, weights)
    return uv_maps, _tiles(textures)


def _tiles(textures: tuple[Texels, ...]) -> Tiles:
    padded: list[NDArray[np.float32]] = []
    layout, starts, start = [], {}, 0
    for texels in textures:
        if id(texels) not in starts:  # one array on many faces is stored once
            starts[id(texels)] = start
            padded.append(np.pad(texels, ((0, 2), (0, 2)), mode="wrap").ravel())
            start += padded[-1].size
        layout.append((starts[id(texels)], *texels.shape))
    return Tiles(np.concatenate(padded), np.array(layout, dtype=np.int64))


def maps_of_tiles(geometry: Geometry, tiles: Tiles, uv_maps: Array | None = None) -> Array:
    """The faces' texture maps `[faces, 2, 4]`, with v down, and both from the first texel's centre.

    Parameters
    ----------
    uv_maps
        The texture maps of another band; the geometry's when None.
    """
    size = tiles.layout[geometry.texture_of_face]
    maps = (geometry.uv_maps if uv_maps is None else uv_maps) * np.array([1.0, -1.0])[:, None]
    maps[:, 0, 3] -= 0.5 / size[:, 2]
    maps[:, 1, 3] += 1 - 0.5 / size[:, 1]
    return maps


@dataclass(frozen=True)
class Shading:
    """An image that is being shaded, of a sensor whose rays meet in the viewpoint."""

    view: View
    sensor: Sensor
    corner_index: NDArray[np.int32]
    """For each corner of the grid of pixels, flat: the column of `corner_rays` that is its ray; -1 for none."""
    corner_rays: Array
    """`[3, n]`, in the sensor's frame."""
    face: Ints
    """The face that fills each pixel, -1 for the background, or TRACE, or INVALID; flat."""
    image: Image
    """`[bands, pixels]`, flat."""

    def write(self, pixels: NDArray[np.int64], per_side: int) -> None:
        """Write the grey of pixels that are either all traced or all not, with more samples where needed."""
        traced = self.face[pixels[0]] == TRACE
        if traced:
            rays = self._rays(pixels, per_side)
            face = self._faces(rays)
            several, differ = np.empty((2, pixels.size), dtype=np.bool_)
            faces_in_pixels(face, per_side**2, self.view.geometry.texture_of_face, several, differ)
            of_pixel = face.reshape(pixels.size, -1)
            level = np.where(several, differ, self._levels(pixels, of_pixel[:, 0], per_side))
            self._shade(pixels, np.flatnonzero(level == 0), rays, face, per_side)
        else:
            level = self._levels(pixels, self.face[pixels], per_side)
        for each in (1, 2) if traced else (0, 1, 2):
            finer = max(per_side, min(per_side * 2**each, _MOST_PER_SIDE))
            for some in _in_pieces(pixels[level == each], finer):
                rays = self._rays(some, finer)
                face = self._faces(rays) if traced else self.face[some]
                self._shade(some, np.arange(some.size), rays, face, finer)

    def _levels(self, pixels: NDArray[np.int64], face: Ints, per_side: int) -> NDArray[np.int64]:
        """The number of times that the samples of pixels are doubled, if one face `[pixels]` fills each."""
        level = np.empty(pixels.size, dtype=np.int64)
        sampling_levels(
            pixels,
            self.sensor.camera.width_px,
            np.ascontiguousarray(face),
            per_side,
            self.corner_index,
            self.corner_rays,
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

    def _shade(
        self, pixels: NDArray[np.int64], chosen: NDArray[np.int64], rays: Array, face: Ints, per_side: int
    ) -> None:
        """Write the grey levels of the chosen pixels, by their indices among them; `rays` are the samples of all."""
        for i, band in enumerate(self.view.bands):
            self._shade_band(pixels, chosen, rays, face, per_side, band.H, i)

    def _shade_band(
        self,
        pixels: NDArray[np.int64],
        chosen: NDArray[np.int64],
        rays: Array,
        face: Ints,
        per_side: int,
        H: Array,
        band: int,
    ) -> None:
        geometry, tiles = self.view.geometry, self.view.bands[band].tiles
        shade(
            chosen,
            rays,
            per_side**2,
            face,
            H,
            geometry.texture_of_face,
            tiles.texels,
            tiles.layout,
            geometry.background_grey,
            pixels,
            self.image[band],
        )

    def _faces(self, rays: Array) -> Ints:
        """The face that each ray `[3, n]` hits, -1 for none."""
        view = self.view
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


def _in_pieces(pixels: NDArray[np.int64], per_side: int) -> list[NDArray[np.int64]]:
    """Batches of pixels, of the size in which they are shaded together with so many samples."""
    at_once = max(1, RAYS // per_side**2)
    return [pixels[start : start + at_once] for start in range(0, pixels.size, at_once)]


def _where(view: View) -> str:
    return f"({', '.join(f'{value:.10g}' for value in view.origin + view.geometry.centre)}) m"


def shaded(shading: Shading, shape: tuple[int, ...], samples: int, threads: int | None) -> Image:
    """The mean of every pixel's samples, `[height, width]`, or `[height, width, 3]` of a view in colour.

    Raises
    ------
    InputError
        When a grey level is not a finite number.
    ValueError
        When `samples` is no square number.
    """
    per_side = math.isqrt(max(samples, 0))
    if samples < 1 or per_side * per_side != samples:
        raise ValueError(f"samples must be a square number, such as 4, 16 or 64; found {samples}")
    pieces = _in_pieces(np.flatnonzero(shading.face == TRACE), per_side)
    pieces += _in_pieces(np.flatnonzero(shading.face > TRACE), per_side)
    in_threads(lambda pixels: shading.write(pixels, per_side), pieces, threads)
    image = shading.image[0] if len(shading.image) == 1 else np.ascontiguousarray(shading.image.T)
    if not np.isfinite(image).all():
        count = np.count_nonzero(~np.isfinite(shading.image).all(axis=0))
        raise InputError(
            f"the image from {_where(shading.view)} has {count} pixels whose grey level is not a finite number; check "
            "the textures and the sizes of the objects",
            file=shading.view.geometry.name,
        )
    return image.reshape(*shape, *image.shape[1:])
