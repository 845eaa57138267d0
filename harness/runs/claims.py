"""The paper's claims, judged by the trials of an experiment that repeats it, with intervals over seeds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.evaluation.statistics import mean_over_seeds
from harness.geometry.triangulation import sensitivity_to_alpha_2
from harness.runs.methods import METHOD_KEYS

if TYPE_CHECKING:
    from harness.runs.experiment import Planned

WHOLE, SUBPIXEL = ("window", "none"), ("window", "parabola")
"""The paper's two methods."""
BASELINE_M, RANGE_M, ERROR_DEG, SAYS_M = 0.5, 3.0, 1.0, 0.3
"""The paper's worked example (section 6): baseline, range and error of the angle, and the error of the range that it
gives."""

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
"""Verdicts."""


@dataclass(frozen=True)
class Measured:
    """A mean over seeds with its 95 % interval, as a claim needs it."""

    value: float
    low: float
    high: float

    def shown(self, form: str, scale: float = 1.0, unit: str = "") -> str:
        """`value [low, high] unit`."""
        value, low, high = (format(scale * each, form) for each in (self.value, self.low, self.high))
        return f"{value} [{low}, {high}]{unit and f' {unit}'}"


Rows = Sequence[Mapping[str, Any]]
"""The rows, from `row.row_of`, of the trials of one method."""


