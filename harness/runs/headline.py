"""The main result of a sweep in one sentence, which heads its report and the terminal's summary."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.display import listed
from harness.evaluation.law import NO_LAW, slope_verdict
from harness.evaluation.statistics import balanced, mean_over_seeds
from harness.runs.conclusions import about_axis, best_method, length, measured, said_of, table_of
from harness.runs.key_names import name_and_unit
from harness.runs.methods import MethodName, in_words

BASELINE = "view_2.baseline_m"
_CONDITIONS = (
    "scene", "view_1", "view_2", "placement", "render", "optics", "optics_2", "exposure_2", "noise", "chip", "motion",
    "believed",
)  # fmt: skip
"""Tables of a trial that say under what conditions ranges are estimated. All others, and the baseline, are choices."""

if TYPE_CHECKING:
    from harness.runs.run import Row


def is_choice(key: str) -> bool:
    """Whether a key is what somebody who builds or tunes a system chooses, rather than a condition that it meets."""
    return key == BASELINE or (key.split(".", maxsplit=1)[0] not in _CONDITIONS and ".misalignment." not in key)


@dataclass(frozen=True)
class Findings:
    """Parts of the summary that a sweep may be about; see `summary.json`."""

    law: dict[str, Any] | None = None
    best_baseline: Sequence[dict[str, Any]] = ()
    limit: Sequence[dict[str, Any]] = ()
    budget: Sequence[dict[str, Any]] = ()
    further: Sequence[str] = ()
    """Sentences on what trials were scored by beside their ranges, see `further_scores`."""


def headline(
    rows: Sequence["Row"],
    found: Findings | None = None,
    names: Mapping[MethodName, str] = MappingProxyType({}),
    *,
    named_by_cases: bool = False,
) -> str | None:
    """The sentence, about what the sweep was made for; None where nothing varies.

    That is the law where it was tested, scores beside the ranges, the spread against the bound, the budget of errors,
    the best baseline where that alone varies, or the first axis of the experiment where that is a condition, such as
    noise: what it costs. Else it is the best choice of method and settings.

    The median range error is that on walls (over all pixels where there are none), averaged as logarithms over seeds
    and conditions, with its 95 % interval; of one seed, the sentence says that it has none.

    Parameters
    ----------
    rows
        The trials that are done.
    names
        The names of methods.
    named_by_cases
        Whether they are those of cases.
    """
    found = found or Findings()
    table, axes = table_of(rows, names, named_by_cases=named_by_cases)
    return (
        _of_the_law(found.law, names)
        or (_of_further_scores(found.further, table, axes) if found.further else None)
        or _of_the_limit(found.limit, names)
        or _of_the_budget(found.budget, names)
        or _of_the_baseline(table, axes, found.best_baseline, names)
        # Where cases name methods, a choice among these is meant, whatever the conditions.
        or (None if named_by_cases else _of_the_condition(table, axes))
        or _of_the_best(table, axes)
    )


def _of_the_law(law: dict[str, Any] | None, names: Mapping[MethodName, str]) -> str | None:
    fits = [
        fit
        for fit in (law or {"images": []})["images"]
        if (fit["law"], fit["surface"]) == ("exact", "wall") and fit["slope"] is not None and fit["slope_ci95"]
    ]
    if not fits:
        return None
    lawful = [fit for fit in fits if slope_verdict(fit) != NO_LAW]
    none = [in_words((fit["matcher"], fit["subpixel"]), names) for fit in fits if fit not in lawful]
    sentences = []
    if lawful:
        powers = "; ".join(_power(fit, names) for fit in lawful)
        sentences.append(f"on walls the range error grows as this power of the law, which says 1: {powers}")
    if none:
        sentences.append(f"no law to be seen ({listed(none)})")
    text = "; ".join(sentences)
    return f"{text[0].upper()}{text[1:]}."


def _power(fit: dict[str, Any], names: Mapping[MethodName, str]) -> str:
    low, high = fit["slope_ci95"]
    return f"{fit['slope']:.2f} [{low:.2f}, {high:.2f}] ({in_words((fit['matcher'], fit['subpixel']), names)})"


def _of_further_scores(further: Sequence[str], table: pd.DataFrame, axes: dict[str, list[Any]]) -> str:
    """The sentence on the method whose ranges are best, or else the first sentence."""
    figure = measured(table)
    best = best_method(table, axes, figure[1]) if figure else ""
    return next((each for each in further if best and (f"({best})" in each or f" {best}:" in each)), further[0])


def _of_the_limit(limit: Sequence[dict[str, Any]], names: Mapping[MethodName, str]) -> str | None:
    """A sentence on the method whose spread is nearest to the bound."""
    known = [each for each in limit if each["std_over_bound"] is not None]
    if not known:
        return None
    nearest = min(known, key=lambda each: float(each["std_over_bound"]))
    mine = [each for each in known if all(each[key] == nearest[key] for key in ("matcher", "subpixel", "condition"))]
    ratios, noises = ([each[key] for each in mine] for key in ("std_over_bound", "noise_grey"))
    quartiles = [end for each in mine for end in each["std_over_bound_quartiles"]]
    method = in_words((nearest["matcher"], nearest["subpixel"]), names)
    return (
        f"Over {nearest['seeds']} draws of the noise, errors of {method} spread {_from_to(ratios, '.2f')} times as far "
        f"as the Cramér-Rao bound of its window, at noise of {_from_to(noises, 'g')} grey levels (medians over pixels; "
        f"their quartiles are within {_from_to(quartiles, '.2f')})."
    )


def _of_the_budget(budget: Sequence[dict[str, Any]], names: Mapping[MethodName, str]) -> str | None:
    """How large the errors of all causes together are, near and far, and which cause makes the most of them."""
    if not budget:
        return None
    most = max(budget, key=lambda each: len(each["causes"]))
    mine = [each for each in budget if all(each[key] == most[key] for key in ("matcher", "subpixel", "condition"))]
    most_seeds = max(each["seeds"] for each in mine)  # ranges that only some seeds have are of few pixels
    mine = sorted((each for each in mine if each["seeds"] == most_seeds), key=lambda each: float(each["range_m"]))
    parts = []
    for each in dict.fromkeys((0, len(mine) - 1)):
        entry = mine[each]
        ends = entry["measured_ci95_m"]
        between = f" [{1000 * ends[0]:.3g}, {1000 * ends[1]:.3g}]" if ends else ""
        without = "" if ends else " (one seed, no interval)"
        cause = max(entry["predicted_m"], key=lambda name: float(entry["predicted_m"][name]))
        error = f"{1000 * entry['measured_m']:.3g}{between} mm{without}"
        parts.append(f"{error} at {entry['range_m']:.1f} m, most of it by {cause}")
    method = in_words((most["matcher"], most["subpixel"]), names)
    return f"With all causes together, 68 % of the errors of {method} are within {'; '.join(parts)}."


def _from_to(values: Sequence[float], form: str) -> str:
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return low if low == high else f"{low} to {high}"


def _of_the_baseline(
    table: pd.DataFrame,
    axes: dict[str, list[Any]],
    best: Sequence[dict[str, Any]],
    names: Mapping[MethodName, str],
) -> str | None:
    """The best baseline for each range on walls by the method whose errors are smallest, where nothing else varies."""
    walls = [each for each in best if each["surface"] == "wall"]
    if list(axes) != [BASELINE] or not walls:
        return None
    method = best_method(table, axes, "wall_range_median_abs_m")
    mine = [each for each in walls if in_words((each["matcher"], each["subpixel"]), names) == method]
    ranges: dict[float, list[dict[str, Any]]] = {}
    for each in sorted(mine, key=lambda each: each["range_m"]):
        ranges.setdefault(each["baseline_m"], []).append(each)
    parts = [f"{baseline_m:.3g}{_interval_of(of_it)} at {_span(of_it)}" for baseline_m, of_it in ranges.items()]
    return f"The best baseline on walls ({method}): {'; '.join(parts)}." if parts else None


def _interval_of(best: Sequence[dict[str, Any]]) -> str:
    """The ends of all their intervals."""
    ends = [each["baseline_m_ci95"] for each in best]
    if None in ends:
        return " m (one seed, no interval)"
    return f" [{min(low for low, _ in ends):.3g}, {max(high for _, high in ends):.3g}] m"


def _span(best: Sequence[dict[str, Any]]) -> str:
    """The ranges of the entries in words."""
    first, last = f"{best[0]['range_m']:.1f}", f"{best[-1]['range_m']:.1f}"
    return f"a range of {first} m" if first == last else f"ranges of {first} to {last} m"


def _of_the_condition(table: pd.DataFrame, axes: dict[str, list[Any]]) -> str | None:
    """A sentence on the effect of the first axis other than scenes, if that is no choice; None without an interval."""
    figure = measured(table)
    subject = next((key for key in axes if key != "scene"), None)
    if figure is None or subject is None or is_choice(subject):
        return None
    return about_axis(table, subject, axes, figure)


def _of_the_best(table: pd.DataFrame, axes: dict[str, list[Any]]) -> str | None:
    """The best of the choices, method included, beside the middle one, averaged over conditions."""
    figure = measured(table)
    if figure is None:
        return None
    where, name = figure
    chosen = [key for key in axes if is_choice(key)]
    conditions = [key for key in axes if key not in chosen]
    if not chosen and table["method"].nunique() < 2:
        chosen, conditions = list(axes), []  # nothing is chosen: the mildest conditions
    table = table.copy()
    table["setting"], settings = pd.factorize(pd.MultiIndex.from_frame(table[["method", *chosen]]))
    positive = table[table[name] > 0]  # only these have a logarithm
    pivot = balanced(positive.pivot_table(index=["seed", *conditions], columns="setting", values=name))
    if pivot.shape[1] < 2:
        return None
    curve = mean_over_seeds(pivot, logarithmic=True)
    best = int(np.nanargmin(curve.mean))
    method, *indices = settings[pivot.columns[best]]
    values = [said_of(key, axes[key][int(i)]) for key, i in zip(chosen, indices, strict=True)]
    several = len(set(table["method"])) > 1
    who = " with ".join(filter(None, [method if several or not values else "", ", ".join(values)]))
    low, high = curve.low[best], curve.high[best]
    scale, unit = (1.0, "m") if curve.mean[best] >= 0.9995 else (1000.0, "mm")
    between, without = f" [{scale * low:.3g}, {scale * high:.3g}]", ""
    if not math.isfinite(low):
        between, without = "", " (one seed, no interval)"
    elif math.isclose(low, high, rel_tol=1e-9):
        between, without = "", " (the same with every seed)"
    over = f", averaged over {listed([name_and_unit(key)[0] for key in conditions])}," if conditions else ""
    which = "settings" if chosen else "methods"
    return (
        f"Best of {pivot.shape[1]} {which}: {who}. Its median range error {where}{over} is "
        f"{scale * curve.mean[best]:.3g}{between} {unit}{without}; the median over the {which} is "
        f"{length(float(np.nanmedian(curve.mean)))}."
    )
