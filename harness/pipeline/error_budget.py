"""The error budget of a trial, by range and direction: the predicted error of each cause, and the measured errors."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.evaluation.propagation import Rig, propagated, sensitivities
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.evaluation.rig_uncertainty import covariances
from harness.evaluation.statistics import central_68
from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_1
from harness.geometry.panorama import directions
from harness.geometry.triangulation import sigma_of_range
from harness.pipeline.believed import calibrated
from harness.pipeline.stages import setup_of
from harness.pipeline.trial import Outcome
from harness.simulation.noise import generator

Z_EDGES = np.arange(0.0, 6.0001, 0.05)
"""Bins of |error| over its predicted standard deviation; what lies beyond is in the last one."""
CALIBRATED = "alignment, calibrated"
"""The remaining cause when a misaligned mirror is calibrated as a central sensor as well as possible."""
_EVERY = 3
"""Rows and columns between the pixels that count."""
_LEAST_SINE = 0.5
"""Directions within 30 degrees of the baseline are left out, as in the paper."""
_LEAST_PIXELS = 30


def error_budget(outcome: Outcome) -> list[dict[str, Any]] | None:
    """Predicted errors by cause, range and direction, and a histogram of the errors in units of the prediction.

    The matcher's own part is what it predicts itself; None where it predicts nothing.

    Returns
    -------
    list of dict
        One for each bin of the range (`range_bin`), and then of the direction (`alpha_bin`; see `regions`), with enough
        pixels: `pixels`; `predicted_m`, the error that 68 % stay within, by cause; `total_m`, of all; `z`, counts of
        |error|/sigma in the bins of `Z_EDGES`; `z_drawn`, the same of the errors that follow from what the seed has
        drawn, with the matcher's as predicted.
    """
    sigma_alpha = outcome.matches.sigma_alpha_2
    if sigma_alpha is None:
        return None
    trial, assumed = outcome.trial, setup_of(outcome.trial).assumed
    looking, range_m = directions(trial.panorama), outcome.reference.range_m
    towards = alpha_1(trial.panorama, assumed.motion.t_v1)
    some = np.zeros(range_m.shape, dtype=bool)
    some[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY] = True
    some &= outcome.reference.domain & outcome.valid & (np.sin(towards) >= _LEAST_SINE) & np.isfinite(sigma_alpha)
    points = looking[some] * range_m[some][:, None]
    normals = outcome.truth.normal[some] @ trial.poses[0].R_world_from_view
    angles, baseline_m = (towards[some], outcome.matches.alpha_2[some], sigma_alpha[some]), assumed.motion.baseline_m
    sigma: dict[str, Array] = {"matching": sigma_of_range(*angles, baseline_m)}
    rig, draws = Rig(assumed.sensors, assumed.motion), trial.belief_draws
    noise = generator(trial.seed, "error budget").standard_normal(len(points))
    follows = sigma["matching"] * noise
    for cause, parameters, covariance in covariances(assumed.sensors[0], trial.believed.sigma, trial.true_motion):
        if not covariance.any():
            continue
        name, base, follow = cause, rig, None
        if cause == "alignment" and trial.believed.alignment == "central":
            name, base = CALIBRATED, Rig(trial.assumed_sensors, assumed.motion)
            follow = partial(calibrated, believed=trial.believed)
        sensitivity = sensitivities(points, base, parameters, normals, follow)
        sigma[name] = propagated(sensitivity, covariance)
        # Errors are believed less true; those of the alignment are true less believed.
        side = 1 if cause == "alignment" else -1
        follows = follows + side * sensitivity @ [draws.get(each.key, 0.0) for each in parameters]
    total = np.sqrt(sum(each**2 for each in sigma.values()))
    known = np.isfinite(total) & (total > 0)
    bins = {
        "range_bin": np.floor(np.log(range_m[some]) / np.log(RANGE_RATIO)).astype(int),
        "alpha_bin": np.digitize(np.degrees(towards[some]), ALPHA_1_EDGES_DEG[1:-1]),
    }
    errors, expected = np.abs(outcome.errors.range_m[some]), np.abs(follows)
    return [
        {over: index} | _row(known & (numbers == index), sigma, total, (errors, expected))
        for over, numbers in bins.items()
        for index in np.unique(numbers[known]).tolist()
        if (known & (numbers == index)).sum() >= _LEAST_PIXELS
    ]


def _row(part: NDArray[np.bool_], sigma: dict[str, Array], total: Array, errors: tuple[Array, Array]) -> dict[str, Any]:
    """The figures of some pixels; `errors`: as measured, and as they follow from the draws."""
    z, z_drawn = (
        np.histogram(np.minimum(each[part] / total[part], Z_EDGES[-1] - 1e-9), Z_EDGES)[0].tolist() for each in errors
    )
    return {
        "pixels": int(part.sum()),
        "predicted_m": {name: central_68(each[part]) for name, each in sigma.items()},
        "total_m": central_68(total[part]),
        "z": z,
        "z_drawn": z_drawn,
    }
