"""A page on a sequence of images: the results of each pair, and the positions of the views."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator

from harness.geometry.angles import Array
from harness.report import theme
from harness.report.markup import template
from harness.report.theme import HALF, Picture

_HEIGHT = 320


class _Pair(Protocol):
    """The figures of a pair that the page shows."""

    @property
    def density(self) -> float: ...
    @property
    def median_m(self) -> float | None: ...
    @property
    def median_sigma_m(self) -> float | None: ...


def build_page(pairs: Sequence[_Pair], positions_m: Array | None) -> str:
    """The page, one HTML file beside the folders of the pairs.

    Parameters
    ----------
    pairs
        The results of each pair.
    positions_m
        `[views, 3]`: the viewpoints in the first view's frame; None where they are not known.
    """
    with theme.style():
        pictures = [_density(pairs), *([] if positions_m is None else [_path(positions_m)])]
    return template("sequence.html.j2").render(pairs=pairs, pictures=pictures, connected=positions_m is not None)


@theme.panel
def _density(pairs: Sequence[_Pair]) -> Picture:
    fig = theme.figure(HALF, _HEIGHT)
    ax = theme.axes(fig, 54, 16, HALF - 72, _HEIGHT - 66)
    density = [100 * each.density for each in pairs]
    ax.bar(range(len(pairs)), density, color=theme.SUBPIXEL, width=0.7)
    ax.set_ylim(0, 100)
    ax.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    ax.set_xlabel("pair")
    ax.set_ylabel("panorama with a range (%)")
    low, high = min(density), max(density)
    alt = f"Share of the panorama with a range: {low:.0f} to {high:.0f} per cent over {len(pairs)} pairs."
    return theme.picture(fig, alt, "(a) density of each pair")


@theme.panel
def _path(positions_m: Array) -> Picture:
    fig = theme.figure(HALF, _HEIGHT)
    ax = theme.axes(fig, 54, 16, HALF - 72, _HEIGHT - 66)
    ax.plot(positions_m[:, 0], positions_m[:, 1], "o-", color=theme.PIXEL, markersize=4, linewidth=1.0)
    ax.annotate(
        "first view",
        (float(positions_m[0, 0]), float(positions_m[0, 1])),
        xytext=(6, 6),
        textcoords="offset points",
        fontsize=9.5,
    )
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.15)
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    length = float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())
    alt = f"The path of {len(positions_m)} viewpoints seen from above, {length:.2f} m long."
    return theme.picture(fig, alt, "(b) the viewpoints from above, in the first view's frame")
