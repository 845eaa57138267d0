"""What is kept of a trial: its figures, cells and histograms, small enough to keep thousands."""

from typing import Any

import numpy as np

from harness.evaluation.cells import cells
from harness.evaluation.metrics import (
    CORE,
    error_histogram,
    fraction_histogram,
    measure_by_solid_angle,
    measure_more,
    measure_regions,
    ranked,
)
from harness.experiments.trial import Outcome


def row_of(outcome: Outcome) -> dict[str, Any]:
    """Everything about a trial that the report and the law's test need, JSON-able; no arrays of pixels.

    Returns
    -------
    dict
        `figures`: flat, for `trials.csv`; `regions`: see `metrics.measure_regions`; `cells`: see `cells.Cell`;
        `errors` and `fractions`: histograms for wall and floor.
    """
    truth, grid = outcome.reference, outcome.trial.panorama
    errors = ranked(outcome.valid, outcome.errors, grid)
    surfaces = {"wall": truth.domain & truth.wall, "floor": truth.domain & ~truth.wall}
    scored = {where: mask & outcome.valid for where, mask in surfaces.items()}
    regions = measure_regions(outcome.layout, errors)
    everywhere, refined = truth.domain & outcome.valid, outcome.matches.refined
    return {
        "figures": {
            **_figures(regions, "visible in both views"),
            **measure_more(truth.domain, errors, truth),
            **{f"wall_{k}": v for k, v in _figures(regions, "wall").items()},
            **{f"floor_{k}": v for k, v in _figures(regions, "floor or ceiling").items()},
            **{f"solid_angle_{k}": v for k, v in measure_by_solid_angle(truth.domain, errors, grid).items()},
            "refined": float(np.mean(refined[everywhere])) if refined is not None and everywhere.any() else None,
        },
        "regions": regions,
        "cells": cells(outcome.layout, truth, errors, outcome.trial.view_2.baseline_m),
        "errors": {where: error_histogram(mask, errors) for where, mask in scored.items()},
        "fractions": {where: fraction_histogram(mask, outcome.k) for where, mask in scored.items()},
    }


def _figures(regions: list[dict[str, Any]], part: str) -> dict[str, float | None]:
    """The core figures of one region; None each where the picture has no such part."""
    region: dict[str, Any] = next((each for each in regions if each["part"] == part), {})
    return {name: region.get(name) for name in ("density", *CORE)}
