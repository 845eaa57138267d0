"""Axes for panoramas, unmirrored: as seen from inside the cylinder, the azimuth descends from left to right."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.report import theme
from harness.report.theme import WIDE

_LEFT, _PLOT = 54, 841
"""Left edge and width of panoramas, CSS pixels: all of them line up."""


def panorama_axes(grid: Grid, *, top: int = 6, bar: bool = True, label: bool = True) -> tuple[Figure, Axes, Axes]:
    """A figure for a panorama: axes with azimuth and z, elevation on the right, and axes for a colour bar."""
    height = float(np.clip(_PLOT * (grid.z_max - grid.z_min) / (2 * math.pi), 120, 420))
    fig = theme.figure(WIDE, round(height + top + (44 if label else 26)))
    ax = theme.axes(fig, _LEFT, top, _PLOT, height)
    theme.degrees(ax)
    if not label:
        ax.set_xlabel("")
    ax.set_ylim(grid.z_min, grid.z_max)
    ax.set_ylabel("$z$", labelpad=1)
    right = ax.secondary_yaxis("right", functions=(_elevation, _z_of_elevation))  # type: ignore[arg-type]
    right.set_ylabel("elevation (°)", labelpad=4)
    lowest, highest = _elevation(np.array([grid.z_min, grid.z_max]))
    step = 10 if highest - lowest < 90 else 20
    ticks = np.arange(math.ceil(lowest / step) * step, highest + 1e-9, step)
    right.set_yticks(ticks, [f"{tick:.0f}".replace("-", "−") for tick in ticks])
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    colours = theme.axes(fig, _LEFT + _PLOT + 62, top, 12, height)
    if not bar:
        colours.set_axis_off()
    return fig, ax, colours


def unmirrored(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Columns turned round: a cylinder seen from inside has its azimuth running from right to left."""
    return values[:, ::-1]


def extent_of(grid: Grid) -> tuple[float, float, float, float]:
    """The extent (left, right, bottom, top) of an unmirrored panorama on axes of degrees and z."""
    return 180.0, -180.0, grid.z_min, grid.z_max


def _elevation(z: Array) -> Array:
    return np.degrees(np.arctan(z))


def _z_of_elevation(angle: Array) -> Array:
    return np.tan(np.radians(np.clip(angle, -89, 89)))
