"""The entries of a row beyond figures: errors of sampled pixels, and the quality of confidence."""

from typing import Any

import numpy as np

from harness.camera.sensor import pixel_directions
from harness.evaluation.confidence import calibration, exceeding, roc, sparsification
from harness.geometry.angles import Array
from harness.pipeline.trial import Outcome
from harness.simulation.chip import grey_variance

_EVERY = 5
"""Steps of the curve, of its hundred, between the points of a figure."""

BAD_PX = 1.0
"""Errors above this should be detected by confidence."""


def sampled(outcome: Outcome) -> dict[str, list[float | None]] | None:
    """Errors of every `scoring.sample_px`-th row and column of the domain, in pixels of disparity.

    Returns
    -------
    dict
        `error_px`, None where there is no estimate; `bound_px`, the smallest standard deviation possible in units of
        `Trial.bound_noise_grey`, None where there is none, and `sigma_px`, the one predicted: all of the same length,
        which depends on the geometry alone. None when sampling is off.
    """
    step = outcome.trial.scoring.sample_px
    if not step:
        return None
    lattice = (slice(step // 2, None, step), slice(step // 2, None, step))
    domain = outcome.reference.domain[lattice]
    pitch = outcome.trial.panorama.phi_pitch
    sigma, bound = outcome.matches.sigma_alpha_2, outcome.bound_px
    nothing = np.full(domain.sum(), np.nan)
    return {
        "error_px": _plain(_errors(outcome, outcome.errors.disparity_px)[lattice][domain]),
        "bound_px": _plain(nothing if bound is None else bound[lattice][domain]),
        "sigma_px": _plain(nothing if sigma is None else sigma[lattice][domain] / pitch),
    }


def noise_grey(outcome: Outcome) -> float:
    """Standard deviation of the noise of view 1's grey levels: the root of the mean variance of the pixels in use."""
    trial = outcome.trial
    if trial.chip.is_ideal:
        return trial.noise.sigma_grey
    variance = grey_variance(outcome.clean[0], trial.chip, trial.noise.sigma_grey)
    return float(np.sqrt(variance[pixel_directions(trial.sensor)[1]].mean()))


def confidence_of(outcome: Outcome) -> dict[str, Any] | None:
    """Figures of how well the matcher's confidence ranks errors and detects large ones; None without a confidence."""
    confidence = confidence_map(outcome)
    if confidence is None or not (outcome.valid & outcome.reference.domain).any():
        return None
    error = domain_errors_px(outcome)
    curve = sparsification(error, confidence)
    bad, among = exceeding(error, BAD_PX)
    auc = roc(confidence, bad, among=among).auc
    return {
        "removed": curve.removed[::_EVERY].tolist(),
        "remaining_px": curve.remaining[::_EVERY].tolist(),
        "oracle_px": curve.oracle[::_EVERY].tolist(),
        "ause_px": curve.ause,
        "ause_over_random": curve.ause_over_random,
        "auc_1px": auc if np.isfinite(auc) else None,
    }


def calibration_of(outcome: Outcome) -> dict[str, Any] | None:
    """Figures of the errors in units of their predicted standard deviation; None without a prediction."""
    sigma = outcome.matches.sigma_alpha_2
    if sigma is None:
        return None
    fit = calibration(_errors(outcome, outcome.errors.alpha_2), sigma)
    if not fit.pixels:
        return None
    return {"within": list(fit.within), "spread": fit.spread, "bias": fit.bias, "predicted": fit.predicted}


def domain_errors_px(outcome: Outcome) -> Array:
    """Errors of disparity in the domain; NaN outside it and where there is no range."""
    return _errors(outcome, outcome.errors.disparity_px)


def _errors(outcome: Outcome, errors: Array) -> Array:
    return np.where(outcome.reference.domain & outcome.valid, errors, np.nan)


def with_bounds(outcome: Outcome, cells: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Cells with `bound_alpha`: the median Cramér-Rao bound of their estimates, radians, at the trial's noise.

    Only where `scoring.bound` asks for it; None in a cell where fewer than half of the estimates have a bound.
    """
    noise = outcome.trial.bound_noise_grey
    if not outcome.trial.scoring.bound or outcome.bound_px is None or not noise:
        return cells
    bound = (noise * outcome.trial.panorama.phi_pitch) * outcome.bound_px.ravel()
    matched = outcome.valid.ravel()
    bounds = {}
    for part in outcome.layout.cells:
        mine = bound[part.pixels[matched[part.pixels]]]
        known = mine[np.isfinite(mine)]
        enough = known.size and 2 * known.size >= mine.size
        bounds[part.surface, part.alpha_bin, part.range_bin] = float(np.median(known)) if enough else None
    return [each | {"bound_alpha": bounds[each["surface"], each["alpha_bin"], each["range_bin"]]} for each in cells]


def confidence_map(outcome: Outcome) -> Array | None:
    """The matcher's confidence; the inverse of its predicted standard deviation if it has no confidence."""
    matches = outcome.matches
    if matches.confidence is not None:
        return matches.confidence
    return None if matches.sigma_alpha_2 is None else 1 / matches.sigma_alpha_2


def _plain(values: Array) -> list[float | None]:
    """Five significant digits: rows should be small."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]
