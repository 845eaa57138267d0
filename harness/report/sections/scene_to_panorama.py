"""The stages of the data: environment, mirror image, panorama, LoG (the paper's figure 4)."""

import math
from collections.abc import Iterator

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from numpy.typing import NDArray

from harness.camera.central import central_of
from harness.geometry.angles import Array, normalise
from harness.pipeline.trial import Outcome
from harness.report import theme
from harness.report.blocks import Fields, in_blocks, rms
from harness.report.data import Data
from harness.report.markup import html
from harness.report.panoramas import extent_of, panorama_axes, unmirrored
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.sensor_images import draw_mask, image_axes, mask_words
from harness.report.theme import HALF, INK, Picture
from harness.report.words import what_differs
from harness.simulation.scene_geometry import Geometry, geometry_near
from harness.simulation.texture import lookup

_ENVIRONMENT = """
Where the images come from. (a) The scene from outside, the nearest surfaces of a closed scene cut away, with both
viewpoints; surfaces are shaded by orientation in this overview only. (b) The image that the camera takes through
the {{ trial.sensor.model.title }} at <i>v</i><sub>1</sub>, {{ trial.sensor.camera.width_px }} ×
{{ trial.sensor.camera.height_px }} px,
{{ trial.render.samples }} samples a pixel; grey 0 outside the mirror’s rim and where the camera sees itself
{%- if masked %}; {{ masked }}{% endif %}.
"""
_SECOND_VIEW = """
The image of <i>v</i><sub>2</sub>, with {{ own }}: {{ sensor.model.title }},
{{ sensor.camera.width_px }} × {{ sensor.camera.height_px }} px
{%- if masked %}; {{ masked }}{% endif %}.
"""
_PANORAMAS = """
The view of <i>v</i><sub>1</sub> on a cylinder around the vertical axis, {{ trial.panorama.width_px }} ×
{{ trial.panorama.height_px }} px, (c) as unwrapped and (d) filtered as it is matched
{%- if trial.filter.log_sigma_px %}, clipped at the 99th percentile{% endif %}.
The azimuth descends from left to right, as seen from inside; <i>z</i> is the height on a cylinder of radius 1.
"""


