"""All figures of all trials, averaged over seeds."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.metric_table import METRICS, metric
from harness.evaluation.statistics import mean_over_seeds
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, TableBlock, section_of
from harness.report.sweep import Axis, MethodStyle, Sweep

MOST_ROWS = 240
"""The most rows of a table on the page; all are in its data."""

SHOWN = (
    *(name for name in METRICS if name != "refined"),
    "wall_disparity_median_abs_px",
    "wall_range_median_abs_m",
    "floor_disparity_median_abs_px",
    "floor_range_median_abs_m",
    "solid_angle_density",
    "solid_angle_disparity_median_abs_px",
    "solid_angle_bad_1px",
    "solid_angle_range_median_abs_m",
    "solid_angle_range_rmse_m",
    "refined",
)
"""The metrics of the columns; all others are in the data alone."""

_ON_PAPER = (
    "density",
    "disparity_median_abs_px",
    "bad_1px",
    "range_median_abs_m",
    "range_rmse_m",
    "wall_disparity_median_abs_px",
    "wall_range_median_abs_m",
    "floor_disparity_median_abs_px",
    "floor_range_median_abs_m",
)

_WITH_INTERVAL = ("disparity_median_abs_px", "range_median_abs_m")


_TABLE = """
All figures{% if several %}, means over seeds with 95 % intervals under the two main ones alone{% endif %}; each trial
over the pixels of the domain that it has an estimate for, except where a surface or the solid angle is named. Pixels
without an estimate count in the density alone. A50 to A99: quantiles of the absolute disparity error. AbsRel: mean of
|error|/<i>d</i>. SqRel: mean of error²/<i>d</i>. SILog: standard deviation of log(estimate/<i>d</i>). δ: share of
estimates within that factor of the truth. Seam: mean over rows of the difference between the errors in the first and
in the last column. Boundaries: pixels where Sobel’s gradient of the range is longer than stated, in estimate and truth;
one without an estimate is missed. Normals: by the points of the four neighbours. Occlusion: of pixels that a matcher
says view 2 does not see, how many it does not (precision), and of all such pixels, how many are said to be (recall).
Refined: share of estimates that the
sub-pixel step could move.
"""


@section_of(About.ALL_TRIALS, "measures", "All figures")
def section(context: Context) -> Iterator[Block]:
    """One table of everything."""
    caption = html(_TABLE, several=context.sweep.several)
    yield TableBlock("table-measures", all_measures(context.sweep), caption)


def all_measures(sweep: Sweep) -> Table:
    """A row for each method and combination of axis values: means over seeds, two of them with intervals."""
    keys = [axis.key for axis in sweep.axes]
    known = [name for name in sweep.trials if name not in {"matcher", "subpixel", "seed", *keys}]
    columns = [metric(name) for name in SHOWN if name in known]
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    left_out = 0
    groups: dict[tuple[Any, ...], tuple[MethodStyle, tuple[int, ...], pd.DataFrame]] = {}
    for index, method in enumerate(sweep.methods):
        mine = method.of(sweep.trials)
        for indices, part in mine.groupby(keys, sort=False) if keys else [((), mine)]:
            groups[*indices, index] = (method, indices, part)
    for _, (method, indices, part) in sorted(groups.items(), key=lambda each: each[0]):
        curve = mean_over_seeds(part.set_index("seed")[known].astype(np.float64))
        means = dict(zip(known, curve.mean, strict=True))
        spans = {name: (low, high) for name, low, high in zip(known, curve.low, curve.high, strict=True)}
        plain.append(
            [
                method.matcher,
                method.subpixel,
                *(axis.texts[i] for axis, i in zip(sweep.axes, indices, strict=True)),
                len(part),
                *(value for name in known for value in (means[name], *spans[name])),
            ]
        )
        if len(rows) >= MOST_ROWS:
            left_out += 1
            continue
        cells = []
        for each in columns:
            span = spans[each.name]
            between = span if each.name in _WITH_INTERVAL and np.isfinite(span).all() else None
            cells.append(number(float(means[each.name]), each.form, each.scale, between))
        rows.append(
            [
                words(method.label, method.colour),
                *(_index_cell(axis, i) for axis, i in zip(sweep.axes, indices, strict=True)),
                count(len(part)),
                *cells,
            ]
        )
    head = [Heading("Method", text=True)]
    head += [
        Heading(axis.name, axis.label.removeprefix(axis.name).strip(" ()"), text=not axis.numeric)
        for axis in sweep.axes
    ]
    head += [Heading("Seeds"), *(Heading(each.heading, each.unit) for each in columns)]
    headings = [f"{name}{end}" for name in known for end in ("", "_ci95_low", "_ci95_high")]
    data = Data("measures", ["matcher", "subpixel", *keys, "seeds", *headings], plain)
    first = len(head) - len(columns)
    screen_only = tuple(first + i for i, each in enumerate(columns) if each.name not in _ON_PAPER)
    return Table(head, rows, data, left_out, screen_only)


def _index_cell(axis: Axis, index: int) -> Cell:
    return Cell(axis.texts[index], axis.positions[index] if axis.numeric else axis.texts[index])
