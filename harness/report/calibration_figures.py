"""The figures of a calibration's page. Image coordinates: u runs right, v down, both in pixels."""

import math
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from harness.calibration.sensor_calibration import SensorCalibration
from harness.calibration.uncertainty import angles_off_axis
from harness.camera.reflection import ray_directions
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.theme import FAINT, HALF, OUTSIDE, PIXEL, SUBPIXEL, WIDE, Picture

_ARROW = 0.03
"""Length of a typical residual as it is drawn, in parts of the image's width."""
_BINS = 12


@theme.panel
def residual_vectors(calibration: SensorCalibration) -> Picture:
    """Every residual as a line from its corner, enlarged."""
    fig, ax = _image_axes(calibration)
    typical = max(calibration.rms_px, 1e-12)
    zoom = _round_number(_ARROW * calibration.corners.width_px / typical)
    begin = calibration.corners.pixels
    segments: Any = np.stack([begin, begin + zoom * calibration.residuals], axis=1)
    ax.add_collection(LineCollection(segments, colors=SUBPIXEL, linewidths=0.6, zorder=3))
    theme.dots(ax, begin[:, 0], begin[:, 1], theme.INK, 1.6)
    if calibration.left_out is not None:
        ax.plot(*calibration.left_out.pixels.T, "x", color=PIXEL, markersize=4, markeredgewidth=1, zorder=4)
    alt = f"Residuals over the image, {zoom:g} times their size."
    return theme.picture(fig, alt, f"(a) residuals, {zoom:g} times as long as they are")


@theme.panel
def residual_scatter(calibration: SensorCalibration) -> Picture:
    """Residuals of both coordinates, with circles of one, two and three standard deviations."""
    fig = theme.figure(HALF, 400)
    ax = theme.axes(fig, 110, 14, 330, 330)
    sigma = max(calibration.uncertainty.sigma_px, 1e-12)
    most = max(3.2 * sigma, float(np.abs(calibration.residuals).max()) * 1.05)
    theme.dots(ax, calibration.residuals[:, 0], calibration.residuals[:, 1], SUBPIXEL, 1.8)
    around = np.linspace(0, 2 * np.pi, 181)
    for times in (1, 2, 3):
        ax.plot(times * sigma * np.cos(around), times * sigma * np.sin(around), color=FAINT, linewidth=0.8)
    ax.set_xlim(-most, most)
    ax.set_ylim(most, -most)
    ax.set_xlabel("along $u$ (px)")
    ax.set_ylabel("along $v$ (px)")
    alt = f"Residuals along v against residuals along u; the standard deviation is {sigma:.3g} px."
    return theme.picture(fig, alt, "(b) both coordinates, with 1, 2 and 3 standard deviations")


@theme.panel
def residuals_by_angle(calibration: SensorCalibration) -> Picture:
    """Residuals outwards and across, against the angle off the axis, with means and their standard errors."""
    fig, panels = theme.pair(2, height=280, left=62)
    fig.set_size_inches(WIDE / 96, 280 / 96)
    width = (WIDE - 62 - 12 - 40) / 2
    centre = np.array([calibration.sensor.camera.cx_px, calibration.sensor.camera.cy_px])
    outward = calibration.corners.pixels - centre
    outward = outward / np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-9)
    across = outward @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    angle = np.degrees(angles_off_axis(calibration.sensor, calibration.corners.pixels))
    edges = np.linspace(angle.min(), angle.max() + 1e-9, _BINS + 1)
    most = 3.5 * max(calibration.uncertainty.sigma_px, 1e-12)
    for i, (ax, direction, name) in enumerate(zip(panels, (outward, across), ("outwards", "across"), strict=True)):
        ax.set_position(((62 + i * (width + 40)) / WIDE, 46 / 280, width / WIDE, (280 - 76) / 280))
        ax.tick_params(labelleft=True)
        value = np.sum(calibration.residuals * direction, axis=-1)
        theme.dots(ax, angle, value, "#9CC3DC", 1.4)
        bins = np.clip(np.digitize(angle, edges) - 1, 0, _BINS - 1)
        count = np.bincount(bins, minlength=_BINS)
        known = count >= 3
        mean = np.bincount(bins, value, minlength=_BINS)[known] / count[known]
        scatter = np.sqrt(np.bincount(bins, value**2, minlength=_BINS)[known] / count[known])
        middle = 0.5 * (edges[1:] + edges[:-1])[known]
        ax.errorbar(middle, mean, 2 * scatter / np.sqrt(count[known]), color=PIXEL, linewidth=1.3, capsize=2, zorder=5)
        ax.axhline(0, color=theme.INK, linewidth=0.6)
        ax.set_ylim(-most, most)
        ax.set_xlabel("angle off the optical axis (°)")
        ax.set_title(f"residual {name} (px)")
    return theme.picture(
        fig, "Residuals outwards and across against the angle off the optical axis, with binned means."
    )


