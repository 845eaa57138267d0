"""All figures of all trials, averaged over seeds; failures; durations."""

import json
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.statistics import mean_over_seeds
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.sweep import Axis, Sweep, Way
from harness.runs.run import Result
from harness.runs.values import shown

MOST_ROWS = 240
"""Of a table on the page; more are not read there, and are in its data."""

MEASURES: dict[str, tuple[str, str, str, float]] = {
    "density": ("Density", "%", ".1f", 100),
    "disparity_median_abs_px": ("Disparity, median |error|", "px", ".3f", 1),
    "disparity_mae_px": ("Disparity, mean |error|", "px", ".3f", 1),
    "disparity_rmse_px": ("Disparity, RMSE", "px", ".3f", 1),
    "disparity_bias_px": ("Disparity, median signed", "px", "+.3f", 1),
    "bad_0.5px": ("Above 0.5\u00a0px", "%", ".1f", 100),
    "bad_1px": ("Above 1\u00a0px", "%", ".1f", 100),
    "bad_2px": ("Above 2\u00a0px", "%", ".1f", 100),
    "bad_4px": ("Above 4\u00a0px", "%", ".1f", 100),
    "disparity_a50_px": ("A50", "px", ".3f", 1),
    "disparity_a90_px": ("A90", "px", ".3f", 1),
    "disparity_a95_px": ("A95", "px", ".3f", 1),
    "disparity_a99_px": ("A99", "px", ".2f", 1),
    "range_median_abs_m": ("Range, median |error|", "mm", ".1f", 1000),
    "range_mae_m": ("Range, mean |error|", "mm", ".1f", 1000),
    "range_rmse_m": ("Range, RMSE", "mm", ".0f", 1000),
    "range_bias_m": ("Range, bias", "mm", "+.1f", 1000),
    "range_abs_rel": ("AbsRel", "%", ".2f", 100),
    "range_silog": ("SILog", "", ".4f", 1),
    "range_delta_1.05": ("δ < 1.05", "%", ".1f", 100),
    "range_delta_1.1": ("δ < 1.1", "%", ".1f", 100),
    "range_delta_1.25": ("δ < 1.25", "%", ".1f", 100),
    "wall_disparity_median_abs_px": ("Walls: disparity, median", "px", ".3f", 1),
    "wall_range_median_abs_m": ("Walls: range, median", "mm", ".1f", 1000),
    "floor_disparity_median_abs_px": ("Floor: disparity, median", "px", ".3f", 1),
    "floor_range_median_abs_m": ("Floor: range, median", "mm", ".1f", 1000),
    "solid_angle_density": ("Solid angle: density", "%", ".1f", 100),
    "solid_angle_disparity_median_abs_px": ("Solid angle: disparity, median", "px", ".3f", 1),
    "solid_angle_bad_1px": ("Solid angle: above 1\u00a0px", "%", ".1f", 100),
    "solid_angle_range_median_abs_m": ("Solid angle: range, median", "mm", ".1f", 1000),
    "solid_angle_range_rmse_m": ("Solid angle: range, RMSE", "mm", ".0f", 1000),
    "refined": ("Refined", "%", ".1f", 100),
}
"""Heading, unit, format and scale of the columns; figures that are not named here are in the data alone."""

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
    columns = [name for name in MEASURES if name in known]
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
        for name in columns:
            _, _, form, scale = MEASURES[name]
            span = spans[name] if name in _WITH_INTERVAL and np.isfinite(spans[name]).all() else None
            cells.append(number(float(means[name]), form, scale, span))
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
    head += [Heading("Seeds"), *(Heading(*MEASURES[name][:2]) for name in columns)]
    headings = [f"{name}{end}" for name in known for end in ("", "_ci95_low", "_ci95_high")]
    data = Data("measures", ["matcher", "subpixel", *keys, "seeds", *headings], plain)
    first = len(head) - len(columns)
    screen_only = tuple(first + i for i, name in enumerate(columns) if name not in _ON_PAPER)
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
