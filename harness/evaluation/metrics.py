"""The figures that sum up an estimate. A pixel without an estimate counts in the density and nowhere else."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.errors import Errors, Reference
from harness.evaluation.groups import Indices, ascending, counts, means, medians
from harness.evaluation.regions import Layout
from harness.stereo.panorama import Grid

Measures = dict[str, float | None]
Mask = NDArray[np.bool_]

CORE = (
    "disparity_median_abs_px",
    "disparity_rmse_px",
    "bad_1px",
    "range_median_abs_m",
    "range_mae_m",
    "range_rmse_m",
    "range_bias_m",
)
MORE = (
    "disparity_mae_px",
    "disparity_bias_px",
    "bad_0.5px",
    "bad_2px",
    "bad_4px",
    "disparity_a50_px",
    "disparity_a90_px",
    "disparity_a95_px",
    "disparity_a99_px",
    "range_abs_rel",
    "range_silog",
    "range_delta_1.05",
    "range_delta_1.1",
    "range_delta_1.25",
)
ERROR_EDGES_PX = np.concatenate([[0.0], np.geomspace(1e-3, 300, 56)])
"""Of the histogram of absolute disparity errors, from which distributions are drawn."""

FRACTION_BINS = 40


def measure(domain: Mask, valid: Mask, found: Errors) -> Measures:
    """Core figures over the valid pixels of a domain; None where there are none.

    Parameters
    ----------
    domain
        `[height, width]`: the pixels spoken of.
    valid
        `[height, width]`: those with an estimate.

    Returns
    -------
    dict
        `density` (valid / domain), `disparity_median_abs_px`, `disparity_rmse_px`, `bad_1px` (share of absolute
        errors above one pixel), `range_median_abs_m`, `range_mae_m`, `range_rmse_m`, `range_bias_m` (mean, signed).
    """
    pixels = domain & valid
    return {"density": _share(pixels, domain), **_core(found.disparity_px[pixels], found.range_m[pixels])}


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


@dataclass(frozen=True)
class Ranked:
    """A trial's errors `[pixels]`, flat and in order: sorted once for all that needs medians of them."""

    seen: Mask
    """Pixels with an estimate and a true point."""
    disparity_px: Array
    distance_m: Array
    """Signed errors."""
    absolute_px: Array
    off_m: Array
    """Absolute errors."""
    pixel_rad: float
    """One pixel of disparity in radians."""
    by_disparity: Indices
    by_absolute: Indices
    by_off: Indices
    """Seen pixels by ascending error."""


def ranked(valid: Mask, found: Errors, grid: Grid) -> Ranked:
    """Sort a trial's errors."""
    disparity, distance = found.disparity_px.ravel(), found.range_m.ravel()
    seen = valid.ravel() & np.isfinite(disparity)
    absolute, off = np.abs(disparity), np.abs(distance)
    by_absolute = ascending(seen, absolute)
    # Negative ones from the largest down, then the others up: no need to sort again.
    negative = disparity[by_absolute] < 0
    by_disparity = np.concatenate([by_absolute[negative][::-1], by_absolute[~negative]])
    return Ranked(
        seen,
        disparity,
        distance,
        absolute,
        off,
        grid.phi_pitch,
        by_disparity=by_disparity,
        by_absolute=by_absolute,
        by_off=ascending(seen, off),
    )


