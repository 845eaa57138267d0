"""Conclusions from a sweep, in sentences that claim no more than their intervals allow."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.evaluation.law import LEAST_R2
from harness.evaluation.statistics import FEW_SEEDS, balanced, mean_over_seeds
from harness.runs.cases import CASE
from harness.runs.methods import METHOD_KEYS, MethodName, in_words
from harness.runs.values import identity_of, shown, text_of

if TYPE_CHECKING:
    from harness.runs.run import Row

FIGURES = (("wall", "wall_range_median_abs_m"), ("all", "range_median_abs_m"))
"""Median |range error| of walls, where square windows fit; of everything where there are no walls."""
_LEAST = 0.02
"""Least relative difference that is worth a sentence, however certain: 2 %."""


def conclusions(
    rows: Sequence["Row"],
    law: dict[str, Any] | None,
    labels: Mapping[MethodName, str] | None = None,
    further: Sequence[str] = (),
) -> list[str]:
    """A sentence about the methods, one for each axis, and one for each slope of the law.

    Each is about the median range error on walls (on all pixels where there are none), averaged as logarithms over
    seeds; ratios are between trials that are alike but for what is compared, with 95 % intervals over seeds. Empty
    where nothing varies, or there is one seed.

    Parameters
    ----------
    rows
        The trials that are done.
    law
        The test of the law, if there is one.
    labels
        The names that cases give to methods.
    further
        Sentences on what else the trials were scored by, such as warped views.
    """
    table, axes = table_of(rows, labels or {})
    measured = [(part, name) for part, name in FIGURES if not table.empty and (table[name] > 0).any()]
    if not measured or table["seed"].nunique() < 2:  # without an error, or an interval, there is nothing to conclude
        return []
    part, figure = measured[0]
    where = "on walls" if part == "wall" else "over all pixels"
    best = _best_method(table, axes, figure)
    sentences = list(_about_methods(table, axes, figure, where))
    of_best = table[table["method"] == best]
    for key in axes:
        sentences += _about_axis(of_best, key, axes, figure, f"{best}, {where}")
    sentences += _about_law(law, labels or {})
    sentences += further
    seeds = table["seed"].nunique()
    if sentences and seeds < FEW_SEEDS:
        sentences.append(f"Intervals are over {seeds} seeds, and come out too short.")
    return sentences


def table_of(rows: Sequence["Row"], labels: Mapping[MethodName, str]) -> tuple[pd.DataFrame, dict[str, list[Any]]]:
    """A table of trials with method, seed, figures and the index of the value on each axis; and the axes' values."""
    not_axes = ("seed", *METHOD_KEYS, *([CASE] if labels else []))
    known: dict[str, dict[str, Any]] = {}
    for row in rows:
        for key, value in row.coordinates.items():
            if key not in not_axes:
                known.setdefault(key, {}).setdefault(identity_of(key, value), value)
    axes = {key: list(values.values()) for key, values in known.items() if len(values) > 1}
    index = {key: {identity: i for i, identity in enumerate(known[key])} for key in axes}
    records = []
    for row in rows:
        figures = row.payload["figures"]
        records.append(
            {"method": in_words(row.planned.method, labels), "seed": row.planned.trial.seed}
            | {key: of_key[identity_of(key, row.coordinates[key])] for key, of_key in index.items()}
            | {name: math.nan if figures.get(name) is None else figures[name] for _, name in FIGURES}
        )
    return pd.DataFrame(records), axes


def _pivot(table: pd.DataFrame, columns: str, axes: dict[str, list[Any]], figure: str) -> pd.DataFrame:
    """Groups of trials alike but for `columns`; seeds first, and only groups that have every value where any has."""
    others = [key for key in axes if key != columns] + (["method"] if columns != "method" else [])
    pivot = table.pivot_table(index=["seed", *others], columns=columns, values=figure, aggfunc="mean", dropna=False)
    positive = pivot.where(pivot > 0)  # only these have a logarithm
    return balanced(positive.dropna(how="all").dropna(axis=1, how="all"))


def _best_method(table: pd.DataFrame, axes: dict[str, list[Any]], figure: str) -> str:
    pivot = _pivot(table, "method", axes, figure)
    means = mean_over_seeds(pivot, logarithmic=True)
    return str(means.x[int(np.nanargmin(means.mean))])


