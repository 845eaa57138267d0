"""The main figures of every named case, for `summary.json`, the terminal and the report."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.metric_table import METRICS
from harness.evaluation.metrics import CORE
from harness.evaluation.statistics import mean_over_seeds
from harness.runs.cases import CASE, NAME, settings_of
from harness.runs.experiment import Experiment, Planned
from harness.runs.methods import MethodName

FIGURES = ("density", *CORE)
"""The metrics of a case."""


def figures_of_cases(experiment: Experiment, done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `cases` of `summary.json`: a line for each case and method, in the experiment's order; empty without cases.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them.

    Returns
    -------
    list of dict
        `case`, its `settings`, `matcher`, `subpixel`, `trials`, `seeds`, and each of `FIGURES` as a mean over the
        case's trials, a geometric one for medians of errors: all axes and seeds count alike. A name with
        `_ci95` is the 95 % interval by bootstrap over seeds, None from one seed.
    """
    settings = {case.get(NAME): settings_of(case) for case in experiment.cases}
    groups: dict[tuple[str, MethodName], list[tuple[int, dict[str, Any]]]] = {}
    for planned, payload in done:
        name = planned.coordinates.get(CASE)
        if name in settings and name is not None:
            groups.setdefault((name, planned.method), []).append((planned.trial.seed, payload["figures"]))
    order = {name: number for number, name in enumerate(settings)}
    return [
        {
            "case": name,
            "settings": settings[name],
            "matcher": matcher,
            "subpixel": subpixel,
            "trials": len(trials),
            "seeds": len({seed for seed, _ in trials}),
            **_means(trials),
        }
        for (name, (matcher, subpixel)), trials in sorted(groups.items(), key=lambda each: order[each[0][0]])
    ]


def _means(trials: list[tuple[int, dict[str, Any]]]) -> dict[str, Any]:
    seeds = pd.Index([seed for seed, _ in trials], name="seed")
    means: dict[str, Any] = {}
    for name in FIGURES:
        values = [math.nan if (value := figures.get(name)) is None else value for _, figures in trials]
        table = pd.DataFrame({name: np.array(values, dtype=np.float64)}, index=seeds)
        curve = mean_over_seeds(table, logarithmic=METRICS[name].geometric)
        mean, ends = float(curve.mean[0]), (float(curve.low[0]), float(curve.high[0]))
        means[name] = mean if math.isfinite(mean) else None
        means[f"{name}_ci95"] = list(ends) if np.isfinite(ends).all() else None
    return means
