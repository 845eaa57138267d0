"""Errors over every axis that was swept, and over the range."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from harness.display import shortened_labels
from harness.evaluation.cells import NORMAL
from harness.evaluation.regions import middle_of_range
from harness.evaluation.statistics import FEW_SEEDS, Curve, balanced, mean_over_seeds
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, LineKey, Paragraph, section_of
from harness.report.sweep import Axis, MethodStyle, Sweep
from harness.report.theme import FAINT, HALF, Picture
from harness.runs.cases import CASE

SURFACES = {"wall": "walls", "floor": "floor, ceiling"}
BASELINE = "view_2.baseline_m"
LAWS = {"law_exact": ("exact law", (0, (5, 2))), "law_paper": ("$d^2/|t|$", (0, (1, 1.6)))}


_WORDS = """
<p>Median errors over all pixels of the domain on walls and on floor and ceiling, averaged as logarithms over
{{ "the " ~ seeds ~ " seeds and " if seeds > 1 }}all other axes. Bands are 95 % intervals from resampling seeds
{%- if seeds < 2 %} (none here: there is one seed)
{%- elif few_seeds %}; with so few seeds they are rather too short{% endif %}.
Where the law predicts how the error depends on an axis it is drawn in grey, through the mean of the curves: only its
slope is predicted; its height is fitted.</p>
"""
_ERRORS = """
Errors against {{ swept.label }}: (a) range, (b) disparity; walls on the left, floor and ceiling on the right of each
panel.
{% if swept.law %}Grey, dashed: the exact law with a constant σ(<i>α</i><sub>2</sub>), which in (b) is a level line;
dotted: d²/|<b>t</b>|.{% endif %}
{{ " " }}
{%- if swept.unbalanced %}From cells of surface, direction and range, whose medians are averaged as logarithms;
different ranges come with partly different directions{{ " and settings" if several }}, and the law is averaged over the
same cells. {%- elif swept.coupled %} No setting of the other axes has an error at every value: each value is averaged
over settings of its own, which are a part of what differs.
{%- elif axes > 1 %} Averaged over those settings of the other axes that occur with every value.{% endif %}
"""


def _title(context: Context) -> str:
    return "Errors over every axis" if _drawn(context.sweep) else "Errors over the range"


def _drawn(sweep: Sweep) -> list[Axis]:
    """The axes that have a figure here: cases have a section of their own."""
    return [axis for axis in sweep.axes if axis.key != CASE]


@section_of(About.ALL_TRIALS, "sweeps", _title)
def section(context: Context) -> Iterator[Block]:
    """A figure for each axis, and one for the range."""
    sweep = context.sweep
    figures = swept_figures(sweep, context.column_deg)
    if not figures:
        return
    seeds = len(sweep.seeds)
    if sweep.several:
        yield Paragraph(html(_WORDS, seeds=seeds, few_seeds=seeds < FEW_SEEDS))
    laws: bool | None = None
    for each in figures:
        if each.law != laws:  # a key has what its figures have
            laws = each.law
            yield LineKey(key_picture(sweep, laws=laws))
        caption = html(_ERRORS, swept=each, several=sweep.several, axes=len(sweep.axes))
        yield Figure(f"figure-{each.id}", each.pictures, caption, data=each.data)


@dataclass(frozen=True)
class Swept:
    """One figure: errors over one axis."""

    id: str
    title: str
    label: str
    """The axis's label, with its unit."""
    pictures: list[Picture]
    data: Data
    law: bool
    """Whether the law predicts a dependence on this axis."""
    unbalanced: bool
    """Whether the means at different values are over different groups of cells, where no group has them all."""
    coupled: bool = False
    """Whether the axis changes together with others: no group of trials has all of its values."""


@dataclass(frozen=True)
class _Line:
    method: MethodStyle
    surface: str
    measure: str
    x: list[float]
    texts: list[str]
    curve: Curve


_MEASURES = {
    "range": ("range_median_abs_m", 1000.0, "median |range error| (mm)", "(a) range"),
    "disparity": ("disparity_median_abs_px", 1.0, "median |disparity error| (px)", "(b) disparity"),
}


def swept_figures(sweep: Sweep, column_deg: float) -> list[Swept]:
    """A figure for each axis, and one for the range where cells lie at different ranges.

    Parameters
    ----------
    column_deg
        One pixel of disparity.
    """
    figures = [_over_axis(sweep, axis) for axis in _drawn(sweep)]
    if not sweep.cells.empty and sweep.cells["range_bin"].min() < sweep.cells["range_bin"].max():
        figures.append(_over_range(sweep, column_deg))
    return figures


