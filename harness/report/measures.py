"""All figures of all trials, averaged over seeds; failures; durations."""

import json
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.metric_table import METRICS, metric
from harness.evaluation.statistics import mean_over_seeds
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.sweep import Axis, Sweep, Way
from harness.runs.run import Result
from harness.runs.values import shown

MOST_ROWS = 240
"""The most rows of a table on the page; nobody reads more there, and all are in its data."""

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
"""The metrics of the columns; those that are not named here are in the data alone."""

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


def all_measures(sweep: Sweep) -> Table:
    """One row for each method and place on the axes: means over seeds, intervals under the two main figures."""
    keys = [axis.key for axis in sweep.axes]
    known = [name for name in sweep.trials if name not in {"matcher", "subpixel", "seed", *keys}]
    columns = [metric(name) for name in SHOWN if name in known]
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    left_out = 0
    groups: dict[tuple[Any, ...], tuple[Way, tuple[int, ...], pd.DataFrame]] = {}
    for index, way in enumerate(sweep.ways):
        mine = way.of(sweep.trials)
        for place, part in mine.groupby(keys, sort=False) if keys else [((), mine)]:
            groups[*place, index] = (way, place, part)
    for _, (way, place, part) in sorted(groups.items(), key=lambda each: each[0]):
        curve = mean_over_seeds(part.set_index("seed")[known].astype(np.float64))
        means = dict(zip(known, curve.mean, strict=True))
        spans = {name: (low, high) for name, low, high in zip(known, curve.low, curve.high, strict=True)}
        plain.append(
            [
                way.matcher,
                way.subpixel,
                *(axis.texts[i] for axis, i in zip(sweep.axes, place, strict=True)),
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
                words(way.label, way.colour),
                *(_place(axis, i) for axis, i in zip(sweep.axes, place, strict=True)),
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


def _place(axis: Axis, index: int) -> Cell:
    return Cell(axis.texts[index], axis.positions[index] if axis.numeric else axis.texts[index])


def failures(result: Result) -> Table:
    """What went wrong: one row for each message."""
    failed: dict[str, list[Any]] = {}
    for row in result.rows:
        if row.state == "failed":
            failed.setdefault(row.finished.message, []).append(row)
    rows = [
        [words(message), count(len(found)), words(shown(found[0].place)), words(found[0].planned.key)]
        for message, found in failed.items()
    ]
    data = Data(
        "failures",
        ["key", "place", "message"],
        [[row.planned.key, shown(row.place), message] for message, found in failed.items() for row in found],
    )
    head = [
        Heading("Message", text=True),
        Heading("Trials"),
        Heading("First at", text=True),
        Heading("Its key", text=True),
    ]
    return Table(head, rows, data)


def durations(result: Result) -> Table:
    """Wall time by stage: of each trial when they are few, else over all of them."""
    done = [row for row in result.rows if row.state == "done"]
    seconds = [json.loads(row.finished.seconds) for row in done]
    stages = list(dict.fromkeys(stage for each in seconds for stage in each))
    if len(done) <= 4:
        head = [Heading("Stage", text=True), *(Heading(f"Trial {row.planned.key}", "s") for row in done)]
        rows = [[words(stage), *(number(each.get(stage), ".3f") for each in seconds)] for stage in stages]
        rows.append([words("total"), *(number(sum(each.values()), ".3f") for each in seconds)])
        return Table(head, rows)
    head = [Heading("Stage", text=True), Heading("Median", "ms a trial"), Heading("Longest", "ms"), Heading("Sum", "s")]
    rows = []
    for stage in [*stages, "total"]:
        values = np.array([sum(each.values()) if stage == "total" else each.get(stage, 0.0) for each in seconds])
        rows.append(
            [
                words(stage),
                number(float(np.median(values)), ".1f", 1000),
                number(float(values.max()), ".0f", 1000),
                number(float(values.sum()), ".1f"),
            ]
        )
    return Table(head, rows)
