"""The named cases: what each changes, and its errors, a line each."""

import math
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from harness.evaluation.metric_table import METRICS
from harness.evaluation.statistics import FEW_SEEDS
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.sweep import MethodStyle, Sweep
from harness.report.theme import WIDE, Picture
from harness.runs.case_figures import FIGURES
from harness.runs.values import text_of

_CAPTION = """
Median |range error| of each case over all pixels of the domain: geometric means over
{{ "the " ~ seeds ~ " seeds and " if seeds > 1 }}all axes{% if seeds > 1 %}, with 95 % intervals from resampling
seeds{% if few_seeds %}, which are rather too short from so few{% endif %}{% endif %}.
"""
_TABLE = """
The figures of each case: means over its trials, geometric ones for medians of errors
{%- if seeds > 1 %}, with 95 % intervals from resampling seeds{% else %}; of one seed, without intervals{% endif %}.
"""
_CHANGES = """
<details><summary>What each case changes in the base trial</summary>
<ul>
{% for name, settings in changes %}<li>{{ name }}: {% for text in settings %}<code>{{ text }}</code>
{{- ", " if not loop.last }}{% else %}nothing{% endfor %}.</li>
{% endfor %}
</ul>
</details>
"""
_SHOWN = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "range_rmse_m", "range_bias_m")
_LETTERS = 34
"""Most letters in a line of a name beside its row."""

Entry = dict[str, Any]


@section_of(About.ALL_TRIALS, "cases", "The cases")
def section(context: Context) -> Iterator[Block]:
    """A figure and a table; nothing without cases, and where cases are the methods, which are compared everywhere."""
    entries: list[Entry] = context.summary.get("cases") or []
    if not entries or context.summary.get("labels"):
        return
    seeds = max(each["seeds"] for each in entries)
    caption = html(_CAPTION, seeds=seeds, few_seeds=seeds < FEW_SEEDS)
    data = Data("cases", _NAMES, [[_plain(entry, name) for name in _NAMES] for entry in entries])
    yield Figure("figure-cases", [_picture(context.sweep, entries)], caption, layout="wide", data=data)
    yield TableBlock("table-cases", _table(context.sweep, entries), html(_TABLE, seeds=seeds), full=False)
    yield Paragraph(html(_CHANGES, changes={each["case"]: _settings(each) for each in entries}.items()))


_NAMES = ["case", "settings", "matcher", "subpixel", "trials", "seeds", *FIGURES, "ci95_low", "ci95_high"]


def _plain(entry: Entry, name: str) -> Any:
    if name.startswith("ci95"):
        ends = entry["range_median_abs_m_ci95"] or (None, None)
        return ends[name == "ci95_high"]
    return "; ".join(_settings(entry)) if name == "settings" else entry[name]


def _settings(entry: Entry) -> list[str]:
    return [f"{key} = {text_of(value)}" for key, value in entry["settings"].items()]


def _styles(sweep: Sweep) -> dict[tuple[str, str], MethodStyle]:
    return {(method.matcher, method.subpixel): method for method in sweep.methods}


@theme.panel
def _picture(sweep: Sweep, entries: list[Entry]) -> Picture:
    """A row for each case, its name whole beside it; a mark for each method."""
    names = list(dict.fromkeys(each["case"] for each in entries))
    # Names wrap between words, and never inside one.
    labels = {
        name: textwrap.wrap(name, _LETTERS, break_long_words=False, break_on_hyphens=False) or [name] for name in names
    }
    tops = np.concatenate([[0.0], np.cumsum([max(1.4, 0.9 * len(labels[name]) + 0.5) for name in names])])
    middle = dict(zip(names, (tops[:-1] + tops[1:]) / 2, strict=True))
    height = round(17 * float(tops[-1]))
    left = 24 + round(6.2 * max(len(line) for lines in labels.values() for line in lines))
    fig = theme.figure(WIDE, height + 84)
    ax = theme.axes(fig, left, 34, WIDE - left - 24, height)
    described, values = [], []
    styles = _styles(sweep)
    for index, (key, method) in enumerate(styles.items()):
        mine = [each for each in entries if (each["matcher"], each["subpixel"]) == key and _has_error(each)]
        if not mine:
            continue
        y = [middle[each["case"]] + 0.3 * (index - (len(styles) - 1) / 2) for each in mine]
        x = [1000 * each["range_median_abs_m"] for each in mine]
        ends = np.array([each["range_median_abs_m_ci95"] or (math.nan, math.nan) for each in mine]) * 1000
        ax.hlines(y, ends[:, 0], ends[:, 1], color=method.colour, linewidth=1.4, alpha=0.8)
        label = theme.plain(method.label)
        ax.plot(x, y, method.marker, color=method.colour, markerfacecolor=method.face, markersize=5.5, label=label)
        values += [*x, *ends[np.isfinite(ends)]]
        described += [f"{each['case']} ({method.label}) {value:.3g}" for each, value in zip(mine, x, strict=True)]
    if values:
        theme.logarithmic(ax, "x", min(values) / 1.15, max(values) * 1.15, most=9)
        theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=6)
    else:
        theme.note(ax, "no estimate")
    ax.set_yticks(list(middle.values()), [theme.plain("\n".join(labels[name])) for name in names])
    ax.set_ylim(float(tops[-1]), 0)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="x", color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.set_xlabel("median |range error| (mm)")
    return theme.picture(fig, f"Median range errors by case, mm: {'; '.join(described) or 'no estimate'}.")


def _has_error(entry: Entry) -> bool:
    return bool(entry["range_median_abs_m"])  # no error, or zero, which a logarithmic axis cannot show


def _table(sweep: Sweep, entries: list[Entry]) -> Table:
    styles = _styles(sweep)
    several = len(styles) > 1
    columns = [METRICS[name] for name in _SHOWN]
    rows: list[list[Cell]] = []
    for each in entries:
        method = styles[each["matcher"], each["subpixel"]]
        figures = [
            number(each[metric.name], metric.form, metric.scale, each.get(f"{metric.name}_ci95")) for metric in columns
        ]
        rows.append(
            [
                words(each["case"].replace(" ", "\u00a0")),  # one line, however many columns there are
                *([words(method.label, method.colour)] if several else []),
                count(each["trials"]),
                *figures,
            ]
        )
    head = [
        Heading("Case", text=True),
        *([Heading("Method", text=True)] if several else []),
        Heading("Trials"),
        *(Heading(metric.heading, metric.unit) for metric in columns),
    ]
    return Table(head, rows)