def _over_axis(sweep: Sweep, axis: Axis) -> Swept:
    others = [each.key for each in sweep.axes if each.key != axis.key]
    lines = []
    coupled = False
    for name, (measure, _, _, _) in _MEASURES.items():
        for surface in SURFACES:
            for method in sweep.methods:
                table = method.of(sweep.trials).pivot_table(
                    index=["seed", *others],
                    columns=axis.key,
                    values=f"{surface}_{measure}",
                    aggfunc="mean",
                    dropna=False,
                )
                present = [i for i in range(len(axis.values)) if i in table and table[i].notna().any()]
                if not present:
                    continue
                table = balanced(table[present])
                coupled |= bool(others) and bool(table.isna().any(axis=None))
                curve = mean_over_seeds(table, logarithmic=True)
                x = [axis.positions[i] for i in present]
                lines.append(_Line(method, surface, name, x, [axis.texts[i] for i in present], curve))
    shapes = _law_over_baselines(sweep) if axis.key == BASELINE else {}
    pictures = [_picture(name, lines, axis, shapes) for name in _MEASURES]
    data = _data(axis.slug, axis.key, lines)
    return Swept(axis.slug, axis.name, axis.label, pictures, data, bool(shapes), unbalanced=False, coupled=coupled)


def _over_range(sweep: Sweep, column_deg: float) -> Swept:
    bins = sorted(sweep.cells["range_bin"].unique())
    middle = {index: middle_of_range(index) for index in bins}
    axis = Axis("range_m", [round(middle[index], 2) for index in bins])
    lines = []
    shapes: dict[str, dict[str, tuple[Array, Array]]] = {}
    for surface in sweep.surfaces:
        for method in sweep.methods:
            cells = sweep.cells_of(method, surface)
            if cells.empty:
                continue
            for name, column, scale in (
                ("range", "spread_m", 1 / NORMAL),
                ("disparity", "sigma_alpha", math.degrees(1 / NORMAL) / column_deg),
            ):
                table = _pivot(cells, "range_bin", cells[column] * scale)
                x = [middle[index] for index in table.columns]
                texts = [f"{each:.2f}" for each in x]
                lines.append(_Line(method, surface, name, x, texts, mean_over_seeds(table, logarithmic=True)))
        largest = max((sweep.cells_of(method, surface) for method in sweep.methods), key=len)
        shapes[surface] = {
            law: _shape(
                _pivot(largest, "range_bin", largest[law]), [middle[i] for i in sorted(largest["range_bin"].unique())]
            )
            for law in LAWS
        }
    pictures = [_picture(name, lines, axis, shapes, "true range $d$ (m)") for name in _MEASURES]
    return Swept(
        "sweep-range",
        "range",
        "true range (m)",
        pictures,
        _data("sweep-range", "range_m", lines),
        True,
        unbalanced=True,
    )


def _pivot(cells: pd.DataFrame, columns: str, values: "pd.Series[float]") -> pd.DataFrame:
    groups = [name for name in ("seed", "condition", "baseline_m", "alpha_bin") if name != columns]
    return cells.assign(value=values).pivot_table(index=groups, columns=columns, values="value", aggfunc="mean")


def _shape(table: pd.DataFrame, x: list[float]) -> tuple[Array, Array]:
    return np.array(x), mean_over_seeds(table, logarithmic=True).mean


def _law_over_baselines(sweep: Sweep) -> dict[str, dict[str, tuple[Array, Array]]]:
    """The dependence of the laws on the baseline, over the groups of cells that every baseline has."""
    shapes = {}
    for surface in sweep.surfaces:
        cells = max((sweep.cells_of(method, surface) for method in sweep.methods), key=len)
        groups = ["seed", "condition", "alpha_bin", "range_bin"]
        laws = {}
        for law in LAWS:
            table = balanced(cells.pivot_table(index=groups, columns="baseline_m", values=law, aggfunc="mean"))
            if table.shape[1] > 1:
                laws[law] = _shape(table, [float(value) for value in table.columns])
        if laws:
            shapes[surface] = laws
    return shapes


