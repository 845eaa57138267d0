"""Whole pixels against the sub-pixel steps, setting by setting: where each helps, and where it does not."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from harness.display import listed
from harness.report.data import Cell, Data, Heading, Table, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Paragraph, TableBlock, section_of
from harness.report.sections.error_curves import SURFACES
from harness.report.sweep import MethodStyle, Sweep
from harness.report.typography import figure

_MOST_ROWS = 60
_WHOLE = "none"
_FIGURES = {"wall": "wall_disparity_median_abs_px", "floor": "floor_disparity_median_abs_px"}


_WORDS = """
<p>A sub-pixel step fits a curve to the costs around the best sample. Which curve suits depends on the width of the
minimum in samples, and so on the pitch of the samples, the window, and the blur of the image. A fit over more samples
than the minimum is wide, such as the least-squares parabola over seven at one sample per column, is pulled towards the
whole sample. Where the window covers several disparities, as on floors, the minimum itself is displaced, and no step
helps much.</p>
<ul>
{% for each in findings %}<li>{{ each }}</li>
{% endfor %}</ul>
"""
_TABLE = """
Median absolute disparity error by setting, geometric means over seeds, without intervals; ◂ marks the smallest of a
row.
"""


@section_of(About.ALL_TRIALS, "steps", "Whole pixels and sub-pixel steps")
def section(context: Context) -> Iterator[Block]:
    """The settings in which each sub-pixel step helps; nothing if steps were not compared over several settings."""
    compared = steps(context.sweep)
    if compared is not None:
        yield Paragraph(html(_WORDS, findings=compared.findings))
        yield TableBlock("table-steps", compared.table, html(_TABLE))


@dataclass(frozen=True)
class Steps:
    """A table of errors by setting and step, and the findings from it."""

    table: Table
    findings: list[str]


def steps(sweep: Sweep) -> Steps | None:
    """The comparison; None unless a matcher was run at whole pixels and with a sub-pixel step over several settings."""
    matchers = {method.matcher for method in sweep.methods if method.subpixel == _WHOLE}
    refined = [method for method in sweep.methods if method.matcher in matchers and method.subpixel != _WHOLE]
    if not refined or not sweep.axes:
        return None
    compared = [method for method in sweep.methods if method.matcher in matchers]
    errors = {surface: _errors(sweep, compared, column) for surface, column in _FIGURES.items()}
    return Steps(_table(sweep, compared, errors), list(_findings(sweep, compared, errors)))


def _errors(sweep: Sweep, methods: list[MethodStyle], column: str) -> pd.DataFrame:
    """Median errors, geometric means over seeds: a row for each setting, a column for each method, by its index."""
    keys = [axis.key for axis in sweep.axes]
    parts = {}
    for index, method in enumerate(methods):
        trials = method.of(sweep.trials)
        known = trials.assign(logarithm=np.log(trials[column].where(trials[column] > 0)))
        parts[index] = np.exp(known.groupby(keys, sort=False)["logarithm"].mean())
    return pd.DataFrame(parts)


def _table(sweep: Sweep, methods: list[MethodStyle], errors: dict[str, pd.DataFrame]) -> Table:
    headings = [
        Heading("Surface", text=True),
        *(Heading(axis.label) for axis in sweep.axes),
        *(Heading(method.label[0].upper() + method.label[1:], "px") for method in methods),
    ]
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for surface, table in errors.items():
        for indices, values in table.iterrows():
            names = _texts(sweep, indices)
            least = float(np.nanmin(values)) if values.notna().any() else np.nan
            cells = [number(float(value), ".3f") for value in values]
            marked = [
                Cell(f"{cell.text} ◂", cell.value) if float(value) == least else cell
                for cell, value in zip(cells, values, strict=True)
            ]
            rows.append([words(SURFACES[surface]), *(words(name) for name in names), *marked])
            plain.append([surface, *names, *(float(value) for value in values)])
    data = Data(
        "subpixel-steps",
        ["surface", *(axis.key for axis in sweep.axes), *(f"{method.matcher} {method.subpixel}" for method in methods)],
        plain,
    )
    return Table(headings, rows[:_MOST_ROWS], data, left_out=max(0, len(rows) - _MOST_ROWS))


def _findings(sweep: Sweep, methods: list[MethodStyle], errors: dict[str, pd.DataFrame]) -> Iterator[str]:
    """Sentences for each surface and step: in how many settings it helps, by how much, and where most and least."""
    for surface, table in errors.items():
        for index, method in enumerate(methods):
            if method.subpixel == _WHOLE:
                continue
            whole = next(
                i for i, each in enumerate(methods) if each.matcher == method.matcher and each.subpixel == _WHOLE
            )
            gain = (table[whole] / table[index]).dropna()
            if gain.empty:
                continue
            helps = int((gain > 1).sum())
            text = (
                f"{SURFACES[surface].capitalize()}, {method.label}: smaller median error than whole pixels "
                f"in {helps} of {len(gain)} settings"
            )
            if len(gain) > 1:
                most, least = gain.idxmax(), gain.idxmin()
                text += (
                    f"; most, {figure(float(gain.max()), '.2f')} times smaller, at {_named(sweep, most)}, least, "
                    f"{figure(float(gain.min()), '.2f')}, at {_named(sweep, least)}"
                )
            best = int((table.dropna(how="all").idxmin(axis=1) == index).sum())
            yield f"{text}. It is the best of all in {best}."


def _named(sweep: Sweep, indices: Any) -> str:
    return listed(f"{axis.label} {name}" for axis, name in zip(sweep.axes, _texts(sweep, indices), strict=True))


def _texts(sweep: Sweep, indices: Any) -> list[str]:
    """The values on the axes as text, from their indices."""
    indices = indices if isinstance(indices, tuple) else (indices,)
    return [axis.texts[i] for axis, i in zip(sweep.axes, indices, strict=True)]
