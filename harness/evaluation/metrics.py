"""The figures that sum up an estimate. A pixel without an estimate counts in the density and nowhere else."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.errors import Errors, Reference
from harness.evaluation.regions import Region
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


def measure_more(domain: Mask, valid: Mask, found: Errors, truth: Reference) -> Measures:
    """The rest of the field's usual figures.

    Disparity: mean absolute error, median signed error, shares of absolute errors above 0.5, 2 and 4 px, and the values
    that 50, 90, 95 and 99 % of them do not exceed. Range: mean relative absolute error, the scale-invariant
    logarithmic error (standard deviation of `log(estimate/truth)`), and the shares with
    `max(estimate/truth, truth/estimate)` below 1.05,
    1.1 and 1.25.
    """
    pixels = domain & valid
    disparity = found.disparity_px[pixels]
    if not disparity.size:
        return dict.fromkeys(MORE)
    true_m = truth.range_m[pixels]
    relative = found.range_m[pixels] / true_m
    ratio = np.abs(np.log1p(relative))
    absolute = np.sort(np.abs(disparity))
    quantiles = absolute[np.minimum((np.array([0.5, 0.9, 0.95, 0.99]) * absolute.size).astype(int), absolute.size - 1)]
    above = 1 - np.searchsorted(absolute, [0.5, 2, 4], side="right") / absolute.size
    within = [float(np.mean(ratio < np.log(limit))) for limit in (1.05, 1.1, 1.25)]
    values = [
        float(np.mean(absolute)),
        float(np.median(disparity)),
        *above.tolist(),
        *quantiles.tolist(),
        float(np.mean(np.abs(relative))),
        float(np.std(np.log1p(relative))),
        *within,
    ]
    return dict(zip(MORE, values, strict=True))


def measure_by_solid_angle(domain: Mask, valid: Mask, found: Errors, grid: Grid) -> Measures:
    """Core figures with every pixel weighted by the solid angle that it covers, `dphi dz/(1 + z²)^(3/2)`.

    A panorama's pixels do not cover the sphere evenly: near its lower border they are a fifth of those at the horizon.
    """
    weight = np.broadcast_to((1 + grid.z[:, None] ** 2) ** -1.5, grid.shape)
    pixels = domain & valid
    measures: Measures = {"density": _share(pixels, domain, weight)}
    if not pixels.any():
        return measures | dict.fromkeys(CORE)
    w = weight[pixels] / weight[pixels].sum()
    disparity, distance = found.disparity_px[pixels], found.range_m[pixels]
    return measures | {
        "disparity_median_abs_px": _weighted_median(np.abs(disparity), w),
        "disparity_rmse_px": float(np.sqrt(w @ disparity**2)),
        "bad_1px": float(w @ (np.abs(disparity) > 1)),
        "range_median_abs_m": _weighted_median(np.abs(distance), w),
        "range_mae_m": float(w @ np.abs(distance)),
        "range_rmse_m": float(np.sqrt(w @ distance**2)),
        "range_bias_m": float(w @ distance),
    }


def measure_regions(parts: tuple[Region, ...], valid: Mask, found: Errors) -> list[dict[str, Any]]:
    """Core figures and the number of pixels of each part of the picture.

    Returns
    -------
    list
        Of tables: `split` (`surface`, `alpha_1`, ...), `part`, `pixels`, and the figures of `measure`.
    """
    seen, disparity, distance = valid.ravel(), found.disparity_px.ravel(), found.range_m.ravel()
    table = []
    for region in parts:
        have = region.pixels[seen[region.pixels]]
        density = have.size / region.pixels.size
        table.append(
            {
                "split": region.split,
                "part": region.part,
                "pixels": int(region.pixels.size),
                "density": density,
                **_core(disparity[have], distance[have]),
            }
        )
    return table


def error_histogram(pixels: Mask, found: Errors) -> list[int]:
    """Counts of absolute disparity errors between `ERROR_EDGES_PX`; the last bin holds all larger ones."""
    absolute = np.minimum(np.abs(found.disparity_px[pixels]), ERROR_EDGES_PX[-1])
    return [int(count) for count in np.histogram(absolute, ERROR_EDGES_PX)[0]]


def fraction_histogram(pixels: Mask, k: Array) -> list[int]:
    """Counts of the estimates' positions between two samples, 0 .. 1 in `FRACTION_BINS`: pixel locking shows as peaks.

    Shifted by half a bin, so that whole samples fall into the middle of the first one.
    """
    fraction = np.mod(k[pixels] + 0.5 / FRACTION_BINS, 1.0)
    return [int(count) for count in np.histogram(fraction, FRACTION_BINS, (0.0, 1.0))[0]]


def _share(part: Mask, whole: Mask, weight: Array | None = None) -> float | None:
    if not whole.any():
        return None
    if weight is None:
        return float(np.count_nonzero(part) / np.count_nonzero(whole))
    return float(weight[part].sum() / weight[whole].sum())


def _weighted_median(values: Array, weights: Array) -> float:
    """The value (none negative) up to which half of the weight lies, without sorting them all.

    The leading bits of a positive float are in its order, so they serve as bins; only the median's bin is sorted.
    """
    bins = values.astype(np.float32).view(np.uint32) >> np.uint32(15)
    below = np.cumsum(np.bincount(bins, weights))
    chosen = int(np.searchsorted(below, 0.5 * below[-1]))
    inside = bins == chosen
    order = np.argsort(values[inside], kind="stable")
    reached = np.cumsum(weights[inside][order]) + (below[chosen - 1] if chosen else 0.0)
    place = min(int(np.searchsorted(reached, 0.5 * below[-1])), order.size - 1)
    return float(values[inside][order[place]])