@section_of(About.BASE_TRIAL, "data", "From scene to filtered panorama", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """The scene, a mirror image, the panorama, and the filtered panorama that is matched."""
    outcome, trial = context.methods[0].outcome, context.trial
    yield Figure(
        "figure-environment",
        [environment(outcome), mirror_image(outcome)],
        html(_ENVIRONMENT, trial=trial, masked=mask_words(outcome.trial.assumed_sensors[0])),
        data=Data(
            "viewpoints",
            ["view", "x_m", "y_m", "z_m"],
            [[i + 1, *pose.position_m] for i, pose in enumerate(outcome.trial.poses)],
        ),
        paper="fig. 4(a) and (b)",
    )
    if outcome.trial.sensors[0] != outcome.trial.sensors[1]:
        first, second = outcome.trial.sensors
        own = what_differs((first, second))
        caption = html(_SECOND_VIEW, sensor=second, own=own, masked=mask_words(central_of(second)))
        yield Figure("figure-second-view", [mirror_image(outcome, 1)], caption)
    fields: Fields = {
        "grey_mean": (outcome.panoramas[0].values, outcome.panoramas[0].valid, np.mean),
        "log_rms": (outcome.filtered[0].values, outcome.filtered[0].valid, rms),
    }
    yield Figure(
        "figure-panoramas",
        [panorama(outcome), filtered(outcome)],
        html(_PANORAMAS, trial=trial),
        "wide",
        in_blocks("panorama-blocks", trial.panorama, fields),
        paper="fig. 4(c) and (d)",
    )


@theme.panel
def environment(outcome: Outcome) -> Picture:
    """The scene from outside, near surfaces of a closed one cut away, with both viewpoints."""
    trial = outcome.trial
    geometry = geometry_near(trial.scene, trial.poses[0].position_m)
    camera = _Overview(geometry)
    width, height = HALF, 400
    fig = theme.figure(width, height)
    ax = theme.axes(fig, 0, 0, width, height)
    ax.set_axis_off()
    extent = camera.window(width / height)
    ax.imshow(_overview_image(geometry, camera, extent, width, height), cmap="gray", vmin=0, vmax=255, extent=extent)
    low, high = geometry.bounds
    _draw_bounds(ax, camera, low, high)

    floor = low[2]
    viewpoints = [np.asarray(pose.position_m) - geometry.centre for pose in trial.poses]
    for number, viewpoint in enumerate(viewpoints, 1):
        foot = np.array([viewpoint[0], viewpoint[1], floor])
        ax.plot(*camera.project(np.stack([foot, viewpoint])).T, color="white", linewidth=3, solid_capstyle="butt")
        ax.plot(*camera.project(np.stack([foot, viewpoint])).T, color=INK, linewidth=1.2, solid_capstyle="butt")
        x, y = camera.project(viewpoint)
        ax.plot(x, y, "o", markersize=6, color=theme.PIXEL, markeredgecolor="white", markeredgewidth=1)
        side = "right" if number == 1 else "left"
        ax.annotate(
            f"$v_{number}$",
            (x, y),
            (-8 if number == 1 else 8, 4),
            textcoords="offset points",
            ha=side,
            fontsize=12,
            bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    ax.set_xlim(extent[0], extent[1])
    ax.set_ylim(extent[2], extent[3])
    v1, v2 = (
        ", ".join(f"{value:.10g}" for value in (viewpoint + geometry.centre).round(6)) for viewpoint in viewpoints
    )
    alt = (
        f"The scene {trial.scene.name} from outside and above, {_size(low, high)} metres, nearest surfaces cut away, "
        f"with viewpoint v1 at ({v1}) m and v2 at ({v2}) m."
    )
    return theme.picture(fig, alt, "(a) environment")


@theme.panel
def mirror_image(outcome: Outcome, view: int = 0) -> Picture:
    """The mirror image of view 0 or 1 as its camera takes it."""
    image, sensor = outcome.images[view], outcome.trial.assumed_sensors[view]
    rows, columns = image.shape
    fig, ax, extent = image_axes(rows, columns)
    ax.imshow(image, cmap=_greys(), vmin=0, vmax=255, extent=extent, aspect="auto")
    draw_mask(ax, sensor)
    alt = f"Mirror image of view {view + 1}, {columns} by {rows} pixels: the scene as a disc, the horizon near its rim."
    return theme.picture(fig, alt, f"{'' if view else '(b) '}{sensor.model.title} image of view {view + 1}")


@theme.panel
def panorama(outcome: Outcome) -> Picture:
    """View 1's panorama, unmirrored."""
    grid = outcome.trial.panorama
    values = np.where(outcome.panoramas[0].valid, outcome.panoramas[0].values, np.nan)
    fig, ax, bar = panorama_axes(grid)
    drawn = ax.imshow(unmirrored(values), cmap=_greys(), vmin=0, vmax=255, extent=extent_of(grid), aspect="auto")
    fig.colorbar(drawn, cax=bar, label="grey level")
    alt = (
        f"Panorama of view 1, {grid.width_px} by {grid.height_px} pixels, azimuth descending from 180 to -180 degrees."
    )
    return theme.picture(fig, alt, "(c) panorama of view 1")


@theme.panel
def filtered(outcome: Outcome) -> Picture:
    """View 1's panorama after the Laplacian of Gaussian, which is what is matched."""
    grid, sigma = outcome.trial.panorama, outcome.trial.filter.log_sigma_px
    view = outcome.filtered[0]
    values = np.where(view.valid, view.values, np.nan)
    fig, ax, bar = panorama_axes(grid)
    known = values[view.valid]
    if sigma:
        limit = float(np.percentile(np.abs(known), 99)) if known.size else 1.0
        low, high = -limit, limit
    else:
        low, high = 0.0, 255.0
    drawn = ax.imshow(unmirrored(values), cmap=_greys(), vmin=low, vmax=high, extent=extent_of(grid), aspect="auto")
    fig.colorbar(
        drawn, cax=bar, label="LoG (grey levels)" if sigma else "grey level", extend="both" if sigma else "neither"
    )
    alt = f"The same panorama after a Laplacian of Gaussian of {sigma:g} pixels: edges light and dark on an even grey."
    return theme.picture(
        fig, alt, f"(d) Laplacian of Gaussian, σ = {sigma:g} px" if sigma else "(d) unfiltered (σ = 0)"
    )


def _greys() -> Colormap:
    """64 of them, which look the same: noise in the last two bits is a quarter of a picture's bytes."""
    return colormaps["gray"].resampled(64)


def _size(low: Array, high: Array) -> str:
    return " by ".join(f"{side:.3g}" for side in high - low)


class _Overview:
    """A virtual pinhole camera outside the scene that looks at its middle."""

    def __init__(self, geometry: Geometry) -> None:
        low, high = geometry.bounds
        self.centre = (low + high) / 2
        self.corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
        self.diagonal = float(np.linalg.norm(high - low))
        azimuth, elevation = math.radians(-112), math.radians(33)
        away = np.array(
            [
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            ]
        )
        self.position = self.centre + 2.2 * self.diagonal * away
        self.forward = -away
        self.right = normalise(np.cross(self.forward, [0.0, 0.0, 1.0]))
        self.up = np.cross(self.right, self.forward)

    def project(self, points: Array) -> Array:
        """Picture coordinates `[..., 2]` of points in the world."""
        p = points - self.position
        return np.stack([p @ self.right, p @ self.up], axis=-1) / (p @ self.forward)[..., None]

    def rays(self, x: Array, y: Array) -> Array:
        """Directions through picture coordinates, as long as the picture is away at 1."""
        return np.asarray(self.forward + x[..., None] * self.right + y[..., None] * self.up)

    def window(self, shape: float) -> tuple[float, float, float, float]:
        """Left, right, bottom, top of a picture of a shape (width / height) that holds the whole scene."""
        projected = self.project(self.corners)
        low, high = projected.min(axis=0), projected.max(axis=0)
        middle, size = (low + high) / 2, (high - low) * 1.14
        size = np.array([max(size[0], size[1] * shape), max(size[1], size[0] / shape)])
        left, bottom = middle - size / 2
        right, top = middle + size / 2
        return float(left), float(right), float(bottom), float(top)


def _overview_image(
    geometry: Geometry, camera: _Overview, extent: tuple[float, float, float, float], width: int, height: int
) -> NDArray[np.uint8]:
    """The scene without its near side: rays begin just inside the bounds that they enter."""
    per_side = 2
    left, right, bottom, top = extent
    x = left + (np.arange(width * per_side) + 0.5) * (right - left) / (width * per_side)
    y = top - (np.arange(height * per_side) + 0.5) * (top - bottom) / (height * per_side)
    rays = camera.rays(*np.meshgrid(x, y)).reshape(-1, 3)
    low, high = geometry.bounds
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - camera.position) / rays, (high - camera.position) / rays
    enter = np.minimum(to_low, to_high).max(axis=-1)
    leave = np.maximum(to_low, to_high).min(axis=-1)
    meets = np.flatnonzero(enter < leave)
    rays = rays[meets]
    origins = np.broadcast_to(camera.position, rays.shape)
    if geometry.closed:
        origins = origins + (enter[meets] + 1e-4 * camera.diagonal)[:, None] * rays
    triangle = np.asarray(geometry.embree.run(origins.astype(np.float32), rays.astype(np.float32)))
    hit = triangle >= 0
    rays, face = rays[hit], geometry.face_of_triangle[triangle[hit]]
    grey = np.full(height * width * per_side**2, 255.0)
    grey[meets[hit]] = _shaded(geometry, camera.position, rays, face)
    small = grey.reshape(height, per_side, width, per_side).mean(axis=(1, 3))
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def _shaded(geometry: Geometry, origin: Array, rays: Array, face: NDArray[np.int32]) -> Array:
    """Grey levels of hits, lightened and dimmed by which way a surface faces so that walls stand apart."""
    # Range to each face's plane is reach / towards, so that uv = (map @ position) + (reach / towards) (map @ ray).
    reach = (geometry.offsets - geometry.normals @ origin)[face]
    towards = np.einsum("ij,ij->i", geometry.normals[face], rays)
    at_origin = geometry.uv_maps @ np.append(origin, 1.0)
    along = np.einsum("nij,nj->ni", geometry.uv_maps[..., :3][face], rays)
    uv = at_origin[face] + (reach / towards)[:, None] * along
    grey = np.empty(len(rays))
    texture = geometry.texture_of_face[face]
    for index in np.unique(texture):
        with_texture = texture == index
        grey[with_texture] = lookup(geometry.textures[index], uv[with_texture])
    light = np.minimum(0.72 + 0.28 * np.abs(geometry.normals) @ np.array([0.1, 0.55, 1.0]), 1.0)
    return 40 + 0.84 * grey * light[face]


def _draw_bounds(ax: Axes, camera: _Overview, low: Array, high: Array) -> None:
    """The outline of the scene's bounds with its three lengths."""
    corners = camera.corners.reshape(2, 2, 2, 3)
    for axis in range(3):
        first, second = (np.take(corners, side, axis=axis).reshape(4, 3) for side in (0, 1))
        for a, b in zip(first, second, strict=True):
            ax.plot(*camera.project(np.stack([a, b])).T, color=INK, linewidth=0.6, alpha=0.55)
    lengths = (
        (corners[0, 0, 0], corners[1, 0, 0], "$x$", (0, -5), "center", "top"),
        (corners[0, 0, 0], corners[0, 1, 0], "$y$", (-4, -4), "right", "top"),
        (corners[1, 0, 0], corners[1, 0, 1], "$z$", (5, 0), "left", "center"),
    )
    for (a, b, name, offset, ha, va), length in zip(lengths, high - low, strict=True):
        x, y = camera.project((a + b) / 2)
        ax.annotate(f"{name}: {length:.3g} m", (x, y), offset, textcoords="offset points", ha=ha, va=va, fontsize=9.5)