@theme.panel
def rms_of_images(calibration: SensorCalibration) -> Picture:
    """A bar for each image."""
    names, values = calibration.corners.images, calibration.rms_of_images_px
    shown = len(names) <= 40
    height = 60 + (14 * len(names) if shown else 240)
    fig = theme.figure(WIDE, height)
    ax = theme.axes(fig, 190, 8, WIDE - 230, height - 54)
    at = np.arange(len(names))
    ax.barh(at, values, height=0.7, color=SUBPIXEL)
    ax.axvline(calibration.rms_px, color=PIXEL, linewidth=1)
    ax.set_ylim(len(names) - 0.4, -0.6)
    if shown:
        ax.set_yticks(at, [theme.plain(_short(name)) for name in names])
    else:
        ax.set_ylabel("image")
    ax.set_xlabel("RMS distance of predicted and measured corners (px)")
    return theme.picture(fig, f"RMS of {len(names)} images, {values.min():.3g} to {values.max():.3g} px.")


@theme.panel
def coverage_map(calibration: SensorCalibration) -> Picture:
    """Corners in cells of the image."""
    fig, ax = _image_axes(calibration, bar=True)
    coverage = calibration.coverage
    rows, columns = coverage.counts.shape
    cell = coverage.cell_px
    extent = (-0.5, columns * cell - 0.5, rows * cell - 0.5, -0.5)
    colours = colormaps["Blues"].resampled(16).with_extremes(bad=theme.PAPER)
    counts = np.where(coverage.counts > 0, coverage.counts, np.nan)
    drawn = ax.imshow(counts, cmap=colours, vmin=0, extent=extent, aspect="auto", zorder=1)
    _bar(fig, drawn, "corners in a cell")
    theme.dots(ax, calibration.corners.pixels[:, 0], calibration.corners.pixels[:, 1], theme.INK, 1.2)
    _circle(ax, calibration)
    alt = f"Corners over the image; {coverage.share:.0%} of the field's cells have some."
    return theme.picture(fig, alt, "(a) corners, and how many there are in each cell")


@theme.panel
def ray_map(calibration: SensorCalibration) -> Picture:
    """Standard deviation of rays over the field."""
    return _map(calibration, calibration.ray_sigma_px, "standard deviation (px)", "(b) standard deviation of rays")


@theme.panel
def halves_map(calibration: SensorCalibration) -> Picture:
    """Distance of the pixels to which two halves of the images project rays, over the field."""
    assert calibration.halves is not None
    return _map(calibration, calibration.halves.difference_px, "difference (px)", "(a) first half against second half")


@theme.panel
def halves_ratio(calibration: SensorCalibration) -> Picture:
    """Distance of these pixels in standard deviations, over the field."""
    assert calibration.halves is not None
    # Each half has twice the variance, and there are two of them.
    expected = 2 * np.maximum(calibration.ray_sigma_px, 1e-12)
    ratio = calibration.halves.difference_px / expected
    return _map(
        calibration, ratio, "difference / expected", "(b) in parts of what the scatter of corners makes one expect"
    )


