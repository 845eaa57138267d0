"""The figures that summarise an estimate. A pixel without an estimate counts in the density only."""

from typing import Any

import numpy as np

from harness.evaluation import _grouping_kernels as _kernels
from harness.evaluation.metric_table import METRICS
from harness.evaluation.pixel_errors import Errors
from harness.evaluation.regions import SURFACES
from harness.evaluation.tally import FRACTION_BINS, Mask, Tally
from harness.geometry.angles import Array

Measures = dict[str, float | None]

CORE = (
    "disparity_median_abs_px",
    "disparity_rmse_px",
    "bad_1px",
    "range_median_abs_m",
    "range_mae_m",
    "range_rmse_m",
    "range_bias_m",
)


def measure(domain: Mask, valid: Mask, errors: Errors) -> Measures:
    """Core figures over the valid pixels of a domain; None without any such pixel.

    Parameters
    ----------
    domain
        `[height, width]`: the pixels that count.
    valid
        `[height, width]`: those with an estimate.

    Returns
    -------
    dict
        `density` (valid / domain), `disparity_median_abs_px`, `disparity_rmse_px`, `bad_1px` (share of absolute
        errors above one pixel), `range_median_abs_m`, `range_mae_m`, `range_rmse_m`, `range_bias_m` (mean, signed).
    """
    pixels = domain & valid
    return {"density": _share(pixels, domain), **_core(errors.disparity_px[pixels], errors.range_m[pixels])}


def _core(disparity: Array, distance: Array) -> Measures:
    if not disparity.size:
        return dict.fromkeys(CORE)
    absolute, off = np.abs(disparity), np.abs(distance)
    values = [
        np.median(absolute),
        np.sqrt(np.mean(disparity**2)),
        np.mean(absolute > 1),
        np.median(off),
        np.mean(off),
        np.sqrt(np.mean(distance**2)),
        np.mean(distance),
    ]
    return dict(zip(CORE, map(float, values), strict=True))


def measure_more(errors: Tally) -> Measures:
    """The metrics beyond the core, over the domain: every entry of `METRICS` with a function of its own; None where
    there is nothing to take one from.
    """
    made = {name: metric.of for name, metric in METRICS.items() if metric.of is not None}
    if not errors.matched:
        return dict.fromkeys(made)
    values = {name: float(of(errors)) for name, of in made.items()}
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def measure_by_solid_angle(errors: Tally) -> Measures:
    """Core figures of the domain with every pixel weighted by the solid angle that it covers, `dphi dz/(1 + z²)^(3/2)`.

    A panorama's pixels do not cover the sphere evenly: near its lower border they are a fifth of those at the horizon.
    """
    sums = errors.weighted
    matched, whole = float(sums[_kernels.COUNT]), float(sums[_kernels.NEGATIVE])
    measures: Measures = {"density": matched / whole if whole else None}
    if not matched:
        return measures | dict.fromkeys(CORE)
    mean = sums / matched
    return measures | _core_of(mean, errors.quantiles_px[0], errors.weighted_median_m)


def measure_regions(errors: Tally) -> list[dict[str, Any]]:
    """Core figures and the number of pixels of each part of the picture.

    Returns
    -------
    list
        Of tables: `split` (`surface`, `alpha_1`, ...), `part`, `low` (its lower edge, None where the split is not by
        values), `pixels`, and the figures of `measure`.
    """
    table = []
    for i, region in enumerate(errors.layout.regions):
        number = int(errors.count[i])
        row = {"split": region.split, "part": region.part, "low": region.low, "pixels": int(region.pixels.size)}
        row["density"] = number / region.pixels.size
        if number:
            row |= _core_of(errors.sums[i] / number, errors.median_abs_px[i], errors.median_abs_m[i])
        else:
            row |= dict.fromkeys(CORE)
        table.append(row)
    return table


def _core_of(mean: Array, median_px: float, median_m: float) -> Measures:
    """The core figures from the means of the kinds of sums."""
    values = [
        median_px,
        np.sqrt(mean[_kernels.SQUARE_PX]),
        mean[_kernels.GROSS],
        median_m,
        mean[_kernels.OFF_M],
        np.sqrt(mean[_kernels.SQUARE_M]),
        mean[_kernels.BIAS_M],
    ]
    return dict(zip(CORE, map(float, values), strict=True))


def error_histograms(errors: Tally) -> dict[str, list[int]]:
    """Counts of either surface's absolute disparity errors between `ERROR_EDGES_PX`; the last bin holds all larger."""
    return dict(zip(SURFACES, errors.histogram.tolist(), strict=True))


def fraction_histograms(errors: Tally, k: Array) -> dict[str, list[int]]:
    """Counts of either surface's positions between two samples: pixel locking shows as peaks.

    0 .. 1 in `FRACTION_BINS`, shifted by half a bin, so that whole samples fall into the middle of the first one.

    Parameters
    ----------
    k
        `[height, width]`, positions of the estimates in samples.
    """
    histogram = np.zeros((len(SURFACES), FRACTION_BINS), dtype=np.int64)
    _kernels.add_fractions(errors.layout.groups.pixels, errors.layout.surface, errors.scored, k.ravel(), histogram)
    return dict(zip(SURFACES, histogram.tolist(), strict=True))


def share_of_estimates(errors: Tally, flags: Mask) -> float | None:
    """Share of the domain's estimates that have a flag `[height, width]`; None without any estimate."""
    layout, number = errors.layout, errors.logarithm.size
    flagged = _kernels.count_flags(layout.groups.pixels, layout.surface, errors.scored, flags.ravel())
    return float(flagged / number) if number else None


def _share(part: Mask, whole: Mask) -> float | None:
    return float(np.count_nonzero(part) / np.count_nonzero(whole)) if whole.any() else None
