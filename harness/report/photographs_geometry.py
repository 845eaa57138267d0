"""Figures on the geometry of two photographs: how far matches lie off their epipolar curves, and some of the curves."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from harness.camera.plane_images import plane_points
from harness.camera.sensor import project
from harness.geometry.angles import Array, normalise
from harness.pipeline.photographs import Estimate
from harness.report import theme
from harness.report.panoramas import panorama_axes
from harness.report.sensor_images import draw_mask, image_axes
from harness.report.theme import Picture

_CURVES = 5
_COLOURS = (theme.PIXEL, theme.SUBPIXEL, *theme.SPARE)
_LOOSE = 0.5
"""Weight below which a tile is drawn as one that does not go with the rest."""


@theme.panel
def across_picture(estimate: Estimate) -> Picture:
    """Distances of matches from their epipolar curves, over the panorama."""
    check, grid = estimate.geometry, estimate.pair.grid
    table = check.table()
    fig, ax, bar = panorama_axes(grid, top=8)
    limit = max(3 * check.noise_px, float(np.percentile(np.abs(table.across_px), 95))) if len(table) else 1.0
    loose = (table.weight < _LOOSE).to_numpy()
    z = np.tan(np.radians(table.elevation_deg))
    drawn = ax.scatter(
        table.azimuth_deg, z, c=table.across_px, cmap=_diverging(), vmin=-limit, vmax=limit, s=22, marker="s",
        linewidths=np.where(loose, 0.9, 0.25).tolist(), edgecolors=[theme.INK if each else "#777777" for each in loose],
    )  # fmt: skip
    fig.colorbar(drawn, cax=bar, label="px", extend="both")
    if not len(table):
        theme.note(ax, "no window looks alike in both views")
    alt = (
        f"{len(table)} windows over the panorama, coloured by how far they lie off their epipolar curves, clipped at "
        f"±{limit:.2g} px; {int(loose.sum())} outlined ones do not go with the rest."
    )
    return theme.picture(fig, alt)


def curve_pictures(estimate: Estimate) -> list[Picture]:
    """Both photographs with the epipolar curves of a few points."""
    chosen = _spread_tiles(estimate)
    return [_curves(estimate, view, chosen) for view in range(2)] if len(chosen) else []


@theme.panel
def _curves(estimate: Estimate, view: int, chosen: NDArray[np.intp]) -> Picture:
    colour, sensor = estimate.photographs[view].colour, estimate.pair.sensors[view]
    fig, ax, extent = image_axes(*colour.shape[:2])
    draw_photograph(ax, colour, extent)
    draw_mask(ax, sensor)
    tiles, motion = estimate.geometry.tiles, estimate.pair.motion
    t = motion.t_v1 / motion.baseline_m
    for number, i in enumerate(chosen):
        n, x = normalise(np.cross(t, tiles.x_1[i])), tiles.x_1[i]
        q = x - tiles.w[i] * t
        if view:
            # The matched direction: turned across the curve's plane by delta.
            y = normalise(q)
            n, x = motion.R_v2_from_v1 @ n, motion.R_v2_from_v1 @ (y + np.tan(tiles.delta[i]) * n)
        points = _unbroken(plane_points(sensor, n, 1440))
        ax.plot(points[:, 0], points[:, 1], color="white", linewidth=2.2, alpha=0.6)
        ax.plot(points[:, 0], points[:, 1], color=_COLOURS[number], linewidth=1.1)
        u, v = project(sensor, x)[0]
        ax.plot([u], [v], "o", markersize=5, color=_COLOURS[number], markeredgecolor="white", markeredgewidth=0.8)
        ax.annotate(
            f"{number + 1}", (u, v), (5, 4), textcoords="offset points", color="white", fontweight="bold",
            bbox={"boxstyle": "round,pad=0.15", "facecolor": _COLOURS[number], "edgecolor": "none"}, fontsize=8,
        )  # fmt: skip
    ax.set_xlim(extent[0], extent[1])
    ax.set_ylim(extent[2], extent[3])
    alt = f"Mirror image of view {view + 1} with the epipolar curves of {len(chosen)} points, numbered."
    return theme.picture(fig, alt, f"({'ab'[view]}) epipolar curves in view {view + 1}")


def draw_photograph(ax: Axes, colour: NDArray[np.uint8], extent: tuple[float, float, float, float]) -> None:
    """A photograph on axes of pixels, made smaller where it is very large."""
    fewer = max(1, int(np.ceil(max(colour.shape) / 1024)))  # an aid to see, not data
    shown = colour[::fewer, ::fewer]
    if bool((shown[..., 0] == shown[..., 1]).all() and (shown[..., 0] == shown[..., 2]).all()):
        ax.imshow(shown[..., 0], cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto")
    else:
        ax.imshow(shown, extent=extent, aspect="auto")


def _spread_tiles(estimate: Estimate) -> NDArray[np.intp]:
    """Some tiles that are far apart, on the plane across t, from the sharpest matches."""
    check = estimate.geometry
    if not len(check.tiles):
        return np.zeros(0, np.intp)
    precise = np.flatnonzero(check.sigma_px <= np.median(check.sigma_px))
    n = normalise(np.cross(estimate.pair.motion.t_v1, check.tiles.x_1[precise]))
    picked = [int(np.argmin(check.sigma_px[precise]))]
    while len(picked) < min(_CURVES, len(precise)):
        # Planes have no side: n and -n are the same.
        distance = np.min(1 - np.abs(n @ n[picked].T), axis=1)
        picked.append(int(np.argmax(distance)))
    return precise[picked]


def _unbroken(points: Array) -> Array:
    """The points of a closed curve, begun where it is hidden, and with breaks where it jumps across a seam."""
    hidden = np.flatnonzero(np.isnan(points[:, 0]))
    points = np.roll(points, -int(hidden[-1]), axis=0) if hidden.size else np.vstack([points, points[:1]])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not np.isfinite(steps).any():
        return points
    jumps = np.flatnonzero(steps > 20 * np.nanmedian(steps)) + 1
    return np.asarray(np.insert(points, jumps, np.nan, axis=0))


def _diverging() -> ListedColormap:
    from matplotlib import colormaps

    return ListedColormap(colormaps["RdBu_r"](np.linspace(0.02, 0.98, 41)))