@theme.panel
def _picture(
    name: str,
    lines: list[_Line],
    axis: Axis,
    shapes: dict[str, dict[str, tuple[Array, Array]]],
    label: str = "",
) -> Picture:
    _, scale, ordinate, title = _MEASURES[name]
    mine = [line for line in lines if line.measure == name]
    fig, panels = theme.pair()
    span = [scale * each for line in mine for each in (line.curve.low, line.curve.high, line.curve.mean)]
    known = np.concatenate(span) if span else np.array([])
    known = known[np.isfinite(known) & (known > 0)]
    described = []
    for ax, (surface, words) in zip(panels, SURFACES.items(), strict=True):
        here = [line for line in mine if line.surface == surface]
        _abscissa(ax, axis, label)
        ax.set_title(words)
        if known.size:
            theme.logarithmic(ax, "y", float(known.min()) / 1.25, float(known.max()) * 1.25)
        if not here:
            theme.note(ax, "no estimate")
            continue
        for line in here:
            draw_line(ax, line.method, line.x, line.curve, scale)
            first, last = (f"{scale * line.curve.mean[i]:.3g}" for i in (0, -1))
            described.append(
                f"{line.method.label} on {words} from {first} at {line.texts[0]} to {last} at {line.texts[-1]}"
            )
        level = np.exp(np.mean([np.mean(np.log(scale * line.curve.mean)) for line in here]))
        for law, (x, shape) in shapes.get(surface, {}).items():
            if name == "range":
                anchored = level * shape / np.exp(np.mean(np.log(shape)))
                ax.plot(x, anchored, color=FAINT, linestyle=LAWS[law][1], linewidth=1.0, zorder=1)
        if name == "disparity" and shapes:
            ax.axhline(level, color=FAINT, linestyle=LAWS["law_exact"][1], linewidth=1.0, zorder=1)
    panels[0].set_ylabel(ordinate)
    return theme.picture(fig, f"{ordinate} against {axis.label}: {'; '.join(described) or 'no estimate'}.", title)


def draw_line(ax: Axes, method: MethodStyle, x: "list[float] | Array", curve: Curve, scale: float = 1.0) -> None:
    """A curve with its intervals as a band."""
    known = np.isfinite(curve.low)
    if known.any():
        low, high = scale * curve.low, scale * curve.high
        ax.fill_between(x, low, high, where=known, color=method.colour, alpha=0.18, linewidth=0)
    ax.plot(
        x,
        scale * curve.mean,
        color=method.colour,
        linestyle=method.stroke,
        marker=method.marker,
        markersize=4,
        markerfacecolor=method.face,
        linewidth=1.3,
    )


def _abscissa(ax: Axes, axis: Axis, label: str) -> None:
    positions = axis.positions
    ax.set_xlabel(label or theme.plain(axis.label))
    if axis.logarithmic:
        theme.logarithmic(ax, "x", min(positions) / 1.12, max(positions) * 1.12, most=5)
        if len(positions) <= 6 and _are_apart(list(np.log(positions))):
            ax.set_xticks(positions, axis.texts)
        return
    margin = 0.07 * ((max(positions) - min(positions)) or 1)
    ax.set_xlim(min(positions) - margin, max(positions) + margin)
    if not axis.numeric:
        texts = [theme.plain(text) for text in shortened_labels(axis.texts, 16)]
        span = max(positions) - min(positions)
        before, after = (max(0.35, _room(texts[i]) * span) for i in (0, -1))
        ax.set_xlim(min(positions) - before, max(positions) + after)
        ax.set_xticks(positions, texts)
    elif len(positions) <= 6 and _are_apart(positions):
        ax.set_xticks(positions, axis.texts)


def _room(text: str) -> float:
    """The margin that a centred label needs beyond the last tick, as a share of the span of the ticks.

    A panel is some 210 px wide, a letter 6 px.
    """
    half = min(0.014 * len(text) + 0.01, 0.25)
    return half / (1 - 2 * half)


def _are_apart(positions: list[float]) -> bool:
    """Whether labels at these positions do not overlap."""
    ordered = np.sort(positions)
    return len(ordered) < 2 or float(np.diff(ordered).min()) > 0.09 * float(ordered[-1] - ordered[0])


@theme.panel
def key_picture(sweep: Sweep, *, laws: bool) -> Picture:
    """A legend for all figures of a section."""
    handles = [
        Line2D(
            [],
            [],
            color=method.colour,
            linestyle=method.stroke,
            marker=method.marker,
            markersize=4.5,
            markerfacecolor=method.face,
        )
        for method in sweep.methods
    ]
    labels = [method.label for method in sweep.methods]
    shown = [theme.plain(label) for label in labels]
    if laws:
        handles += [Line2D([], [], color=FAINT, linestyle=dashes) for _, dashes in LAWS.values()]
        labels += [name for name, _ in LAWS.values()]
        shown += [name for name, _ in LAWS.values()]
    fig = theme.figure(HALF, 26 * math.ceil(len(labels) / 2))
    fig.legend(handles, shown, loc="center left", ncol=2, handlelength=2.6)
    return theme.picture(fig, f"Key to the lines: {', '.join(labels)}.")


def _data(name: str, key: str, lines: list[_Line]) -> Data:
    rows = [
        [line.method.matcher, line.method.subpixel, line.surface, line.measure, text, mean, low, high]
        for line in lines
        for text, mean, low, high in zip(line.texts, line.curve.mean, line.curve.low, line.curve.high, strict=True)
    ]
    headings = ["matcher", "subpixel", "surface", "error", key, "median_abs", "ci95_low", "ci95_high"]
    return Data(
        name, [*headings], [[*row[:3], f"{row[3]}_{'m' if row[3] == 'range' else 'px'}", *row[4:]] for row in rows]
    )