@theme.panel
def correlations(calibration: SensorCalibration) -> Picture:
    """Correlation matrix of the estimated parameters."""
    names = [key.rpartition(".")[2] for key in calibration.keys]
    size = min(HALF - 190, 60 + 32 * len(names))  # names to the left, bar and its labels to the right
    fig = theme.figure(HALF, size + 110)
    ax = theme.axes(fig, 100, 10, size, size)
    drawn = ax.imshow(calibration.uncertainty.correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(names)), names)
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    fig.colorbar(drawn, cax=theme.axes(fig, 100 + size + 12, 10, 12, size))
    return theme.picture(fig, "Correlation matrix of the calibrated numbers.")


def _map(calibration: SensorCalibration, values: Array, label: str, title: str) -> Picture:
    """Values over the field, from 0 to the 98th percentile."""
    fig, ax = _image_axes(calibration, bar=True)
    grid = calibration.grid
    known = values[np.isfinite(values)]
    high = float(np.percentile(known, 98)) if known.size else 1.0
    du, dv = (float(axis[1] - axis[0]) if len(axis) > 1 else 1.0 for axis in (grid.u, grid.v))
    extent = (grid.u[0] - du / 2, grid.u[-1] + du / 2, grid.v[-1] + dv / 2, grid.v[0] - dv / 2)
    drawn = ax.imshow(
        grid.spread(values),
        cmap=colormaps["viridis"].resampled(64),
        norm=Normalize(0, max(high, 1e-12)),
        extent=extent,
        aspect="auto",
    )
    _bar(fig, drawn, label)
    theme.dots(ax, calibration.corners.pixels[:, 0], calibration.corners.pixels[:, 1], theme.PAPER, 0.9)
    _circle(ax, calibration)
    median = float(np.median(known)) if known.size else math.nan
    return theme.picture(fig, f"{title[4:]}, median {median:.2g}.", title)


_LEFT, _TOP, _HEIGHT = 52, 8, 400


def _image_axes(calibration: SensorCalibration, *, bar: bool = False) -> tuple[Figure, Axes]:
    """Axes over the whole image, as large as half a page allows."""
    width, height = calibration.corners.width_px, calibration.corners.height_px
    room = HALF - _LEFT - (74 if bar else 12), _HEIGHT - _TOP - 46
    scale = min(room[0] / width, room[1] / height)
    fig = theme.figure(HALF, round(height * scale) + _TOP + 46)
    ax = theme.axes(fig, _LEFT, _TOP, width * scale, height * scale)
    ax.set_xlim(-0.5, width - 0.5)
    ax.set_ylim(height - 0.5, -0.5)
    ax.set_xlabel("$u$ (px)")
    ax.set_ylabel("$v$ (px)")
    ax.patch.set_facecolor(theme.PAPER if not bar else OUTSIDE)
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    return fig, ax


def _bar(fig: Figure, drawn: object, label: str) -> None:
    left, bottom, width, height = fig.axes[0].get_position().bounds
    cax = fig.add_axes((left + width + 10 / HALF, bottom, 10 / HALF, height))
    fig.colorbar(drawn, cax=cax, label=label)  # type: ignore[arg-type]


def _circle(ax: Axes, calibration: SensorCalibration) -> None:
    """The rim of the field."""
    camera = calibration.sensor.camera
    around = np.linspace(0, 2 * np.pi, 181)
    directions = np.stack([np.cos(around), np.sin(around)], axis=-1)
    reach = np.linspace(0, math.hypot(camera.width_px, camera.height_px), 800)
    pixels = np.array([camera.cx_px, camera.cy_px]) + reach[:, None, None] * directions
    valid = ray_directions(calibration.sensor, pixels)[1]
    last = valid.shape[0] - 1 - np.argmax(valid[::-1], axis=0)
    rim = pixels[last, np.arange(len(around))]
    ax.plot(rim[:, 0], rim[:, 1], color=PIXEL, linewidth=0.8, zorder=4)


def _round_number(value: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten below."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-12)))
    return power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


def _short(name: str) -> str:
    return name if len(name) <= 28 else f"{name[:12]}…{name[-14:]}"