def measure_more(domain: Mask, errors: Ranked, truth: Reference) -> Measures:
    """The rest of the field's usual figures.

    Disparity: mean absolute error, median signed error, shares of absolute errors above 0.5, 2 and 4 px, and the values
    that 50, 90, 95 and 99 % of them do not exceed. Range: mean relative absolute error, the scale-invariant
    logarithmic error (standard deviation of `log(estimate/truth)`), and the shares with
    `max(estimate/truth, truth/estimate)` below 1.05, 1.1 and 1.25.
    """
    inside = domain.ravel()
    chosen = errors.by_absolute[inside[errors.by_absolute]]
    if not chosen.size:
        return dict.fromkeys(MORE)
    absolute = errors.absolute_px[chosen]
    relative = errors.distance_m[chosen] / truth.range_m.ravel()[chosen]
    logarithm = np.log1p(relative)
    ratio = np.abs(logarithm)
    signed = errors.by_disparity[inside[errors.by_disparity]]
    quantiles = absolute[np.minimum((np.array([0.5, 0.9, 0.95, 0.99]) * absolute.size).astype(int), absolute.size - 1)]
    above = 1 - np.searchsorted(absolute, [0.5, 2, 4], side="right") / absolute.size
    within = [float(np.mean(ratio < np.log(limit))) for limit in (1.05, 1.1, 1.25)]
    values = [
        float(np.mean(absolute)),
        float(np.mean(errors.disparity_px[signed[[(signed.size - 1) // 2, signed.size // 2]]])),
        *above.tolist(),
        *quantiles.tolist(),
        float(np.mean(np.abs(relative))),
        float(np.std(logarithm)),
        *within,
    ]
    return dict(zip(MORE, values, strict=True))


def measure_by_solid_angle(domain: Mask, errors: Ranked, grid: Grid) -> Measures:
    """Core figures with every pixel weighted by the solid angle that it covers, `dphi dz/(1 + z²)^(3/2)`.

    A panorama's pixels do not cover the sphere evenly: near its lower border they are a fifth of those at the horizon.
    """
    weight = np.repeat((1 + grid.z**2) ** -1.5, grid.width_px)
    inside = domain.ravel()
    whole, pixels = float(weight[inside].sum()), inside & errors.seen
    measures: Measures = {"density": float(weight[pixels].sum() / whole) if whole else None}
    if not pixels.any():
        return measures | dict.fromkeys(CORE)
    w = weight[pixels] / weight[pixels].sum()
    disparity, distance = errors.disparity_px[pixels], errors.distance_m[pixels]
    values = [
        _weighted_median(errors.absolute_px, weight, errors.by_absolute[inside[errors.by_absolute]]),
        np.sqrt(np.sum(w * disparity**2)),
        np.sum(w * (np.abs(disparity) > 1)),
        _weighted_median(errors.off_m, weight, errors.by_off[inside[errors.by_off]]),
        np.sum(w * np.abs(distance)),
        np.sqrt(np.sum(w * distance**2)),
        np.sum(w * distance),
    ]
    return measures | dict(zip(CORE, map(float, values), strict=True))


def measure_regions(layout: Layout, errors: Ranked) -> list[dict[str, Any]]:
    """Core figures and the number of pixels of each part of the picture.

    Returns
    -------
    list
        Of tables: `split` (`surface`, `alpha_1`, ...), `part`, `pixels`, and the figures of `measure`.
    """
    groups, seen = layout.region_groups, errors.seen
    count = counts(groups, seen)
    disparity, distance = errors.disparity_px, errors.distance_m
    kinds = np.stack([disparity**2, errors.absolute_px > 1, errors.off_m, distance**2, distance], axis=1)
    square_px, gross, off_m, square_m, bias_m = means(groups, seen, count, kinds).T
    columns = [
        medians(groups, seen, count, errors.absolute_px, errors.by_absolute),
        np.sqrt(square_px),
        gross,
        medians(groups, seen, count, errors.off_m, errors.by_off),
        off_m,
        np.sqrt(square_m),
        bias_m,
    ]
    return [
        {
            "split": region.split,
            "part": region.part,
            "pixels": int(region.pixels.size),
            "density": float(number / region.pixels.size),
            **{name: float(value) if number else None for name, value in zip(CORE, values, strict=True)},
        }
        for region, number, values in zip(layout.regions, count, np.stack(columns, axis=1), strict=True)
    ]


def error_histogram(pixels: Mask, errors: Ranked) -> list[int]:
    """Counts of absolute disparity errors between `ERROR_EDGES_PX`; the last bin holds all larger ones."""
    chosen = errors.by_absolute[pixels.ravel()[errors.by_absolute]]
    below = np.searchsorted(errors.absolute_px[chosen], ERROR_EDGES_PX, side="left")
    below[-1] = chosen.size
    return [int(count) for count in np.diff(below)]


def fraction_histogram(pixels: Mask, k: Array) -> list[int]:
    """Counts of the estimates' positions between two samples, 0 .. 1 in `FRACTION_BINS`: pixel locking shows as peaks.

    Shifted by half a bin, so that whole samples fall into the middle of the first one.
    """
    bins = np.floor(k[pixels] * FRACTION_BINS + 0.5).astype(np.int64) % FRACTION_BINS
    return [int(count) for count in np.bincount(bins, minlength=FRACTION_BINS)]


def _share(part: Mask, whole: Mask) -> float | None:
    return float(np.count_nonzero(part) / np.count_nonzero(whole)) if whole.any() else None


def _weighted_median(values: Array, weights: Array, order: Indices) -> float:
    """The value up to which half of the weight lies. order : pixels by ascending value."""
    reached = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(reached, 0.5 * reached[-1])]])
