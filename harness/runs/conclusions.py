"""Conclusions from a sweep, in sentences that claim no more than their intervals allow."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.display import listed
from harness.evaluation.statistics import FEW_SEEDS, balanced, mean_over_seeds
from harness.runs.cases import CASE
from harness.runs.key_names import name_and_unit
from harness.runs.methods import METHOD_KEYS, MethodName, in_words
from harness.runs.values import identity_of, shown, text_of

if TYPE_CHECKING:
    from harness.runs.run import Row

FIGURES = (("wall", "wall_range_median_abs_m"), ("all", "range_median_abs_m"))
"""Median |range error| of walls, where square windows fit; of everything where there are no walls."""
_MOST = 3
"""Sentences that a first screen has room for, beside the headline and its picture."""
_FEW = "Intervals are over"
_LEAST = 0.02
"""Least relative difference that is worth a sentence, however certain: 2 %."""


def conclusions(
    rows: Sequence["Row"],
    names: Mapping[MethodName, str] = MappingProxyType({}),
    further: Sequence[str] = (),
    *,
    named_by_cases: bool = False,
) -> list[str]:
    """Sentences on the trials' further scores, on the methods, and on each axis that matters.

    Each is about the median range error on walls (on all pixels where there are none), averaged as logarithms over
    seeds; ratios are between trials that differ only in the compared setting, with 95 % intervals over seeds. Empty
    where nothing varies, or there is one seed.

    Parameters
    ----------
    rows
        The trials that are done.
    names
        The names of methods.
    further
        Sentences on what else the trials were scored by, such as warped views.
    named_by_cases
        Whether the names are those of cases.
    """
    table, axes = table_of(rows, names, named_by_cases=named_by_cases)
    what = measured(table)
    if what is None or table["seed"].nunique() < 2:  # without an error, or an interval, there is nothing to conclude
        return []
    where, figure = what
    best = best_method(table, axes, figure)
    sentences = [*further, *_about_methods(table, axes, figure, where)]
    of_best = table[table["method"] == best]
    compared = [each for key in axes if (each := _along(of_best, key, axes, figure)) is not None]
    sentences += _about_axes(compared, f"{best}, {where}")
    seeds = table["seed"].nunique()
    if sentences and seeds < FEW_SEEDS:
        sentences.append(f"{_FEW} {seeds} seeds, and come out too short.")
    return sentences


def leading(sentences: Sequence[str]) -> tuple[list[str], list[str]]:
    """The sentences that a first screen has room for, with the warning of few seeds, and the others."""
    warning = [each for each in sentences if each.startswith(_FEW)]
    said = [each for each in sentences if each not in warning]
    return said[:_MOST] + warning, said[_MOST:]


def measured(table: pd.DataFrame) -> tuple[str, str] | None:
    """Where errors are compared, in words, and the figure's name; None where there is no error."""
    known = [(part, name) for part, name in FIGURES if not table.empty and (table[name] > 0).any()]
    if not known:
        return None
    part, name = known[0]
    return ("on walls" if part == "wall" else "over all pixels"), name


def about_axis(table: pd.DataFrame, key: str, axes: dict[str, list[Any]], figure: tuple[str, str]) -> str | None:
    """How much the error of the best method differs along an axis, if it does; None where there is no interval.

    Parameters
    ----------
    figure
        See `measured`.
    """
    where, name = figure
    best = best_method(table, axes, name)
    along = _along(table[table["method"] == best], key, axes, name)
    return next(_about_axes([along], f"{best}, {where}")) if along else None


def table_of(
    rows: Sequence["Row"], names: Mapping[MethodName, str], *, named_by_cases: bool
) -> tuple[pd.DataFrame, dict[str, list[Any]]]:
    """A table of trials with method, seed, figures and the index of the value on each axis; and the axes' values."""
    not_axes = ("seed", *METHOD_KEYS, *([CASE] if named_by_cases else []))
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
            {"method": in_words(row.planned.method, names), "seed": row.planned.trial.seed}
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


def best_method(table: pd.DataFrame, axes: dict[str, list[Any]], figure: str) -> str:
    """The method with the smallest mean of a figure over alike trials."""
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


