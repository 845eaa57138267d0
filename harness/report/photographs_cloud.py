"""The points of two photographs from above and in space, with both viewpoints."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.pipeline.photographs import Estimate
from harness.report import theme
from harness.report.theme import HALF, Picture

_CELLS = 320
"""Cells of the floor plan, either way."""
_DOTS = 15000
"""Points in the view in space, at most."""


def cloud_pictures(estimate: Estimate) -> list[Picture]:
    """The floor plan and the view in space; none without points."""
    return [_plan(estimate), _in_space(estimate)] if estimate.valid.any() else []


@theme.panel
def _plan(estimate: Estimate) -> Picture:
    points, t = estimate.points_m, estimate.pair.motion.t_v1
    centre, half = _frame(points, t)
    fig = theme.figure(HALF, 430)
    ax = theme.axes(fig, 52, 26, 360, 360)
    bar = theme.axes(fig, 424, 26, 12, 360)
    low, high = np.percentile(points[:, 2], [2, 98])
    drawn = ax.imshow(
        _mean_heights(points, centre, half), extent=_extent(centre, half), origin="lower", cmap="viridis",
        vmin=low, vmax=max(high, low + 1e-3),
    )  # fmt: skip
    fig.colorbar(drawn, cax=bar, label="height above view 1 (m)")
    d_min, d_max = estimate.matcher.d_min_m, estimate.matcher.d_max_m
    around = np.linspace(0, 2 * np.pi, 181)
    for radius in (d_min, d_max):
        ax.plot(radius * np.cos(around), radius * np.sin(around), "--", color=theme.PIXEL, linewidth=0.9)
    _viewpoints(ax, t[:2])
    ax.set_xlim(centre[0] - half, centre[0] + half)
    ax.set_ylim(centre[1] - half, centre[1] + half)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    alt = (
        f"Points from above, {2 * half:.2g} m wide, coloured by height; view 1 at the origin, view 2 at "
        f"({t[0]:.2g}, {t[1]:.2g}) m; dashed circles at {d_min:g} and {d_max:g} m."
    )
    return theme.picture(fig, alt, "(a) from above")


@theme.panel
def _in_space(estimate: Estimate) -> Picture:
    points, t = estimate.points_m, estimate.pair.motion.t_v1
    centre, half = _frame(points, t)
    inside = np.flatnonzero(np.all(np.abs(points[:, :2] - centre) < half, axis=1))
    chosen = np.random.default_rng(0).permutation(inside)[:_DOTS]
    fig = theme.figure(HALF, 430)
    ax: Any = theme.axes(fig, 0, 0, HALF, 430, projection="3d")
    ax.scatter(
        *points[chosen].T, c=estimate.colours[chosen] / 255, s=3, linewidths=0, depthshade=False, rasterized=True
    )
    for position, colour, name in ((np.zeros(3), theme.PIXEL, "1"), (t, theme.SUBPIXEL, "2")):
        ax.plot(*position[:, None], marker="o", color=colour, markersize=5, markeredgecolor="white")
        ax.text(*position, f"  {name}", color=colour, fontweight="bold")
    low, high = np.percentile(points[chosen, 2], [1, 99])
    ax.set_xlim(centre[0] - half, centre[0] + half)
    ax.set_ylim(centre[1] - half, centre[1] + half)
    ax.set_zlim(low, max(high, low + 0.1))
    ax.set_box_aspect((1, 1, min(1.0, max(0.15, (high - low) / (2 * half)))), zoom=1.15)
    ax.zaxis.set_major_locator(MaxNLocator(3))
    ax.view_init(elev=38, azim=-60)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    ax.set_zlabel("$z$ (m)")
    alt = f"{len(chosen)} of {len(points)} points in space in the photograph's colours, with both viewpoints."
    return theme.picture(fig, alt, "(b) in space, in the photograph’s colours")


def _frame(points: Array, t: Array) -> tuple[Array, float]:
    """Middle `[2]` and half the width of a square that holds nearly all points from above, and both viewpoints."""
    low, high = np.percentile(points[:, :2], [3, 97], axis=0)
    low, high = np.minimum(low, np.minimum(0, t[:2])), np.maximum(high, np.maximum(0, t[:2]))
    return np.asarray((low + high) / 2), float(max(high - low) / 2 * 1.08 + 1e-3)


def _extent(centre: Array, half: float) -> tuple[float, float, float, float]:
    x, y = centre.tolist()
    return x - half, x + half, y - half, y + half


def _mean_heights(points: Array, centre: Array, half: float) -> NDArray[np.floating]:
    """Mean height in each cell of the plan, NaN where there is no point."""
    cell = np.floor((points[:, :2] - centre + half) * (_CELLS / (2 * half))).astype(np.intp)
    inside = np.all((cell >= 0) & (cell < _CELLS), axis=1)
    flat = cell[inside, 1] * _CELLS + cell[inside, 0]
    count = np.bincount(flat, minlength=_CELLS**2)
    total = np.bincount(flat, points[inside, 2], minlength=_CELLS**2)
    with np.errstate(invalid="ignore"):
        return np.asarray((total / count).reshape(_CELLS, _CELLS))


def _viewpoints(ax: Axes, second: Array) -> None:
    for (x, y), colour, name in (((0.0, 0.0), theme.PIXEL, "1"), (second.tolist(), theme.SUBPIXEL, "2")):
        ax.plot([x], [y], "o", color=colour, markersize=5, markeredgecolor="white", markeredgewidth=0.8)
        ax.annotate(name, (x, y), (5, 4), textcoords="offset points", color=colour, fontweight="bold")
