"""The main result of a sweep in one sentence, which heads its report and the terminal's summary."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.evaluation.law import NO_LAW, slope_verdict
from harness.evaluation.statistics import balanced, mean_over_seeds
from harness.runs.conclusions import FIGURES, length, table_of, value_text
from harness.runs.methods import MethodName, in_words

if TYPE_CHECKING:
    from harness.runs.run import Row


def headline(
    rows: Sequence["Row"], law: dict[str, Any] | None, labels: Mapping[MethodName, str] | None = None
) -> str | None:
    """The sentence: about the law where it was tested, else about the best setting; None where nothing varies.

    The median range error is that on walls (over all pixels where there are none), averaged as logarithms over seeds,
    with its 95 % interval; of one seed, the sentence says that it has none.

    Parameters
    ----------
    rows
        The trials that are done.
    law
        The test of the law, if there is one.
    labels
        The names that cases give to methods.
    """
    return _of_the_law(law, labels or {}) or _of_the_best(rows, labels or {})


def _of_the_law(law: dict[str, Any] | None, labels: Mapping[MethodName, str]) -> str | None:
    fits = [
        fit
        for fit in (law or {"images": []})["images"]
        if (fit["law"], fit["surface"]) == ("exact", "wall") and fit["slope"] is not None and fit["slope_ci95"]
    ]
    if not fits:
        return None
    lawful = [fit for fit in fits if slope_verdict(fit) != NO_LAW]
    none = [in_words((fit["matcher"], fit["subpixel"]), labels) for fit in fits if fit not in lawful]
    sentences = []
    if lawful:
        powers = "; ".join(_power(fit, labels) for fit in lawful)
        sentences.append(f"on walls the range error grows as this power of the law, which says 1: {powers}")
    if none:
        sentences.append(f"no law to be seen with {' and '.join(none)}")
    text = "; ".join(sentences)
    return f"{text[0].upper()}{text[1:]}."


def _power(fit: dict[str, Any], labels: Mapping[MethodName, str]) -> str:
    low, high = fit["slope_ci95"]
    return f"{fit['slope']:.2f} [{low:.2f}, {high:.2f}] with {in_words((fit['matcher'], fit['subpixel']), labels)}"


def _of_the_best(rows: Sequence["Row"], labels: Mapping[MethodName, str]) -> str | None:
    """The combination of method and settings with the smallest error, beside the middle one."""
    table, axes = table_of(rows, labels)
    measured = [(part, name) for part, name in FIGURES if not table.empty and (table[name] > 0).any()]
    if not measured:
        return None
    part, figure = measured[0]
    table["setting"], settings = pd.factorize(pd.MultiIndex.from_frame(table[["method", *axes]]))
    positive = table[table[figure] > 0]  # only these have a logarithm
    pivot = balanced(positive.pivot_table(index="seed", columns="setting", values=figure))
    if pivot.shape[1] < 2:
        return None
    curve = mean_over_seeds(pivot, logarithmic=True)
    best = int(np.nanargmin(curve.mean))
    method, *indices = settings[pivot.columns[best]]
    values = [f"{key} = {value_text(axes[key][int(i)])}" for key, i in zip(axes, indices, strict=True)]
    several = len(set(table["method"])) > 1
    who = " with ".join(filter(None, [method if several or not values else "", ", ".join(values)]))
    where = "on walls" if part == "wall" else "over all pixels"
    low, high = curve.low[best], curve.high[best]
    scale, unit = (1.0, "m") if curve.mean[best] >= 0.9995 else (1000.0, "mm")
    middle = length(float(np.nanmedian(curve.mean)))
    between = f" [{scale * low:.3g}, {scale * high:.3g}]" if math.isfinite(low) else ""
    without = "" if between else " (one seed, no interval)"
    return (
        f"Best of {pivot.shape[1]} settings: {who}, at a median range error of "
        f"{scale * curve.mean[best]:.3g}{between} {unit}{without} {where}; half of the settings "
        f"have more than {middle}."
    )