@dataclass(frozen=True)
class _Along:
    """How the error changes along an axis: from its smallest to its largest mean."""

    key: str
    ratio: tuple[float, float, float]
    """The largest over the smallest, with its interval."""
    ends: tuple[str, str]
    """The smallest and the largest, in words."""


def _along(table: pd.DataFrame, key: str, axes: dict[str, list[Any]], figure: str) -> _Along | None:
    """None where settings change together, or there is no interval."""
    pivot = _pivot(table, key, axes, figure)
    if pivot.shape[1] < 2 or pivot.isna().any(axis=None):
        return None
    curve = mean_over_seeds(pivot, logarithmic=True)
    least, most = int(np.argmin(curve.mean)), int(np.argmax(curve.mean))
    ratio = _ratio(pivot, curve.x[most], curve.x[least])
    if not _has_interval(ratio):
        return None
    values = [axes[key][int(i)] for i in curve.x]  # type: ignore[call-overload]
    low, high = (f"{length(curve.mean[i])} at {_measure(key, values[i])}" for i in (least, most))
    return _Along(key, ratio, (low, high))


def _about_axes(compared: Sequence[_Along], who: str) -> Iterator[str]:
    """A sentence for each axis that matters, the one that matters most first, and one for all that do not."""
    differing = [each for each in compared if _differs(each.ratio)]
    for each in sorted(differing, key=lambda each: -abs(math.log(each.ratio[0]))):
        low, high = each.ends
        name = name_and_unit(each.key)[0]
        yield f"{name}: the median range error ({who}) is {low}, and {_times(each.ratio)} that, {high}."
    alike = [each for each in compared if each not in differing]
    small = [each for each in alike if each.ratio[1] > 1]  # sure, but small
    unsure = [each for each in alike if each not in small]
    if small:
        yield (
            f"{_names(small)} {'change' if len(small) > 1 else 'changes'} the median range "
            f"error by less than 2 % ({who}: {_at_most(small)})."
        )
    if unsure:
        yield (
            f"{_names(unsure)} {'make' if len(unsure) > 1 else 'makes'} no difference that "
            f"these seeds show ({who}: {_at_most(unsure)})."
        )


def _names(compared: Sequence[_Along]) -> str:
    return listed([name_and_unit(each.key)[0] for each in compared])


def _at_most(compared: Sequence[_Along]) -> str:
    return f"at most {listed([_times(each.ratio) for each in compared])}"


def _has_interval(ratio: tuple[float, float, float]) -> bool:
    """Whether a ratio has an interval: not if its trials have one seed, or if there are none."""
    return all(math.isfinite(each) for each in ratio)


def _differs(ratio: tuple[float, float, float]) -> bool:
    mean, low, high = ratio
    return bool((low > 1 or high < 1) and abs(math.log(mean)) > _LEAST)


def _times(ratio: tuple[float, float, float]) -> str:
    mean, low, high = ratio
    if math.isclose(low, high, rel_tol=1e-9):  # the seeds change nothing, and say nothing
        return f"with every seed {mean:.3g} times"
    return f"{mean:.3g} [{low:.3g}, {high:.3g}] times"


def length(metres: float) -> str:
    """A length in millimetres, from a metre on in metres."""
    return f"{metres:.3g} m" if metres >= 0.9995 else f"{1000 * metres:.3g} mm"


def said_of(key: str, value: Any) -> str:
    """A key's name with its value in a sentence: a case is called by its name alone."""
    return _quoted(value_text(value)) if key == CASE else f"{name_and_unit(key)[0]} = {_measure(key, value)}"


def _measure(key: str, value: Any) -> str:
    """A value with the unit that its key has for people."""
    return f"{_quoted(value_text(value))} {name_and_unit(key)[1]}".rstrip()


def _quoted(text: str) -> str:
    """Text in a sentence: in quotes where it has a comma of its own, unless brackets hold it together."""
    return f"“{text}”" if ", " in text and not text.startswith(("[", "{")) else text


def value_text(value: Any) -> str:
    """A value of an axis."""
    if isinstance(value, list) and all(isinstance(each, int | float) for each in value):
        return " × ".join(f"{each:g}" for each in value)
    return f"{value:g}" if isinstance(value, float) else text_of(value) if not isinstance(value, dict) else shown(value)
