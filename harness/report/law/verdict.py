"""What can be said of the law, method by method: the verdict, and where and why the law fails."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from harness.evaluation.law import GROSS, verdict
from harness.report.data import interval
from harness.report.law.part import Fit, is_of
from harness.report.sweep import Sweep, Way
from harness.report.words import figure, typeset


@dataclass(frozen=True)
class Finding:
    """What can be said of the law for one method and surface."""

    way: Way
    surface: str
    words: str
    """The verdict of the evaluation."""
    reasons: list[str]
    """Where and why, as far as the numbers show it."""


def findings(sweep: Sweep, law: dict[str, Any]) -> list[Finding]:
    """The verdict for every method and surface, with where the law fails."""
    found = []
    for surface in sweep.surfaces:
        for way in sweep.ways:
            fits = [fit for fit in law["images"] if is_of(fit, way, surface)]
            exact = next((fit for fit in fits if fit["law"] == "exact" and fit["slope"] is not None), None)
            if exact is None:
                continue
            said = verdict(fits, sweep.cells, directions=False).partition(": ")[2]
            said = typeset(f"{said[:1].upper()}{said[1:]}")
            found.append(Finding(way, surface, said, list(_reasons(sweep, way, surface, exact, law))))
    return found


def _reasons(sweep: Sweep, way: Way, surface: str, exact: Fit, law: dict[str, Any]) -> Iterator[str]:
    """Where the slope's interval leaves out 1, and how the angle's own error grows."""
    known = [each for each in exact["by_alpha_1"] if each["slope_ci95"] is not None]
    off = [each for each in known if not each["slope_ci95"][0] <= 1 <= each["slope_ci95"][1]]
    if known and off:
        places = ", ".join(
            f"{each['from_deg']:g}\u2060–\u2060{each['to_deg']:g}°\u00a0({figure(each['slope'], '.2f')})"
            for each in off
        )
        which = "all directions" if len(off) == len(known) else f"{len(off)} of {len(known)} directions"
        yield f"The interval leaves out 1 in {which}: α₁ = {places}."
    elif known:
        yield f"In each of the {len(known)} directions by itself the interval holds 1."
    grown = next((each for each in law["sigma_alpha"] if is_of(each, way, surface)), None)
    if grown and grown["slope_ci95"] is not None:
        slope, (low, high) = grown["slope_on_t_over_d"], grown["slope_ci95"]
        power = f"the power {figure(slope, '.2f')} {interval((low, high), '.2f')} of |t|/d"
        if low <= 0 <= high:
            yield f"σ(α₂) goes with {power}: no dependence on baseline and range can be told."
        else:
            tail = (
                "the law’s one empirical premise, a constant σ(α₂), does not hold here"
                if abs(slope) > 0.3
                else "a small dependence, but one that the data can tell from none"
            )
            yield f"σ(α₂) goes with {power}: {tail}."
    cells = sweep.cells_of(way, surface)
    low_half, high_half = _gross_halves(cells)
    if max(low_half, high_half) > GROSS:
        yield (
            f"Estimates off by over a pixel: {100 * low_half:.0f}\u00a0% in the half of the cells with the "
            f"smaller |t|/d, {100 * high_half:.0f}\u00a0% in the other half."
        )


def _gross_halves(cells: pd.DataFrame) -> tuple[float, float]:
    ratio = cells["baseline_m"] / cells["range_m"]
    halves = (cells[ratio <= ratio.median()], cells[ratio > ratio.median()])
    low, high = (
        float((half["gross"] * half["pixels"]).sum() / half["pixels"].sum()) if len(half) else 0.0 for half in halves
    )
    return low, high
