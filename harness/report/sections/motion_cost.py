"""The cost of estimating the motion: its errors, and the range errors with it and with the true motion."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.statistics import mean_over_seeds
from harness.report.data import Cell, Data, Heading, Table, count, interval, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Paragraph, TableBlock, section_of
from harness.report.sweep import Axis, Sweep

_SOURCE = "motion.source"
AUC_DEG = 1.0
"""The largest error that counts in the area under the recall, degrees."""

_WORDS = """
<p>In {{ estimated }} trial{{ "s" if estimated != 1 }} the matcher was given a motion that was estimated from the
images. What its errors do to ranges is {{ "%.2f" | format(z) }} times their predicted standard deviations, the root of
the mean square over trials. {% if ratio %}The median range error is {{ "%.3f" | format(ratio) }} {{ between }} times
that with the true motion, the geometric mean over the {{ pairs ~ " pairs" if pairs != 1 else "pair" }} of trials that
differ in nothing else.{% endif %}</p>
"""
_CAPTION = """
Errors of the estimated motion, medians over seeds, and what they cost. AUC: the area under the share of motions whose
rotation and direction are both within an angle, up to one degree; 100 % where all are exact. Predicted: the motion's
covariance propagated to the range, the median over pixels as a share of the range; measured: 1.4826 times the median of
what the errors of the motion do to exact matches. Error over σ: the root of the mean square, 1 where the covariance is
right and trials are many. Ratio: median |range error| with the estimated motion over that with the true one, trial by
trial{% if several %}, with 95 % intervals over seeds; the other figures have none{% else %}; one seed, so without an
interval{% endif %}.
"""


@section_of(About.ALL_TRIALS, "motion-cost", "What it costs to estimate the motion")
def section(context: Context) -> Iterator[Block]:
    """A sentence and a table; nothing where all motions were given."""
    table = _estimated(context.sweep)
    if table is None:
        return
    ratios = table["ratio"].dropna()
    z = float(np.sqrt(np.mean(table["motion_range_z"] ** 2)))
    ratio, ends = _mean_ratio(table)
    between = interval(ends, ".3f") if ends else "(one seed, without an interval)"
    yield Paragraph(html(_WORDS, estimated=len(table), z=z, ratio=ratio, between=between, pairs=len(ratios)))
    several = len(table["seed"].unique()) > 1
    yield TableBlock("table-motion-cost", _table(context.sweep, table), html(_CAPTION, several=several))


def _mean_ratio(trials: pd.DataFrame) -> tuple[float | None, tuple[float, float] | None]:
    """The geometric mean of the ratios with its 95 % interval over seeds; None where there is none."""
    table = trials.set_index("seed")[["ratio"]].dropna()
    if table.empty:
        return None, None
    curve = mean_over_seeds(table, logarithmic=True)
    low, high = float(curve.low[0]), float(curve.high[0])
    return float(curve.mean[0]), (low, high) if np.isfinite(low) else None


def _estimated(sweep: Sweep) -> pd.DataFrame | None:
    """The trials with an estimated motion, with their range error over that of the trial with the true one: `ratio`."""
    trials = sweep.trials
    if "motion_range_z" not in trials:
        return None
    trials = trials.astype({"motion_range_z": np.float64, "range_median_abs_m": np.float64})
    estimated = trials[trials["motion_range_z"].notna()]
    if estimated.empty:
        return None
    same = ["matcher", "subpixel", "seed", *(axis.key for axis in _other_axes(sweep))]
    true = trials[trials["motion_range_z"].isna()][[*same, "range_median_abs_m"]].drop_duplicates(same)
    joined = estimated.merge(true, on=same, how="left", suffixes=("", "_true"))
    return joined.assign(ratio=joined["range_median_abs_m"] / joined["range_median_abs_m_true"])


def area_under_recall(rotation_deg: Iterable[float], direction_deg: Iterable[float]) -> float:
    """The area under the share of motions whose larger error is within an angle, from 0 to `AUC_DEG`, as a share."""
    larger = np.maximum(np.asarray(rotation_deg, dtype=np.float64), np.asarray(direction_deg, dtype=np.float64))
    return float(np.mean(np.clip(1 - larger / AUC_DEG, 0, 1)))


def _other_axes(sweep: Sweep) -> list[Axis]:
    return [axis for axis in sweep.axes if axis.key != _SOURCE]


def _table(sweep: Sweep, trials: pd.DataFrame) -> Table:
    axes = _other_axes(sweep)
    keys = [axis.key for axis in axes]
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for method in sweep.methods:
        mine = method.of(trials)
        for indices, part in mine.groupby(keys, sort=True) if keys else [((), mine)]:
            if part.empty:
                continue
            texts = [axis.texts[i] for axis, i in zip(axes, indices, strict=True)]
            values = [
                float(part["motion_rotation_deg"].median()),
                float(part["motion_direction_deg"].median()),
                area_under_recall(part["motion_rotation_deg"], part["motion_direction_deg"]),
                float(part["motion_range_predicted"].median()),
                float(part["motion_range_measured"].median()),
                float(np.sqrt(np.mean(part["motion_range_z"] ** 2))),
            ]
            ratio, ends = _mean_ratio(part)
            shown = zip(values, (".4f", ".4f", ".1f", ".3f", ".3f", ".2f"), (1, 1, 100, 100, 100, 1), strict=True)
            cells = [number(value, form, scale) for value, form, scale in shown]
            cells.append(number(ratio, ".3f", between=ends))
            values += [np.nan if each is None else each for each in (ratio, *(ends or (None, None)))]
            rows.append([words(method.label, method.colour), *map(words, texts), count(len(part)), *cells])
            plain.append([method.label, *texts, len(part), *values])
    head = [Heading("Method", text=True), *(Heading(axis.label, text=True) for axis in axes), Heading("Seeds")]
    head += [
        Heading("Rotation", "°"),
        Heading("Direction of t", "°"),
        Heading(f"AUC at {AUC_DEG:g}°", "%"),
        Heading("Range, predicted σ", "%"),
        Heading("Range, measured", "%"),
        Heading("Error over σ"),
        Heading("Range, ratio"),
    ]
    names = ["rotation_deg", "direction_deg", "auc", "predicted_share", "measured_share", "error_over_sigma"]
    names += ["ratio", "ratio_ci95_low", "ratio_ci95_high"]
    return Table(head, rows, Data("motion-cost", ["method", *keys, "seeds", *names], plain))
