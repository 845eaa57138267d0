"""The error budgets of a run's trials, over seeds: predicted beside measured, causes alone and together."""

from collections.abc import Callable, Iterable
from typing import Any, Literal

import numpy as np

from harness.evaluation.regions import middle_of_alpha, middle_of_range
from harness.evaluation.statistics import SHARE, between, resampled
from harness.geometry.angles import Array
from harness.pipeline.error_budget import Z_EDGES
from harness.runs.cases import CASE
from harness.runs.experiment import Planned

OWN = "matching"
"""The cause that every trial has: the matcher, with the images' noise."""


_OVER: dict[str, tuple[str, Callable[[int], float]]] = {
    "range_bin": ("range_m", middle_of_range),
    "alpha_bin": ("alpha_1_deg", middle_of_alpha),
}
"""The quantities by which pixels are binned: the name of the bin's middle, and its value from the bin's number."""


def budget_of(
    done: Iterable[tuple[Planned, dict[str, Any]]], over: Literal["range_bin", "alpha_bin"] = "range_bin"
) -> list[dict[str, Any]]:
    """The `budget` of `summary.json`: for each method, condition and range, predicted and measured errors.

    Its `budget_by_direction` has the same over alpha_1, the angle to the baseline.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them; those without a budget are left out.
    over
        By what pixels are binned: range or direction.

    Returns
    -------
    list of dict
        `matcher`, `subpixel`, `condition`, `case` (its name; None without cases), `causes` (those beside the matcher's
        own), `seeds`, `range_m` or `alpha_1_deg` (the middle of a bin), `predicted_m` by cause, `total_m`, `measured_m`
        with `measured_ci95_m` (bootstrap over seeds), all errors that 68.3 % of the pixels stay within; `over_drawn`,
        what was measured over what follows from the very draws of these seeds, with its interval: 1 where the
        propagation is right, however few the seeds; and where there are trials with each of the causes alone
        `alone_m`, the root of the sum of their squares.
    """
    groups: dict[tuple[str, str, str, int], list[dict[str, Any]]] = {}
    cases: dict[tuple[str, str, str, int], str | None] = {}
    for planned, payload in done:
        for entry in payload.get("budget") or ():
            if over not in entry:
                continue
            key = (*planned.method, planned.condition, entry[over])
            groups.setdefault(key, []).append(entry)
            cases[key] = planned.coordinates.get(CASE)
    middle, middle_of = _OVER[over]
    entries = [
        _entry(*key[:3], parts) | {middle: middle_of(key[3]), "case": cases[key]} for key, parts in groups.items()
    ]
    for each in entries:
        each["alone_m"] = _of_causes_alone(each, entries, middle)
    order = {condition: number for number, condition in enumerate(dict.fromkeys(e["condition"] for e in entries))}
    return sorted(entries, key=lambda e: (e["matcher"], e["subpixel"], order[e["condition"]], e[middle]))


def _entry(matcher: str, subpixel: str, condition: str, parts: list[dict[str, Any]]) -> dict[str, Any]:
    names = list(parts[0]["predicted_m"])
    total = float(np.median([each["total_m"] for each in parts]))
    counts = np.array([each["z"] for each in parts], dtype=np.float64)
    drawn = np.array([each["z_drawn"] for each in parts], dtype=np.float64)
    weights = resampled(len(parts))
    ratios = _quantiles(weights @ counts)
    of_draws = ratios / _quantiles(weights @ drawn)
    ends = between(of_draws[1:, None], len(parts))
    low, high = between(ratios[1:, None], len(parts))
    return {
        "matcher": matcher,
        "subpixel": subpixel,
        "condition": condition,
        "causes": [name for name in names if name != OWN],
        "seeds": len(parts),
        "predicted_m": {name: float(np.median([each["predicted_m"][name] for each in parts])) for name in names},
        "total_m": total,
        "measured_m": total * float(ratios[0]),
        "measured_ci95_m": [total * float(low[0]), total * float(high[0])] if len(parts) > 1 else None,
        "over_drawn": float(of_draws[0]),
        "over_drawn_ci95": [float(end[0]) for end in ends] if len(parts) > 1 else None,
    }


def _quantiles(counts: Array) -> Array:
    """The |z| that `SHARE` of the counts of each row stay within, `[rows]`."""
    share = np.cumsum(counts, axis=1) / counts.sum(axis=1, keepdims=True)
    return np.array([np.interp(SHARE, np.concatenate([[0.0], row]), Z_EDGES) for row in share])


def _of_causes_alone(entry: dict[str, Any], entries: list[dict[str, Any]], middle: str) -> float | None:
    """The root of the sum of squares of an entry's causes, each measured alone, the matcher's own part counted once."""
    if len(entry["causes"]) < 2:
        return None
    same = [e for e in entries if all(e[key] == entry[key] for key in ("matcher", "subpixel", middle))]
    own = next((each["measured_m"] ** 2 for each in same if not each["causes"]), None)
    alone = [_alone(name, entry, same) for name in entry["causes"]]
    if own is None or None in alone:
        return None
    return float(np.sqrt(own + sum(max(each**2 - own, 0.0) for each in alone if each is not None)))


_ALIKE = 1.3
"""Largest ratio of predictions for causes to count as of one size: the matched pixels differ a little."""


def _alone(cause: str, entry: dict[str, Any], same: list[dict[str, Any]]) -> float | None:
    """The measured error of a cause alone, of the size predicted for an entry; None if it was not measured alone."""
    ratios = {
        each["measured_m"]: abs(float(np.log(each["predicted_m"][cause] / entry["predicted_m"][cause])))
        for each in same
        if each["causes"] == [cause] and each["predicted_m"][cause] > 0 and entry["predicted_m"][cause] > 0
    }
    nearest = min(ratios, key=lambda measured: ratios[measured], default=None)
    return nearest if nearest is not None and ratios[nearest] <= np.log(_ALIKE) else None
