"""A page on a sensor's field of view: its image with circle, blind spot and elevations, and its resolution."""

import io
import math
import re
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from harness.camera.coverage import HARDLY, Coverage, Ring, has_circle
from harness.camera.sensor import pixel_directions
from harness.report import theme
from harness.report.markup import template
from harness.report.theme import FAINT, HALF, INK, SPARE, Picture
from harness.report.typography import typeset
from harness.spec import dump_toml

_USED, _UNUSED = "#DCEAF4", "#E2E2E2"
_RIM, _BLIND, _AXIS = theme.SUBPIXEL, theme.PIXEL, SPARE[0]
_ELEVATION_STEPS = (5, 10, 15, 30)
_HEIGHT = 430


def build_page(
    coverage: Coverage, title: str, facts: dict[str, str], warnings: Sequence[str], notes: Sequence[str]
) -> str:
    """The page, one self-contained HTML file.

    Parameters
    ----------
    title
        Camera model and size, in one line.
    facts
        The description: values by name.
    warnings
        Warnings, a sentence each.
    notes
        Notes on how its file was read.
    """
    with theme.style():
        pictures = [image_panel(coverage), resolution_panel(coverage)]
    return template("sensor.html.j2").render(
        coverage=coverage,
        title=title,
        facts={name: _typeset(text) for name, text in facts.items()},
        warnings=[_typeset(text) for text in warnings],
        notes=[_typeset(f"{text[:1].upper()}{text[1:]}.") for text in notes],
        pictures=pictures,
        sensor=dump_toml(coverage.sensor),
        vertical=bool(np.isfinite(coverage.resolution.elevation_rad).all()),
    )


def _typeset(text: str) -> str:
    """Words of the terminal as a page has them."""
    return re.sub(r" deg\b", "°", typeset(text)).replace("px/deg", "px/°")


def build_picture(coverage: Coverage, kind: str) -> bytes:
    """The page's picture alone, as `svg` or `png`."""
    with theme.style():
        fig = theme.figure(2 * HALF, _HEIGHT)
        _draw_image(coverage, fig, 0)
        _draw_resolution(coverage, fig, HALF)
        stream = io.BytesIO()
        metadata = {"Date": None} if kind == "svg" else None
        fig.savefig(stream, format=kind, dpi=192, metadata=metadata)
    return stream.getvalue()


@theme.panel
def image_panel(coverage: Coverage) -> Picture:
    """The image with its used part, and lines of equal elevation."""
    fig = theme.figure(HALF, _HEIGHT)
    _draw_image(coverage, fig, 0)
    camera = coverage.sensor.camera
    low, high = coverage.elevation_deg
    alt = (
        f"The image of {camera.width_px} by {camera.height_px} pixels, of which {coverage.used:.0%} are used, with "
        f"lines of equal elevation from {low:.0f} to {high:.0f} degrees."
    )
    return theme.picture(fig, alt, "(a) the image")


@theme.panel
def resolution_panel(coverage: Coverage) -> Picture:
    """Pixels per degree against the elevation."""
    fig = theme.figure(HALF, _HEIGHT)
    _draw_resolution(coverage, fig, 0)
    resolution = coverage.resolution
    alt = (
        f"Pixels per degree: radially {np.nanmin(resolution.radial):.2f} to {np.nanmax(resolution.radial):.2f}, "
        f"tangentially {np.nanmin(resolution.tangential):.2f} to {np.nanmax(resolution.tangential):.2f}."
    )
    return theme.picture(fig, alt, "(b) the resolution")


def _draw_image(coverage: Coverage, fig: Figure, left: float) -> None:
    camera = coverage.sensor.camera
    width, height = camera.width_px, camera.height_px
    low, high = _window(coverage)
    scale = min((HALF - 66) / (high[0] - low[0]), (_HEIGHT - 90) / (high[1] - low[1]))
    w, h = scale * (high - low)
    ax = theme.axes(fig, left + 54 + (HALF - 66 - w) / 2, 40 + (_HEIGHT - 90 - h) / 2, w, h)
    fewer = max(1, math.ceil(max(width, height) / 512))
    ax.imshow(
        coverage.valid[::fewer, ::fewer],
        cmap=ListedColormap([_UNUSED, _USED]),
        vmin=0,
        vmax=1,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        aspect="auto",
    )
    ax.add_patch(Rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=INK, linewidth=1.0))
    _draw_elevations(coverage, ax)
    shows_rim = has_circle(coverage.sensor) and coverage.rim.on_image > HARDLY
    handles = [_draw_ring(ax, coverage.rim, _RIM, "edge of the field")] if shows_rim else []
    if coverage.blind is not None:
        handles.append(_draw_ring(ax, coverage.blind, _BLIND, "blind spot"))
    if has_circle(coverage.sensor) and np.isfinite(coverage.axis_px).all():
        handles += ax.plot(*coverage.axis_px, "o", color=_AXIS, markersize=5, label="optical axis", linestyle="none")
    handles += ax.plot(
        (width - 1) / 2, (height - 1) / 2, "+", color=INK, markersize=9, label="middle of the image", linestyle="none"
    )
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(high[1], low[1])
    ax.set_xlabel("$u$ (px)")
    ax.set_ylabel("$v$ (px)")
    for side in ax.spines.values():
        side.set_visible(False)
    fig.legend(
        handles=handles, loc="upper center", ncol=2, columnspacing=1.4,
        bbox_to_anchor=((left + HALF / 2) / (fig.get_figwidth() * 96), 1.0), borderaxespad=0.1,
    )  # fmt: skip