def claims_of(done: Iterable[tuple["Planned", dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `claims` of `summary.json`: empty unless nothing but the seed and the paper's two methods vary.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them.

    Returns
    -------
    list of dict
        For each claim `id`, `claim` (its name), `paper` (what the paper says), `where` (its section or figure), `found`
        (what came out, in words, a line each), `numbers` (each with `value` and `ci95`), `verdict`, `because`, and
        `seeds`.
    """
    trials = list(done)
    methods: dict[tuple[str, str], dict[int, dict[str, Any]]] = {}
    for planned, payload in trials:
        methods.setdefault(planned.method, {})[planned.trial.seed] = payload
    if set(methods) != {WHOLE, SUBPIXEL} or not _differ_in_method_alone(planned for planned, _ in trials):
        return []
    seeds = sorted(methods[WHOLE].keys() & methods[SUBPIXEL].keys())
    if len(seeds) < 2:
        return []
    whole, subpixel = ([methods[each][seed] for seed in seeds] for each in (WHOLE, SUBPIXEL))
    return [judged | {"seeds": len(seeds)} for judge in CLAIMS if (judged := judge(_Trials(seeds, whole, subpixel)))]


def _differ_in_method_alone(planned: Iterable["Planned"]) -> bool:
    """Whether trials differ in nothing but the seed and the method."""
    others = [
        {key: value for key, value in each.coordinates.items() if key not in ("seed", *METHOD_KEYS)} for each in planned
    ]
    return all(each == others[0] for each in others)


@dataclass(frozen=True)
class _Trials:
    """The rows of both methods, seed by seed."""

    seeds: list[int]
    whole: Rows
    subpixel: Rows

    def mean(self, values: Sequence[float | None], *, logarithmic: bool = False) -> Measured | None:
        """The mean over seeds; None where a seed has no number."""
        known = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        if np.isnan(known).any() or (logarithmic and (known <= 0).any()):
            return None
        curve = mean_over_seeds(pd.DataFrame({"it": known}, index=self.seeds), logarithmic=logarithmic)
        return Measured(float(curve.mean[0]), float(curve.low[0]), float(curve.high[0]))

    def of(self, rows: Rows, name: str, *, logarithmic: bool = False) -> Measured | None:
        """The mean of one of the rows' figures."""
        return self.mean([row["figures"].get(name) for row in rows], logarithmic=logarithmic)


# --- The claims ---------------------------------------------------------------------------------------------------


def _discretisation(trials: _Trials) -> dict[str, Any] | None:
    """Rounding alone: which samples are matched, how far the profile jumps, and what errors that gives."""
    rounding = [row.get("rounding", {}) for row in trials.whole]
    names = ("steps_of_one", "nearest", "median_m", "rounding_m")
    known = {name: trials.mean([each.get(name) for each in rounding]) for name in names}
    numbers = {name: each for name, each in known.items() if each is not None}
    if len(numbers) < len(known):
        return None
    jumps, nearest = numbers["steps_of_one"], numbers["nearest"]
    return _claim(
        "discretisation",
        "discontinuities are discretisation",
        "“the discontinuities in the curve are caused by discretization”",
        "fig. 5(a)",
        [
            (
                f"median error on walls {numbers['median_m'].shown('.1f', 1000, 'mm')}; rounding alone makes "
                f"{numbers['rounding_m'].shown('.1f', 1000, 'mm')}"
            ),
            f"{nearest.shown('.0f', 100, '%')} of the estimates are the sample nearest to the truth",
            f"{jumps.shown('.2f', 100, '%')} of the jumps along rows are one sample wide",
        ],
        numbers,
        # Nine in ten: mismatches would jump by any number of samples, and be nearest by chance alone.
        HOLDS if jumps.low > 0.9 and nearest.low > 0.8 else PARTLY if jumps.low > 0.9 else FAILS,
        "",
    )


def _compensation(trials: _Trials) -> dict[str, Any] | None:
    """Error and bias with the sub-pixel step, on walls and over all pixels."""
    pairs = {
        "wall_ratio": "wall_range_median_abs_m",
        "ratio": "range_median_abs_m",
    }
    known: dict[str, Measured | None] = {
        name: trials.mean(
            [_ratio(after, before, figure) for after, before in zip(trials.subpixel, trials.whole, strict=True)],
            logarithmic=True,
        )
        for name, figure in pairs.items()
    }
    for prefix in ("wall_", ""):
        for name, rows in (("whole", trials.whole), ("subpixel", trials.subpixel)):
            known[f"{prefix}bias_{name}_m"] = trials.of(rows, f"{prefix}range_bias_m")
    numbers = {name: each for name, each in known.items() if each is not None}
    if len(numbers) < len(known):
        return None
    error, bias = numbers["wall_ratio"], numbers["bias_subpixel_m"]
    before = numbers["bias_whole_m"]
    helps = error.high < 1
    unbiased = _is_smaller(bias, before)
    return _claim(
        "compensation",
        "sub-pixel compensates error and bias",
        "discretization “can introduce considerable error and bias in the range estimate. Our sub-pixel method "
        "compensates for this.”",
        "fig. 5(b)",
        [
            (
                f"median error {error.shown('.2f')} times that at whole pixels on walls, "
                f"{numbers['ratio'].shown('.2f')} times over all pixels"
            ),
            (f"bias over all pixels {before.shown('+.0f', 1000, 'mm')} before, {bias.shown('+.0f', 1000, 'mm')} after"),
            (
                f"bias on walls {numbers['wall_bias_whole_m'].shown('+.1f', 1000, 'mm')} before, "
                f"{numbers['wall_bias_subpixel_m'].shown('+.1f', 1000, 'mm')} after"
            ),
        ],
        numbers,
        HOLDS if helps and unbiased else PARTLY if helps or unbiased else FAILS,
        {
            (True, True): "",
            (
                True,
                False,
            ): "the error is compensated; the bias over all pixels, which mismatches make, is not",
            (False, True): "the bias is compensated, the error is not",
            (False, False): "neither error nor bias is compensated",
        }[helps, unbiased],
    )


def _one_degree(trials: _Trials) -> dict[str, Any] | None:
    """The worked example by the exact law, and whether measured errors follow it."""
    right, shallow, steep = (_law_m(angle) for angle in (90.0, 30.0, 150.0))
    ratio = trials.mean([_over_the_law(row) for row in trials.whole])
    if ratio is None:
        return None
    holds = abs(right / SAYS_M - 1) < 0.1  # the paper gives one digit
    return _claim(
        "one-degree",
        "1° costs 0.3 m",
        f"a baseline of {BASELINE_M:g} m, a wall {RANGE_M:g} m away: “an error of {ERROR_DEG:g} degree in the "
        f"estimation of the disparity results in an error in the depth of about {SAYS_M:g} m”",
        "section 6",
        [
            f"exact law: {right:.2f} m at right angles to the baseline, {shallow:.2f} m at 30°, {steep:.2f} m at 150°",
            f"errors on walls over the law times the errors of their angles: {ratio.shown('.3f')}",
        ],
        {"measured_over_law": ratio},
        # The law is one of small errors; the paper's rounding is coarser than a twentieth.
        HOLDS if holds and abs(ratio.value - 1) < 0.05 else FAILS,
        "at right angles to the baseline; it costs more elsewhere" if holds else "",
    )


def _other_rows(trials: _Trials) -> dict[str, Any] | None:
    """Walls, of which the paper's row is one, beside floors and ceilings."""
    known = {
        f"{part}_{name}": trials.of(trials.subpixel, f"{part}_{figure}", logarithmic=name == "median_m")
        for part in ("wall", "floor")
        for name, figure in (("bad_1px", "bad_1px"), ("median_m", "range_median_abs_m"))
    }
    numbers = {name: each for name, each in known.items() if each is not None}
    if len(numbers) < len(known):
        return None
    walls, floors = numbers["wall_bad_1px"], numbers["floor_bad_1px"]
    alike = floors.low <= walls.high and numbers["floor_median_m"].low <= numbers["wall_median_m"].high
    return _claim(
        "other-rows",
        "other rows are alike",
        "“results for other rows give similar range estimates”",
        "section 7",
        [
            (
                f"off by more than a pixel: {floors.shown('.0f', 100, '%')} on floor and ceiling, "
                f"{walls.shown('.2f', 100, '%')} on walls"
            ),
            (
                f"median error {numbers['floor_median_m'].shown('.0f', 1000, 'mm')} there, "
                f"{numbers['wall_median_m'].shown('.0f', 1000, 'mm')} on walls"
            ),
        ],
        numbers,
        HOLDS if alike else FAILS,
        "" if alike else "on the floor a square window covers several disparities",
    )


CLAIMS: tuple[Callable[[_Trials], dict[str, Any] | None], ...] = (
    _discretisation,
    _compensation,
    _one_degree,
    _other_rows,
)
"""The claims in the order in which they are shown."""


def _claim(
    id_: str,
    name: str,
    paper: str,
    where: str,
    found: list[str],
    numbers: Mapping[str, Measured],
    verdict: str,
    because: str,
) -> dict[str, Any]:
    return {
        "id": id_,
        "claim": name,
        "paper": paper,
        "where": where,
        "found": found,
        "numbers": {key: {"value": each.value, "ci95": [each.low, each.high]} for key, each in numbers.items()},
        "verdict": verdict,
        "because": because,
    }


def _ratio(after: Mapping[str, Any], before: Mapping[str, Any], figure: str) -> float | None:
    above, below = (each["figures"].get(figure) for each in (after, before))
    return above / below if above and below else None


def _is_smaller(after: Measured, before: Measured) -> bool:
    """Whether no bias is left, or clearly less of it than there was."""
    if after.low <= 0 <= after.high:
        return True
    return max(abs(after.low), abs(after.high)) < min(abs(before.low), abs(before.high))


def _law_m(alpha_1_deg: float) -> float:
    """The error of the range by the exact law in the paper's example, metres."""
    alpha_1 = np.radians(alpha_1_deg)
    alpha_2 = np.arctan2(RANGE_M * np.sin(alpha_1), RANGE_M * np.cos(alpha_1) - BASELINE_M)
    return float(abs(sensitivity_to_alpha_2(alpha_1, alpha_2, BASELINE_M)) * np.radians(ERROR_DEG))


def _over_the_law(row: Mapping[str, Any]) -> float | None:
    """The range errors of the cells on walls over what the exact law makes of their angles' errors: the mean ratio."""
    ratios = [
        cell["spread_m"] / (cell["law_exact"] * cell["sigma_alpha"])
        for cell in row["cells"]
        if cell["surface"] == "wall" and cell["sigma_alpha"] > 0
    ]
    return float(np.mean(ratios)) if ratios else None
