"""Scores of a run's range profiles over seeds."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from harness.evaluation.statistics import mean_with_interval
from harness.runs.experiment import Planned
from harness.runs.methods import MethodName, in_words

MEANS = ("density", "bias_m", "rms_m", "median_abs_m", "within_1_sigma", "within_2_sigma", "missed", "false")


def scans_of(done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `scans` of `summary.json`: for each method and condition, means over seeds.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them; those without a profile are left out.

    Returns
    -------
    list of dict
        `matcher`, `subpixel`, `condition`, `seeds`; the figures of `scan_scores.ScanScore` that are `MEANS`, each with
        its 95 % interval by bootstrap over seeds (`_ci95`); and `obstacles`, a table for each by name: `width_deg`
        (mean), in how many views it stood in front (`seen`), and in how many of these it was `found`.
    """
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for planned, payload in done:
        if payload.get("scan"):
            groups.setdefault((*planned.method, planned.condition), []).append(payload["scan"])
    return [_entry(*key, scores) for key, scores in groups.items()]


def scans_conclusions(entries: list[dict[str, Any]], names: Mapping[MethodName, str]) -> list[str]:
    """Sentences on the missed and false obstacles of each method's profiles, and their sigmas; none from one seed.

    Parameters
    ----------
    entries
        The entries of `scans_of`; the sentences are about those of the first condition.
    names
        The names of methods.
    """
    mine = [each for each in entries if each["condition"] == entries[0]["condition"] and each["seeds"] > 1]
    return [_sentence(each, in_words((each["matcher"], each["subpixel"]), names)) for each in mine]


def _sentence(entry: dict[str, Any], method: str) -> str:
    missed, false = (
        f"{100 * entry[name]:.1f} % [{', '.join(f'{100 * end:.1f}' for end in entry[f'{name}_ci95'])}]"
        for name in ("missed", "false")
    )
    seen, found = (sum(each[name] for each in entry["obstacles"]) for name in ("seen", "found"))
    return (
        f"Range profiles ({method}) look through an obstacle at {missed} of the bearings and see a false one at "
        f"{false}; they find {found} of {seen} obstacles."
    )


def _entry(matcher: str, subpixel: str, condition: str, scores: list[dict[str, Any]]) -> dict[str, Any]:
    entry: dict[str, Any] = {"matcher": matcher, "subpixel": subpixel, "condition": condition, "seeds": len(scores)}
    for name in MEANS:
        known = [each[name] for each in scores if each[name] is not None]
        mean, ends = mean_with_interval(np.array(known)) if known else (None, None)
        entry |= {name: mean, f"{name}_ci95": ends}
    by_name: dict[str, list[dict[str, Any]]] = {}
    for score in scores:
        for each in score["which"]:
            by_name.setdefault(each["name"], []).append(each)
    entry["obstacles"] = sorted(
        (
            {
                "name": name,
                "width_deg": float(np.mean([each["width_deg"] for each in some])),
                "seen": len(some),
                "found": sum(each["found"] for each in some),
            }
            for name, some in by_name.items()
        ),
        key=lambda each: each["width_deg"],
    )
    return entry