def _window(coverage: Coverage) -> tuple[np.ndarray, np.ndarray]:
    """The window to draw, its lower and upper corner: the image, and the field's edge unless it is far outside."""
    size = np.array([coverage.sensor.camera.width_px, coverage.sensor.camera.height_px], dtype=np.float64)
    low, high = np.full(2, -0.5), size - 0.5
    ring = coverage.rim.pixels[np.isfinite(coverage.rim.pixels).all(axis=-1)]
    if coverage.rim.on_image > HARDLY and len(ring):
        low = np.maximum(np.minimum(low, ring.min(axis=0)), -0.35 * size)
        high = np.minimum(np.maximum(high, ring.max(axis=0)), 1.35 * size)
    room = 0.02 * (high - low)
    return low - room, high + room


def _draw_elevations(coverage: Coverage, ax: Axes) -> None:
    camera = coverage.sensor.camera
    fewer = max(1, math.ceil(max(camera.width_px, camera.height_px) / 320))
    directions = pixel_directions(coverage.sensor)[0][::fewer, ::fewer]
    valid = coverage.valid[::fewer, ::fewer]
    elevation = np.where(valid, np.degrees(np.arcsin(np.clip(directions[..., 2], -1, 1))), np.nan)
    low, high = coverage.elevation_deg
    step = next((each for each in _ELEVATION_STEPS if (high - low) / each <= 8), _ELEVATION_STEPS[-1])
    levels = np.arange(math.ceil(low / step) * step, high, step)
    u, v = np.arange(0, camera.width_px, fewer), np.arange(0, camera.height_px, fewer)
    if not len(levels):
        return
    drawn = ax.contour(
        u, v, elevation, levels=levels, colors=INK, linewidths=[1.1 if level == 0 else 0.5 for level in levels],
        linestyles="solid",
    )  # fmt: skip
    ax.clabel(drawn, fmt=lambda level: f"{level:.0f}°".replace("-", "−"), fontsize=8.5, inline_spacing=2)


def _draw_ring(ax: Axes, ring: Ring, colour: str, label: str) -> Line2D:
    closed = np.concatenate([ring.pixels, ring.pixels[:1]])
    return ax.plot(closed[:, 0], closed[:, 1], color=colour, linewidth=1.6, label=label)[0]


def _draw_resolution(coverage: Coverage, fig: Figure, left: float) -> None:
    resolution = coverage.resolution
    vertical = bool(np.isfinite(resolution.elevation_rad).all())
    x = np.degrees(resolution.elevation_rad if vertical else resolution.angle_rad)
    ax = theme.axes(fig, left + 54, 40, HALF - 72, _HEIGHT - 90)
    ax.grid(color="#E8E8E8", linewidth=0.5)
    for middle, ends, colour, label in (
        (resolution.radial, resolution.radial_range, theme.SUBPIXEL, "radial"),
        (resolution.tangential, resolution.tangential_range, theme.PIXEL, "tangential"),
    ):
        ax.fill_between(x, ends[:, 0], ends[:, 1], color=colour, alpha=0.18, linewidth=0)
        ax.plot(x, middle, color=colour, label=label)
    most = np.nanpercentile(np.concatenate([resolution.radial_range[:, 1], resolution.tangential_range[:, 1]]), 99)
    ax.set_ylim(0, 1.15 * most)
    ax.set_xlabel("elevation (°)" if vertical else "angle off the optical axis (°)")
    ax.set_ylabel("pixels per degree")
    ax.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 1.5, 3, 6, 10]))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    if vertical and x.min() < 0 < x.max():
        ax.axvline(0, color=FAINT, linewidth=0.7, linestyle=(0, (4, 3)), zorder=0)
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3)
