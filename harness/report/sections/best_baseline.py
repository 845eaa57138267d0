"""The trade-off over the baseline, and the baseline that is best for a range."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from harness.evaluation.law_images import baseline_curve
from harness.evaluation.regions import middle_of_range
from harness.evaluation.statistics import between
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Data, Heading, Table, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, TableBlock, section_of
from harness.report.sections.error_curves import SURFACES
from harness.report.sections.law.part import is_of
from harness.report.sweep import MethodStyle, Sweep
from harness.report.theme import Picture

_RANGES = ("#440154", "#414487", "#2A788E", "#22A884", "#7AD151", "#C9B800")
"""Colours of ranges, from near to far."""


@dataclass(frozen=True)
class _Curve:
    """Spread against the baseline for one range, `[baselines]`, metres."""

    range_bin: int
    baselines: Array
    error: Array
    low: Array
    high: Array
    """The 95 % interval; NaN where there is one seed only."""

    @property
    def range_m(self) -> float:
        """The middle of its band of ranges."""
        return middle_of_range(self.range_bin)


_Curves = dict[tuple[MethodStyle, str], list[_Curve]]
"""The curves of each method and surface, by range."""


_TRADE_OFF = """
The paper’s trade-off: spread of the range against the baseline, one curve for each range. Dots: the best baseline;
thick: within 10 % of it. Means of logarithms over the directions, conditions and seeds that all baselines share at that
range; bands are 95 % intervals. With a constant σ(<i>α</i><sub>2</sub>) the law keeps falling to the right, and so
would always recommend the longest baseline.
"""
_BASELINES = """
The best baseline for each range, its 95 % interval, the baselines whose error is within 10 % of the smallest, the
baseline that d²/|<b>t</b>| recommends (the longest tried), and the error there relative to the smallest. Where the best
baseline is the shortest or the longest tried, the optimum may lie outside.
"""


@section_of(About.ALL_TRIALS, "best-baseline", "The best baseline for each range")
def section(context: Context) -> Iterator[Block]:
    """Spread against the baseline, a curve for each range, and where each is lowest."""
    sweep, best = context.sweep, context.summary.get("best_baseline")
    if not best:
        return
    curves = {
        (method, surface): list(_curves(sweep.cells_of(method, surface)))
        for surface in sweep.surfaces
        for method in sweep.methods
    }
    rows = [
        [method.matcher, method.subpixel, surface, curve.range_m, *each]
        for (method, surface), of_method in curves.items()
        for curve in of_method
        for each in zip(curve.baselines, curve.error, curve.low, curve.high, strict=True)
    ]
    headings = ["matcher", "subpixel", "surface", "range_m", "baseline_m", "spread_m", "ci95_low", "ci95_high"]
    yield Figure(
        "figure-best-baseline",
        _trade_off(sweep, curves),
        html(_TRADE_OFF),
        data=Data("best-baseline", headings, rows),
        missing="Not drawn: no range has estimates with three baselines.",
    )
    table = _baseline_table(sweep, best, curves)
    if table.rows:
        yield TableBlock("table-best-baseline", table, html(_BASELINES))


def _trade_off(sweep: Sweep, curves: _Curves) -> list[Picture]:
    """Error against the baseline, a curve for each range: a picture for each surface and matcher."""
    bins = sorted({curve.range_bin for of_method in curves.values() for curve in of_method})
    colours = {range_bin: _RANGES[index % len(_RANGES)] for index, range_bin in enumerate(bins)}
    matchers = list(dict.fromkeys(method.matcher for method in sweep.methods))
    pictures = []
    for matcher in matchers:
        for surface in sweep.surfaces:
            methods = [method for method in sweep.methods if method.matcher == matcher][:3]
            of_matcher = {method: curves[method, surface] for method in methods}
            if any(of_matcher.values()):
                name = f"{matcher}, {SURFACES[surface]}" if len(matchers) > 1 else SURFACES[surface]
                pictures.append(_trade_off_picture(name, of_matcher, colours))
    return pictures


def _curves(cells: pd.DataFrame) -> Iterator[_Curve]:
    for range_bin, part in cells.groupby("range_bin", sort=True):
        curve = baseline_curve(part)
        if curve is not None:
            baselines, errors, draws = curve
            low, high = between(draws, part["seed"].nunique())
            yield _Curve(int(range_bin), baselines, np.exp(errors), np.exp(low), np.exp(high))


@theme.panel
def _trade_off_picture(name: str, curves: dict[MethodStyle, list[_Curve]], colours: dict[int, str]) -> Picture:
    fig, panels = theme.pair(len(curves), height=330, top=46)
    every = [curve for of_method in curves.values() for curve in of_method]
    spread = 1000 * np.concatenate([curve.error for curve in every])
    lengths = np.concatenate([curve.baselines for curve in every])
    described = []
    handles: dict[int, Line2D] = {}
    for ax, (method, of_method) in zip(panels, curves.items(), strict=True):
        ax.set_title(theme.plain(method.step_label), pad=20)
        for curve in of_method:
            x, y, colour = curve.baselines, 1000 * curve.error, colours[curve.range_bin]
            if np.isfinite(curve.low).all():
                ax.fill_between(x, 1000 * curve.low, 1000 * curve.high, color=colour, alpha=0.15, linewidth=0)
            (handles[curve.range_bin],) = ax.plot(x, y, color=colour, linewidth=1.2)
            flat = y <= 1.1 * y.min()
            ax.plot(np.where(flat, x, np.nan), np.where(flat, y, np.nan), color=colour, linewidth=4, alpha=0.45)
            best = int(np.argmin(y))
            ax.plot(x[best], y[best], "o", color=colour, markersize=6, markeredgecolor=theme.PAPER)
            described.append(f"{method.step_label} at {curve.range_m:.1f} m best with {x[best]:g} m")
        theme.logarithmic(ax, "x", float(lengths.min()) / 1.12, float(lengths.max()) * 1.12, most=4)
        theme.logarithmic(ax, "y", float(spread.min()) / 1.3, float(spread.max()) * 1.3)
        ax.set_xlabel("baseline |t| (m)")
    panels[0].set_ylabel("spread of the range (mm)")
    shown = sorted(handles)
    panels[0].legend(
        [handles[range_bin] for range_bin in shown],
        [f"{middle_of_range(range_bin):.1f} m" for range_bin in shown],
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.995),
        ncol=len(shown),
        columnspacing=0.9,
        handlelength=1.0,
        handletextpad=0.35,
        borderaxespad=0.2,
    )
    return theme.picture(
        fig, f"Spread of the range against the baseline for several ranges, {name}: {'; '.join(described)}.", name
    )


def _baseline_table(sweep: Sweep, best: list[dict[str, Any]], curves: _Curves) -> Table:
    headings = [
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("Range", "m"),
        Heading("Best baseline", "m"),
        Heading("95 % low", "m"),
        Heading("95 % high", "m"),
        Heading("Within 10 %, from", "m"),
        Heading("to", "m"),
        Heading("d²/|t| recommends", "m"),
        Heading("Error there / smallest", ""),
    ]
    rows = []
    for surface in sweep.surfaces:
        for method in sweep.methods:
            costs = {curve.range_m: float(curve.error[-1] / curve.error.min()) for curve in curves[method, surface]}
            for each in best:
                if not is_of(each, method, surface):
                    continue
                low, high = each["baseline_m_ci95"] or (None, None)
                rows.append(
                    [
                        words(SURFACES[surface]),
                        words(method.label, method.colour),
                        number(each["range_m"], ".2f"),
                        number(each["baseline_m"], ".3g"),
                        number(low, ".3g"),
                        number(high, ".3g"),
                        number(each["flat_from_m"], ".3g"),
                        number(each["flat_to_m"], ".3g"),
                        number(each["naive_baseline_m"], ".3g"),
                        number(costs.get(each["range_m"]), ".2f"),
                    ]
                )
    return Table(headings, rows)
