"""Images: the relative error of the range regressed on both laws."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from harness.evaluation.law_images import LAWS, residuals
from harness.evaluation.statistics import median_over_seeds
from harness.report import theme
from harness.report.data import Data, interval
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, LineKey, TableBlock, section_of
from harness.report.sections.error_curves import SURFACES, key_picture
from harness.report.sections.law import slopes
from harness.report.sections.law.part import LAW_NAMES, PLAIN_NAMES, Fit, is_of
from harness.report.sweep import MethodStyle, Sweep, log_edges
from harness.report.theme import FAINT, Picture
from harness.report.typography import figure

_DENSE = LinearSegmentedColormap.from_list("cells", ["#FFFFFF", "#D5DEE8", "#7A8DA3", "#2F4158"])


_REGRESSION = """
Relative error of the range against the law, for each method, on walls and on floors; in each panel the exact law is on
the left and d²/|<b>t</b>| on the right, both over the range. Grey: cells, darker where there are more (square root of
their number). Every condition (all settings but seed, baseline, size and method) has its own intercept in the fit; here
all are shifted to a common level. Marks: medians of bins with 95 % intervals. Solid: the fitted line; dashed: slope 1,
what the law says if σ(<i>α</i><sub>2</sub>) is constant.
"""
_SLOPES = """
Slope of log(spread/<i>d</i>) on log(law/<i>d</i>) over all directions, with 95 % intervals from resampling seeds. R² is
the share of the variance within conditions.
"""
_LIMITED = """
The same over the cells that noise limits: those whose error without noise, all else being equal, is at most half of
that with it. The others are dominated by the matcher’s systematic error, which a law of sensitivity does not describe.
“Exact law × bound” has the Cramér-Rao bound of each cell instead of one constant σ({{ alpha(2) }}): if this slope is
nearer to 1 than that of the law alone, part of the variation comes from the texture.
"""
_COEFFICIENTS = """
The same cells with a coefficient for each of the two: log(spread/<i>d</i>) on log(law/<i>d</i>) and on log(bound of
{{ alpha(2) }}) at once. The law says 1 for the first. The second is 1 where the error follows the texture as the
Cramér-Rao bound does, and less where the bound explains only a part of what the texture does. A slope of 1 on their
product does not say that each is 1.
"""
_BY_NOISE = """
Slopes on the exact law for each noise level separately. At whole pixels most of the error is rounding, which is
constant in angle by construction: there a slope near 1 that does not change with the noise confirms the geometry, not
the premise about noise.
"""
_DIRECTIONS = """
The same slopes within each sixth of the directions, with 95 % intervals; 90° is across the baseline. Within a sixth the
exact law and d²/|<b>t</b>| are nearly proportional, so that their slopes differ less than over all directions together.
"""
_CONDITIONS = """
Slopes on the exact law within each condition, with the share of the estimates that are off by more than a pixel:
mismatches, to which no law of small errors applies.
"""
_RESIDUALS = """
Residuals of the fits against the law over the range: medians of bins
{%- if few %}, and bars that hold half of the cells{% endif %}. A bend means that no power of the law describes the
errors, whatever its slope; the residual 0.1 is an error 11 % larger than fitted.
"""
_METHOD = ["matcher", "subpixel", "surface", "law"]


@section_of(About.ALL_TRIALS, "law-images", "The law: images")
def section(context: Context) -> Iterator[Block]:
    """Regressions of the relative error on both laws."""
    sweep, law = context.sweep, context.law
    if not law:
        return
    fits: list[Fit] = law["images"]
    yield _regressions(sweep, fits)
    yield TableBlock("table-law-slopes", slopes.slope_table(sweep, fits), html(_SLOPES))
    for name, table, caption in (
        ("limited", slopes.slope_table(sweep, law["noise_limited"]), _LIMITED),
        ("coefficients", slopes.coefficient_table(sweep, law["law_and_bound"]), _COEFFICIENTS),
        ("noise", slopes.noise_table(sweep, law["by_noise"]), _BY_NOISE),
    ):
        if table.rows:
            yield TableBlock(f"table-law-{name}", table, html(caption))
    yield LineKey(key_picture(sweep, laws=False))
    yield _by_direction(sweep, fits)
    conditions = slopes.condition_table(sweep)
    if conditions.rows:
        yield TableBlock("table-law-conditions", conditions, html(_CONDITIONS))
    rows: list[list[Any]] = []
    yield Figure(
        "figure-law-residuals",
        [_residuals(sweep, fits, surface, letter, rows) for surface, letter in _lettered(sweep)],
        html(_RESIDUALS, few=len(sweep.methods) < 3),
        data=Data("law-residuals", [*_METHOD, "law_over_d", "quartile_1", "median", "quartile_3"], rows),
    )


def _regressions(sweep: Sweep, fits: list[Fit]) -> Figure:
    pictures: list[Picture] = []
    rows: list[list[Any]] = []
    for method in sweep.methods:
        for surface in SURFACES:
            mine = {fit["law"]: fit for fit in fits if is_of(fit, method, surface) and fit["slope"] is not None}
            if mine:
                pictures.append(_regression(sweep, method, surface, mine, rows))
    headings = [*_METHOD, "law_over_d", "cells", "median_spread_over_d", "ci95_low", "ci95_high"]
    return Figure("figure-law-images", pictures, html(_REGRESSION), data=Data("law-images", headings, rows))


def _by_direction(sweep: Sweep, fits: list[Fit]) -> Figure:
    rows: list[list[Any]] = [
        [
            fit["matcher"],
            fit["subpixel"],
            fit["surface"],
            fit["law"],
            f"{each['from_deg']:g}-{each['to_deg']:g}",
            each["slope"],
            *(each["slope_ci95"] or (None, None)),
            each["r2"],
        ]
        for fit in fits
        for each in fit["by_alpha_1"]
    ]
    headings = [*_METHOD, "alpha_1_deg", "slope", "ci95_low", "ci95_high", "r2"]
    return Figure(
        "figure-law-directions",
        [slopes.by_direction(sweep, fits, surface, letter) for surface, letter in _lettered(sweep)],
        html(_DIRECTIONS),
        data=Data("law-directions", headings, rows),
    )


def _lettered(sweep: Sweep) -> list[tuple[str, str]]:
    return list(zip(sweep.surfaces, "abcd", strict=False))


def _adjusted(cells: pd.DataFrame) -> "pd.Series[float]":
    """log(spread/d), every condition brought to the level of all."""
    y = np.log(cells["spread_m"] / cells["range_m"])
    return y - y.groupby(cells["condition"]).transform("mean") + y.mean()


@theme.panel
def _regression(
    sweep: Sweep, method: MethodStyle, surface: str, fits: dict[str, Fit], binned: list[list[Any]]
) -> Picture:
    tables = [in_cells for each in sweep.methods if len(in_cells := sweep.cells_of(each, surface))]
    cells = sweep.cells_of(method, surface)
    y = np.exp(_adjusted(cells))
    limits_y = _around(np.exp(pd.concat([_adjusted(each) for each in tables])), 0.003)
    limits_x = _around(pd.concat([each[f"law_{law}"] / each["range_m"] for law in LAWS for each in tables]), 0.001)
    fig, panels = theme.pair(height=330, top=46, left=70)
    described = []
    for ax, law in zip(panels, LAWS, strict=True):
        theme.logarithmic(ax, "x", *limits_x, most=4)
        theme.logarithmic(ax, "y", *limits_y)
        ax.set_xlabel("exact law / $d$ (per rad)" if law == "exact" else "$d\\,/\\,|t|$ (per rad)")
        if law not in fits:
            theme.note(ax, "not fitted")
            continue
        fit = fits[law]
        x = cells[f"law_{law}"] / cells["range_m"]
        _density(ax, x, y, limits_x, limits_y)
        centre = float(np.exp(np.log(x).mean())), float(np.exp(np.log(y).mean()))
        ends = np.array([x.min(), x.max()])
        ax.plot(ends, centre[1] * (ends / centre[0]), color=theme.TRUTH, linestyle=(0, (4, 2.5)), linewidth=1.0)
        ax.plot(ends, centre[1] * (ends / centre[0]) ** fit["slope"], color=method.colour, linewidth=1.6)
        edges = log_edges(x, 9)
        index = np.digitize(x, edges) - 1
        points = []
        for i in range(9):
            inside = index == i
            if inside.sum() >= 8:
                median, low, high = median_over_seeds(y[inside].to_numpy(), cells["seed"][inside].to_numpy())
                at = math.sqrt(edges[i] * edges[i + 1])
                points.append((at, median, low, high))
                binned.append([method.matcher, method.subpixel, surface, law, at, int(inside.sum()), median, low, high])
        across, middle, lower, upper = np.array(points).reshape(-1, 4).T
        ax.vlines(across, lower, upper, color=method.colour, linewidth=1.4)
        ax.plot(
            across,
            middle,
            method.marker,
            color=method.colour,
            markersize=5,
            markerfacecolor=theme.PAPER,
            markeredgewidth=1.3,
        )
        ci = fit["slope_ci95"]
        words_of_fit = f"slope {figure(fit['slope'], '.2f')}{'' if ci is None else ' ' + interval(ci, '.2f')}"
        ax.set_title(f"{words_of_fit}\nR² {fit['r2']:.2f}", fontsize=9.5)
        described.append(f"{'exact law' if law == 'exact' else 'short form'} {words_of_fit}, R² {fit['r2']:.2f}")
    panels[0].set_ylabel("spread / $d$, conditions aligned")
    name = f"{method.label}, {SURFACES[surface]}"
    return theme.picture(
        fig, f"Relative range error against the law over the range, {name}: {'; '.join(described)}.", name
    )


def _around(values: "pd.Series[float]", cut: float) -> tuple[float, float]:
    low, high = np.quantile(values, [cut, 1 - cut])
    return float(low) / 1.3, float(high) * 1.3


def _density(
    ax: Axes, x: "pd.Series[float]", y: "pd.Series[float]", limits_x: tuple[float, float], limits_y: tuple[float, float]
) -> None:
    """Draw the density of cells, as an image of few pixels."""
    counts, _, _ = np.histogram2d(np.log(x), np.log(y), bins=(40, 44), range=(np.log(limits_x), np.log(limits_y)))
    shown = np.sqrt(counts.T / max(counts.max(), 1))
    # On axes of their own: a picture is linear, the axes are logarithmic.
    below = ax.figure.add_axes(ax.get_position().bounds, zorder=ax.get_zorder() - 1)
    below.set_axis_off()
    below.imshow(
        np.round(shown * 20) / 20, cmap=_DENSE, origin="lower", aspect="auto", vmin=0, vmax=1, interpolation="none"
    )
    ax.patch.set_alpha(0)


@theme.panel
def _residuals(sweep: Sweep, fits: list[Fit], surface: str, letter: str, rows: list[list[Any]]) -> Picture:
    fig, panels = theme.pair()
    tables = [sweep.cells_of(each, surface) for each in sweep.methods]
    limits = _around(pd.concat([each[f"law_{law}"] / each["range_m"] for law in LAWS for each in tables]), 0.001)
    described, reach = [], [0.5]
    for ax, law in zip(panels, LAWS, strict=True):
        theme.logarithmic(ax, "x", *limits, most=4)
        ax.axhline(0, color=FAINT, linewidth=0.8)
        ax.set_title(LAW_NAMES[law])
        ax.set_xlabel("law / $d$ (per rad)")
        for number_of, method in enumerate(sweep.methods):
            fit = next(
                (f for f in fits if is_of(f, method, surface) and f["law"] == law and f["slope"] is not None), None
            )
            if fit is None:
                continue
            x, off = np.array(list(residuals(sweep.cells_of(method, surface), fit))).T
            edges = log_edges(pd.Series(x), 9)
            index = np.digitize(x, edges) - 1
            points = [
                (math.sqrt(edges[i] * edges[i + 1]) * 1.03**number_of, *np.quantile(off[index == i], [0.25, 0.5, 0.75]))
                for i in range(9)
                if (index == i).sum() >= 8
            ]
            at, low, middle, high = np.array(points).reshape(-1, 4).T
            if len(sweep.methods) < 3:  # more would hide each other
                ax.vlines(at, low, high, color=method.colour, linewidth=1.1, alpha=0.8)
            else:
                low = high = middle
            ax.plot(
                at,
                middle,
                color=method.colour,
                linestyle=method.stroke,
                marker=method.marker,
                markersize=4,
                markerfacecolor=method.face,
            )
            rows += [[method.matcher, method.subpixel, surface, law, *each] for each in points]
            reach += [float(np.abs([low, high]).max())] if points else []
            described.append(
                f"{method.label} {PLAIN_NAMES[law]}: medians within {figure(float(middle.min()), '+.2f')} to "
                f"{figure(float(middle.max()), '+.2f')}"
            )
    for ax in panels:
        ax.set_ylim(-1.1 * max(reach), 1.1 * max(reach))
    panels[0].set_ylabel("residual, ln(measured / fitted)")
    name = SURFACES[surface]
    return theme.picture(
        fig,
        f"Residuals of the fits on {name} against the law over the range: {'; '.join(described)}.",
        f"({letter}) {name}",
    )
