"""The cost along one epipolar curve and the parabola through its minimum (the paper's figure 3)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from harness.geometry.angles import Array, wrap_angle
from harness.geometry.panorama import cylinder
from harness.geometry.triangulation import points
from harness.matching.window.match import costs_along_curve, whole_pixels
from harness.matching.window.settings import WholePixelMatches, WindowMatcher
from harness.matching.window.subpixel import refine
from harness.pipeline.trial import Outcome
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.method_styles import Method, common
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.theme import FAINT, HALF, INK, Picture

_UNITS = {"sad": "grey levels", "ssd": "grey levels²", "zncc": "1 − correlation", "census": "bits"}


_CURVE = """
{% if search %}
Cost along the epipolar curve of one pixel (row {{ search.row }}, column {{ search.column }}), the one whose errors by
all methods are nearest to their medians. (a) The search interval, from points {{ "%g" | format(matching.d_max_m) }} m
away to {{ "%g" | format(matching.d_min_m) }} m away, one sample every
{{ search.step_deg | abs | figure(".3g") }}° of <i>{{ angle }}</i><sub>2</sub>. (b) Around the minimum: the parabola is
fitted by least squares to the best sample and {{ (fitted - 1) // 2 }} neighbours on both sides. Its minimum is
{{ (search.minimum_deg - search.true_deg) | abs | figure(".3f") }}° from the true position, that of the best sample
{{ (search.best_deg - search.true_deg) | abs | figure(".3f") }}°.
{% if search.gap > 0 and search.least > 0 %}It misses the best sample by {{ search.gap | figure(".3g") }} {{ unit }}
({{ (100 * search.gap / search.least) | figure(".0f") }} % of its cost) because over these samples the cost is no
parabola: it falls steeply to its minimum and flattens out beside it, and least squares weigh all {{ fitted }} samples
alike. The position of the minimum is where its flanks balance; how deep it lies does not enter.{% endif %}

{% else %}
Cost along one epipolar curve.
{% endif %}
"""


@section_of(About.BASE_TRIAL, "matching", "Matching along one curve", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """The search of one pixel."""
    methods = context.methods
    pixel, searched = typical_pixel(methods), with_windows(methods)
    search = curve_at(searched, *pixel) if searched and pixel else None
    yield Figure(
        "figure-curve",
        cost_along_curve(searched, search) if searched and search else [],
        html(
            _CURVE,
            search=search,
            matching=context.trial.matching,
            angle="φ" if methods[0].outcome.curves.sampling == "phi" else "α",
            fitted=int(search.near.sum()) if search else 0,
            unit=_UNITS[_window_matcher(searched).cost] if searched else "",
        ),
        data=_numbers(search) if search else None,
        missing="Not drawn: no pixel of the domain has an estimate by every method and a cost for each sample around "
        "its minimum.",
        paper="fig. 3",
    )


def _numbers(search: "Curve") -> Data:
    return Data(
        "cost-curve",
        ["angle_deg", "cost", "in_fit", "true_deg", "best_deg", "minimum_deg"],
        [
            [angle, cost, int(near), search.true_deg, search.best_deg, search.minimum_deg]
            for angle, cost, near in zip(search.angle_deg, search.costs, search.near, strict=True)
        ],
    )


@dataclass(frozen=True)
class Curve:
    """One pixel's search, in terms of the angle along which its curve is sampled."""

    row: int
    column: int
    angle_deg: Array
    """`[samples]`: phi_2, or alpha_2 when the curve is sampled in it; degrees, not wrapped."""
    costs: Array
    near: NDArray[np.bool_]
    """`[samples]`: whether the parabola is fitted to the sample."""
    fit: NDArray[np.floating]
    """Coefficients of the parabola in sample numbers from the best one, highest power first."""
    best_deg: float
    minimum_deg: float
    """The minimum of the fitted parabola; the best sample if the fit has no minimum among its samples."""
    true_deg: float
    step_deg: float

    @property
    def least(self) -> float:
        """The cost of the best sample."""
        return float(np.min(self.costs[self.near]))

    @property
    def gap(self) -> float:
        """The parabola's value at the best sample less the cost of that sample."""
        return float(self.fit[-1]) - self.least

    def parabola(self, count: int = 61) -> tuple[Array, Array]:
        """The fitted parabola over the samples that it was fitted to: angles in degrees, costs."""
        k = (self.angle_deg[self.near] - self.best_deg) / self.step_deg
        x = np.linspace(k.min(), k.max(), count)
        return self.best_deg + x * self.step_deg, np.polyval(self.fit, x)


def with_windows(methods: list[Method]) -> Outcome | None:
    """The first outcome of a window matcher: the only ones whose search can be drawn."""
    return next((each.outcome for each in methods if isinstance(each.outcome.trial.matching, WindowMatcher)), None)


def typical_pixel(methods: list[Method]) -> tuple[int, int] | None:
    """The pixel whose absolute errors by all methods are nearest to their medians; the first of several.

    Looked for on walls of the domain, on all of it when no wall is matched. All samples around the minimum exist. None
    when there is no such pixel, or no window matcher.
    """
    outcome = with_windows(methods)
    if outcome is None:
        return None
    costs = _search(outcome).costs
    complete = common(methods) & np.isfinite(costs).all(axis=-1) & outcome.reference.domain
    complete &= refine(costs, "parabola")[1]
    for candidates in (complete & outcome.reference.wall, complete):
        if candidates.any():
            deviation = np.zeros(candidates.shape)
            for method in methods:
                error = np.abs(method.outcome.errors.disparity_px)
                deviation += np.abs(error - np.median(error[candidates]))
            row, column = np.unravel_index(np.argmin(np.where(candidates, deviation, np.inf)), candidates.shape)
            return int(row), int(column)
    return None


def curve_at(outcome: Outcome, row: int, column: int) -> Curve:
    """The costs along one pixel's curve, and the parabola through their minimum."""
    matcher, whole = _window_matcher(outcome), _search(outcome)
    curves = whole.curves
    inside, costs_inside = costs_along_curve(outcome.filtered[0], outcome.filtered[1], whole, matcher, row, column)
    step = float(curves.step[row, column])
    if curves.sampling == "phi":
        start = float(curves.grid.phi[column])
        point = points(cylinder(curves.grid)[row, column], outcome.reference.range_m[row, column]) - curves.t
        true = start + float(wrap_angle(np.arctan2(point[1], point[0]) - start))
    else:
        start, true = float(curves.alpha_1[row, column]), float(outcome.reference.alpha_2[row, column])
    around = whole.costs[row, column]
    x = np.arange(around.size) - around.size // 2
    best = int(whole.k[row, column])
    # The parabola's neighbours may lie beyond the ends of the search interval.
    ks = np.arange(min(inside[0], best + x[0]), max(inside[-1], best + x[-1]) + 1)
    costs = np.full(ks.size, np.nan)
    costs[inside - ks[0]] = costs_inside
    costs[best + x - ks[0]] = around
    offset = float(refine(around, "parabola")[0])
    return Curve(
        row=row,
        column=column,
        angle_deg=np.degrees(start + ks * step),
        costs=costs,
        near=np.abs(ks - best) <= around.size // 2,
        fit=np.polyfit(x, around, 2),
        best_deg=float(np.degrees(start + best * step)),
        minimum_deg=float(np.degrees(start + (best + offset) * step)),
        true_deg=float(np.degrees(true)),
        step_deg=float(np.degrees(step)),
    )


def cost_along_curve(outcome: Outcome, curve: Curve) -> list[Picture]:
    """The whole search interval, and the surroundings of its minimum."""
    matcher = _window_matcher(outcome)
    unit = _UNITS[matcher.cost]
    cost = f"{matcher.cost.upper()} over {matcher.window_px} × {matcher.window_px} px ({unit})"
    angle = r"$\varphi_2$ (°)" if outcome.curves.sampling == "phi" else r"$\alpha_2$ (°)"
    return [_whole_interval(curve, angle, cost), _around_minimum(curve, angle, cost)]


@theme.panel
def _whole_interval(curve: Curve, angle: str, cost: str) -> Picture:
    x, y = curve.parabola()
    fig = theme.figure(HALF, 350)
    ax = theme.axes(fig, 62, 66, HALF - 74, 236)
    ax.plot(curve.angle_deg, curve.costs, color=FAINT, linewidth=0.7, zorder=1)
    ax.plot(curve.angle_deg, curve.costs, "o", color=INK, markersize=2.6, label="samples")
    ax.plot(x, y, color=theme.SUBPIXEL, label="fitted parabola")
    ax.axvline(curve.true_deg, color=theme.TRUTH, linewidth=0.8, linestyle=(0, (4, 3)), label="true position", zorder=0)
    _finish(ax, angle, cost)
    ax.set_ylim(0, None)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=3, columnspacing=1.2, borderaxespad=0.2)
    return theme.picture(
        fig,
        f"Matching cost of one pixel over its whole search interval of {curve.costs.size} samples, lowest at "
        f"{curve.best_deg:.2f} degrees; the true position is {curve.true_deg:.2f} degrees.",
        "(a) the whole search interval",
    )


@theme.panel
def _around_minimum(curve: Curve, angle: str, cost: str) -> Picture:
    near_name = f"{int(curve.near.sum())} samples of the fit"
    x, y = curve.parabola()
    fig = theme.figure(HALF, 350)
    ax = theme.axes(fig, 62, 66, HALF - 74, 236)
    ax.plot(x, y, color=theme.SUBPIXEL, label="least-squares parabola", zorder=2)
    ax.plot(curve.angle_deg[~curve.near], curve.costs[~curve.near], "o", color=FAINT, markersize=4)
    ax.plot(
        curve.angle_deg[curve.near],
        curve.costs[curve.near],
        "o",
        color=theme.PAPER,
        markeredgecolor=INK,
        markeredgewidth=1.2,
        markersize=6,
        label=near_name,
        zorder=3,
    )
    ax.plot(curve.best_deg, curve.least, "o", color=theme.PIXEL, markersize=6.5, zorder=4)
    for where, colour, dashes, name in (
        (curve.best_deg, theme.PIXEL, (0, (1, 1.5)), "whole-pixel minimum"),
        (curve.minimum_deg, theme.SUBPIXEL, "solid", "sub-pixel minimum"),
        (curve.true_deg, theme.TRUTH, (0, (4, 3)), "true position"),
    ):
        ax.axvline(where, color=colour, linewidth=1.0, linestyle=dashes, label=name, zorder=1)
    reach = 1.35 * max(np.abs(curve.angle_deg[curve.near] - curve.best_deg).max(), abs(curve.true_deg - curve.best_deg))
    shown = np.abs(curve.angle_deg - curve.best_deg) <= reach
    ax.set_xlim(curve.best_deg - reach, curve.best_deg + reach)
    top = float(np.nanmax(curve.costs[shown]))
    ax.set_ylim(0, 1.1 * top)
    _finish(ax, angle, cost)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=2, columnspacing=1.2, borderaxespad=0.2)
    return theme.picture(
        fig,
        f"The same cost around its minimum with a parabola fitted to {int(curve.near.sum())} samples. Whole-pixel "
        f"minimum at {curve.best_deg:.3f} degrees, sub-pixel minimum at {curve.minimum_deg:.3f}, true position at "
        f"{curve.true_deg:.3f}.",
        "(b) around the minimum",
    )


def _finish(ax: Axes, angle: str, cost: str) -> None:
    ax.set_xlabel(angle)
    ax.set_ylabel(cost)
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))


def _window_matcher(outcome: Outcome) -> WindowMatcher:
    matcher = outcome.trial.matching
    if not isinstance(matcher, WindowMatcher):
        raise TypeError(f"the search of {matcher!r} cannot be drawn")
    return matcher


def _search(outcome: Outcome) -> WholePixelMatches:
    return whole_pixels(outcome.pair, _window_matcher(outcome))