def _ratio(pivot: pd.DataFrame, above: Any, below: Any) -> tuple[float, float, float]:
    """The ratio of one column's values to another's, with its interval."""
    curve = mean_over_seeds((pivot[above] / pivot[below]).to_frame(), logarithmic=True)
    return float(curve.mean[0]), float(curve.low[0]), float(curve.high[0])


def _about_methods(table: pd.DataFrame, axes: dict[str, list[Any]], figure: str, where: str) -> Iterator[str]:
    pivot = _pivot(table, "method", axes, figure)
    if pivot.shape[1] < 2:
        return
    if pivot.isna().any(axis=None):
        yield "No setting has a range error from every method: they are not compared."
        return
    curve = mean_over_seeds(pivot, logarithmic=True)
    order = np.argsort(curve.mean)
    first, second = (curve.x[int(i)] for i in order[:2])
    ratio = _ratio(pivot, first, second)
    if not _has_interval(ratio):
        return
    error = f"{length(curve.mean[order[0]])} {where}" + (", averaged over settings" if axes else "")
    if _differs(ratio):
        yield f"{first} has the smallest median range error, {error}: {_times(ratio)} that of {second}, the next."
    else:
        yield f"{first} and {second} have the smallest median range errors, {error}, and alike ({_times(ratio)})."


def _about_axis(table: pd.DataFrame, key: str, axes: dict[str, list[Any]], figure: str, who: str) -> Iterator[str]:
    """A sentence on the change of the error along an axis, from its smallest to its largest mean."""
    pivot = _pivot(table, key, axes, figure)
    if pivot.shape[1] < 2 or pivot.isna().any(axis=None):  # settings that change together
        return
    curve = mean_over_seeds(pivot, logarithmic=True)
    least, most = int(np.argmin(curve.mean)), int(np.argmax(curve.mean))
    ratio = _ratio(pivot, curve.x[most], curve.x[least])
    if not _has_interval(ratio):
        return
    values = [axes[key][int(i)] for i in curve.x]  # type: ignore[call-overload]
    if not _differs(ratio):
        sure = ratio[1] > 1
        says = (
            "changes the median range error by less than 2 %" if sure else "makes no difference that these seeds show"
        )
        yield f"{key} {says} ({who}: at most {_times(ratio)})."
        return
    low, high = (f"{length(curve.mean[i])} at {value_text(values[i])}" for i in (least, most))
    yield f"{key}: the median range error ({who}) is {low}, and {_times(ratio)} that, {high}."


def _about_law(law: dict[str, Any] | None, labels: Mapping[MethodName, str]) -> Iterator[str]:
    if law is None:
        return
    for fit in law["images"]:
        slope, ends = fit["slope"], fit["slope_ci95"]
        if fit["law"] != "exact" or slope is None or fit["surface"] != "wall":
            continue
        method = in_words((fit["matcher"], fit["subpixel"]), labels)
        interval = f"{slope:.2f} [{ends[0]:.2f}, {ends[1]:.2f}]" if ends and None not in ends else f"{slope:.2f}"
        if fit["r2"] is not None and fit["r2"] < LEAST_R2:
            yield f"The law, {method} on walls: none to be seen (slope {interval}, R² {fit['r2']:.2f})."
        else:
            verdict = f"the error grows as its power {interval}, R² {fit['r2']:.2f}; 1 is the law."
            yield f"The law, {method} on walls: {verdict}"


def _has_interval(ratio: tuple[float, float, float]) -> bool:
    """False where trials that are alike but for one thing are of one seed, or there are none."""
    return all(math.isfinite(each) for each in ratio)


def _differs(ratio: tuple[float, float, float]) -> bool:
    mean, low, high = ratio
    return bool((low > 1 or high < 1) and abs(math.log(mean)) > _LEAST)


def _times(ratio: tuple[float, float, float]) -> str:
    mean, low, high = ratio
    return f"{mean:.3g} [{low:.3g}, {high:.3g}] times"


def length(metres: float) -> str:
    """A length in millimetres, from a metre on in metres."""
    return f"{metres:.3g} m" if metres >= 0.9995 else f"{1000 * metres:.3g} mm"


def value_text(value: Any) -> str:
    """A value of an axis."""
    return f"{value:g}" if isinstance(value, float) else text_of(value) if not isinstance(value, dict) else shown(value)
