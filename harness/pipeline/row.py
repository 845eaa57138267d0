"""The stored row of a trial: its figures, cells and histograms, small enough to store thousands."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from harness.evaluation.cells import cells
from harness.evaluation.metrics import (
    CORE,
    error_histograms,
    fraction_histograms,
    measure_by_solid_angle,
    measure_more,
    measure_regions,
    share_of_estimates,
)
from harness.evaluation.motion_cost import motion_figures
from harness.evaluation.occlusion_scores import occlusion_scores
from harness.evaluation.regions import FLOOR, VISIBLE, WALL
from harness.evaluation.rounding import rounding
from harness.evaluation.tally import tally
from harness.geometry.panorama import directions
from harness.matching.interface import Reason
from harness.pipeline import localise, novel_views, path_map, scan
from harness.pipeline.error_budget import error_budget
from harness.pipeline.sample import calibration_of, confidence_of, noise_grey, sampled, with_bounds
from harness.pipeline.trial import Outcome


class Beside(NamedTuple):
    """A kind of score that a trial may have beside those of its ranges."""

    name: str
    """Its key in the row."""
    entry_of: Callable[[Outcome], Any]
    """Computes the row's entry from an outcome, JSON-able; None or empty where the trial does not ask for it."""
    columns_of: Callable[[Any], dict[str, float | None]]
    """The columns of `trials.csv` from that entry."""


BESIDE = (
    Beside("novel_views", novel_views.figures_of, novel_views.columns_of),
    Beside("scan", scan.figures_of, scan.columns_of),
    Beside("map", path_map.figures_of, path_map.columns_of),
    Beside("localisation", localise.figures_of, lambda _: {}),
)
"""All such scores, in the order of the columns."""


def row_of(outcome: Outcome) -> dict[str, Any]:
    """All that the report and the test of the law need of a trial, JSON-able; no arrays of pixels.

    Returns
    -------
    dict
        `figures`: flat, for `trials.csv`; `regions`: see `metrics.measure_regions`; `cells`: see `cells.Cell`;
        `errors` and `fractions`: histograms for wall and floor; `reasons`: the pixels of the domain by the name of
        their `Reason`; `sample`, `noise_grey`, `confidence` and `calibration`, where the trial has them: see `sample`;
        `rounding`, where matches are whole samples: see `rounding.rounding`; `remark`, the matcher's, if it has one;
        `motion`, the status of an estimated one and why; and the entries of `BESIDE`.
    """
    trial, refined = outcome.trial, outcome.matches.refined
    errors = tally(outcome.layout, outcome.valid, outcome.errors)
    regions = measure_regions(errors)
    further = {each.name: scored for each in BESIDE if (scored := each.entry_of(outcome))}
    optional: dict[str, Any] = {
        "sample": sampled(outcome),
        "noise_grey": noise_grey(outcome) if trial.scoring.sample_px else None,
        "confidence": confidence_of(outcome) if trial.scoring.confidence else None,
        "calibration": calibration_of(outcome),
        "budget": error_budget(outcome) if trial.scoring.budget else None,
        "rounding": _rounding(outcome) or None,
        "remark": outcome.matches.remark or None,
        "motion": _status(outcome),
        **further,
    }
    return {
        "figures": {
            **_figures(regions, VISIBLE),
            **measure_more(errors),
            **{f"wall_{k}": v for k, v in _figures(regions, WALL).items()},
            **{f"floor_{k}": v for k, v in _figures(regions, FLOOR).items()},
            **{f"solid_angle_{k}": v for k, v in measure_by_solid_angle(errors).items()},
            **occlusion_scores(outcome.regions, outcome.reason == Reason.OCCLUDED),
            "refined": None if refined is None else share_of_estimates(errors, refined),
            **_of_confidence(optional),
            **_of_motion(outcome),
            **{
                key: value
                for each in BESIDE
                if each.name in further
                for key, value in each.columns_of(further[each.name]).items()
            },
        },
        "regions": regions,
        "cells": with_bounds(outcome, cells(errors, trial.view_2.baseline_m, trial.panorama.phi_pitch)),
        "errors": error_histograms(errors),
        "fractions": fraction_histograms(errors, outcome.k),
        "reasons": _reasons(outcome),
        **{name: value for name, value in optional.items() if value is not None},
    }


def _rounding(outcome: Outcome) -> dict[str, float | None]:
    return rounding(outcome.reference, outcome.errors, outcome.k) if outcome.trial.matching.whole_samples else {}


def _reasons(outcome: Outcome) -> dict[str, int]:
    """The number of pixels of the domain with each reason; without reasons that do not occur."""
    domain, found = outcome.reference.domain, outcome.reason
    counts = {reason.name: int(np.count_nonzero(domain & (found == np.uint8(reason)))) for reason in Reason}
    return {name: count for name, count in counts.items() if count}


def _of_confidence(optional: dict[str, Any]) -> dict[str, float | None]:
    """A few figures of the quality of confidences and predicted standard deviations; none without them."""
    figures: dict[str, float | None] = {}
    if optional["confidence"] is not None:
        figures |= {name: optional["confidence"][name] for name in ("ause_px", "ause_over_random", "auc_1px")}
    if optional["calibration"] is not None:
        within = optional["calibration"]["within"]
        figures |= {f"within_{k}_sigma": within[k - 1] for k in (1, 2, 3)}
    return figures


def _of_motion(outcome: Outcome) -> dict[str, float | None]:
    """Errors of an estimated motion, and the range errors that they cause; none if the motion was given."""
    if outcome.estimated is None:
        return {}
    counted = outcome.reference.domain & outcome.valid
    looking, range_m = directions(outcome.trial.panorama)[counted], outcome.reference.range_m[counted]
    estimated = outcome.estimated
    figures = motion_figures(outcome.trial.true_motion, estimated.motion, estimated.error, looking, range_m)
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}


def _status(outcome: Outcome) -> dict[str, Any] | None:
    estimated = outcome.estimated
    return None if estimated is None else {"status": estimated.status, "reasons": list(estimated.reasons)}


def _figures(regions: list[dict[str, Any]], part: str) -> dict[str, float | None]:
    """The core figures of one region; all None where the picture has no such part."""
    region: dict[str, Any] = next((each for each in regions if each["part"] == part), {})
    return {name: region.get(name) for name in ("density", *CORE)}
