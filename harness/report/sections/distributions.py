"""The distributions of errors."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, PercentFormatter
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.method_styles import Method, common
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.theme import HALF, Picture

_POINTS = 300
"""Points of a cumulative curve: more cannot be seen at its size."""
SIGNED_EDGES_PX = np.linspace(-1.5, 1.5, 121)


_DISTRIBUTIONS = """
Distributions of the errors on the pixels of the <a href="#comparison">comparison of methods</a>. Share of pixels whose
absolute error is at most the abscissa, (a) of the disparity in pixels of {{ "%.4g" | format(column_deg) }}° and (b) of
the range in millimetres; solid: walls, dashed: floor and ceiling. Histograms of the signed disparity error (c) on walls
and (d) on floor and ceiling, on the same axes; errors beyond them are not drawn.
"""


@section_of(About.BASE_TRIAL, "distributions", "Error distributions", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """Cumulative distributions, and histograms of signed errors."""
    methods = context.methods
    yield Figure(
        "figure-distributions",
        [
            *cumulative(methods),
            signed(methods, "(c) signed disparity, walls", wall=True),
            signed(methods, "(d) signed disparity, floor and ceiling", wall=False),
        ],
        html(_DISTRIBUTIONS, column_deg=context.column_deg),
        data=Data(
            "error-distributions",
            ["kind", "error", "method", "surface", "value", "share"],
            [*curves(methods), *histograms(methods)],
        ),
    )


def cumulative(methods: list[Method]) -> list[Picture]:
    """Cumulative distributions of the absolute disparity and range errors, walls and other surfaces apart."""
    return [
        _cumulative(methods, "disparity_px", 1.0, "px", "(a) disparity", "absolute disparity error (px)"),
        _cumulative(methods, "range_m", 1000.0, "mm", "(b) range", "absolute range error (mm)"),
    ]


@theme.panel
def signed(methods: list[Method], title: str, *, wall: bool) -> Picture:
    """Histogram of the signed disparity error on walls, or on all other surfaces."""
    fig = theme.figure(HALF, 320)
    ax = theme.axes(fig, 58, 12, HALF - 70, 258)
    reference = methods[0].outcome.reference
    compared_here = common(methods) & reference.domain & (reference.wall == wall)
    surface = "wall" if wall else "floor or ceiling"
    means = []
    edges = SIGNED_EDGES_PX
    for method in methods:
        error = method.outcome.errors.disparity_px[compared_here]
        if error.size:
            share, _ = np.histogram(error, edges)
            ax.stairs(
                100 * share / error.size, edges, color=method.colour, linewidth=1.3, label=theme.plain(method.label)
            )
            inside = 100 * float(np.mean(np.abs(error) <= edges[-1]))
            means.append(f"{method.label} mean {np.mean(error):+.3f} px, {inside:.0f} % within the axes")
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0, None)
    ax.set_xlabel(r"signed disparity error, $\alpha_2$ estimate minus truth (px)")
    ax.set_ylabel(f"share of pixels (% per {edges[1] - edges[0]:g} px)")
    ax.axvline(0, color=theme.TRUTH, linewidth=0.6)
    if means:
        ax.legend(loc="upper left")
    else:
        theme.note(ax, f"no {surface} pixel has an estimate")
    alt = f"Histogram of the signed disparity error of {surface} pixels: {'; '.join(means) or 'no estimate'}."
    return theme.picture(fig, alt, title)


def curves(methods: list[Method]) -> Iterator[list[Any]]:
    """The numbers of the cumulative distributions, a hundred points a curve."""
    reference = methods[0].outcome.reference
    compared = common(methods) & reference.domain
    share = np.linspace(0, 1, 101)
    for name, unit in (("disparity_px", "disparity_px"), ("range_m", "range_m")):
        for where, surface in ((reference.wall, "wall"), (~reference.wall, "floor")):
            for method in methods:
                error = np.abs(getattr(method.outcome.errors, name)[compared & where])
                if error.size:
                    values = np.quantile(error, share, method="inverted_cdf")
                    yield from (
                        ["at_most", unit, method.key, surface, *each] for each in zip(values, share, strict=True)
                    )


def histograms(methods: list[Method]) -> Iterator[list[Any]]:
    """The numbers of the histograms of signed errors; the value is the middle of a bin."""
    reference = methods[0].outcome.reference
    for wall, surface in ((True, "wall"), (False, "floor")):
        compared_here = common(methods) & reference.domain & (reference.wall == wall)
        for method in methods:
            error = method.outcome.errors.disparity_px[compared_here]
            if error.size:
                share = np.histogram(error, SIGNED_EDGES_PX)[0] / error.size
                middle = (SIGNED_EDGES_PX[:-1] + SIGNED_EDGES_PX[1:]) / 2
                yield from (
                    ["signed", "disparity_px", method.key, surface, *each] for each in zip(middle, share, strict=True)
                )


@theme.panel
def _cumulative(methods: list[Method], name: str, scale: float, unit: str, title: str, label: str) -> Picture:
    # More curves than two methods have leave no room for a legend among them; the dashes are in the caption.
    many = len(methods) > 2
    fig = theme.figure(HALF, 320)
    ax = theme.axes(fig, 58, 50 if many else 12, HALF - 70, 220 if many else 258)
    reference = methods[0].outcome.reference
    compared = common(methods) & reference.domain
    lowest, medians = np.inf, []
    for where, surface, dashes in (
        (reference.wall, "walls", "solid"),
        (~reference.wall, "floor, ceiling", (0, (3, 1.6))),
    ):
        for method in methods:
            error = np.sort(scale * np.abs(getattr(method.outcome.errors, name)[compared & where]))
            if not error.size:
                continue
            said = method.label if many else f"{method.label}, {surface}"
            _draw(ax, error, colour=method.colour, linestyle=dashes, label=theme.plain(said))
            lowest = min(lowest, float(np.percentile(error, 2)))
            medians.append(f"{method.label} on {surface} {np.median(error):.3g} {unit}")
    ax.set_xscale("log")
    ax.set_ylim(0, 1)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.grid(color="#E4E4E4", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.set_xlabel(label)
    ax.set_ylabel("share of pixels at or below")
    if medians:
        ax.set_xlim(max(lowest, 1e-12), None)
        handles, labels = ax.get_legend_handles_labels()
        if many:
            first = list(dict(zip(reversed(labels), reversed(handles), strict=True)).items())[::-1]
            theme.legend_above(ax, [handle for _, handle in first], [label for label, _ in first], gap=0.3, most=3)
        else:
            ax.legend(loc="lower right")
    else:
        theme.note(ax, "no pixel has an estimate")
    alt = f"Cumulative distribution of the {label}; medians: {', '.join(medians) or 'no estimate'}."
    return theme.picture(fig, alt, title)


def _draw(ax: Axes, error: Array | NDArray[np.floating], *, colour: str, linestyle: object, label: str) -> None:
    share = np.linspace(0, 1, min(_POINTS, error.size))
    values = error[np.minimum((share * error.size).astype(int), error.size - 1)]
    ax.plot(np.maximum(values, 1e-12), share, color=colour, linestyle=linestyle, label=label)
