"""What is kept of a trial: its figures, cells and histograms, small enough to keep thousands."""

from typing import Any

import numpy as np

from harness.evaluation.cells import cells
from harness.evaluation.metrics import (
    error_histogram,
    fraction_histogram,
    measure,
    measure_by_solid_angle,
    measure_more,
    measure_regions,
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
    truth, found, valid = outcome.reference, outcome.errors, outcome.valid
    grid = outcome.trial.panorama
    wall, floor = truth.domain & truth.wall, truth.domain & ~truth.wall
    surfaces = {"wall": wall, "floor": floor}
    return {
        "figures": {
            **measure(truth.domain, valid, found),
            **measure_more(truth.domain, valid, found, truth),
            **{f"{where}_{k}": v for where, mask in surfaces.items() for k, v in measure(mask, valid, found).items()},
            **{f"solid_angle_{k}": v for k, v in measure_by_solid_angle(truth.domain, valid, found, grid).items()},
            "refined": float(np.mean(outcome.matches.refined[truth.domain & valid]))
            if (truth.domain & valid).any()
            else None,
        },
        "regions": measure_regions(outcome.regions, valid, found),
        "cells": cells(outcome.cells, truth, found, valid, outcome.trial.view_2.baseline_m),
        "errors": {where: error_histogram(mask & valid, found) for where, mask in surfaces.items()},
        "fractions": {where: fraction_histogram(mask & valid, outcome.matches.k) for where, mask in surfaces.items()},
    }
