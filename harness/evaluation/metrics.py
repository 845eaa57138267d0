"""The figures that sum up an estimate. A pixel without an estimate counts in the density and nowhere else."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.cells import ALPHA_1_EDGES_DEG
from harness.evaluation.errors import MIN_SINE_ALPHA_1, Errors, Reference
from harness.simulation.truth import Truth
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
SLANTED_DEG = 60.0
"""A surface is slanted where its normal is farther than this from the line of sight."""

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
    disparity, distance = found.disparity_px[pixels], found.range_m[pixels]
    measures: Measures = {"density": _share(pixels, domain)}
    if not disparity.size:
        return measures | dict.fromkeys(CORE)
    absolute, off = np.abs(disparity), np.abs(distance)
    return measures | {
        "disparity_median_abs_px": float(np.median(absolute)),
        "disparity_rmse_px": float(np.sqrt(np.mean(disparity**2))),
        "bad_1px": float(np.mean(absolute > 1)),
        "range_median_abs_m": float(np.median(off)),
        "range_mae_m": float(np.mean(off)),
        "range_rmse_m": float(np.sqrt(np.mean(distance**2))),
        "range_bias_m": float(np.mean(distance)),
    }


def measure_more(domain: Mask, valid: Mask, found: Errors, truth: Reference) -> Measures:
    """The rest of the field's usual figures.

    Disparity: mean absolute error, median signed error, shares of absolute errors above 0.5, 2 and 4 px, and the values that
    50, 90, 95 and 99 % of them do not exceed. Range: mean relative absolute error, the scale-invariant logarithmic error
    (standard deviation of `log(estimate/truth)`), and the shares with `max(estimate/truth, truth/estimate)` below 1.05,
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


def measure_regions(
    valid: Mask, found: Errors, reference: Reference, truth: Truth, grid: Grid, d_v1: Array
) -> list[dict[str, Any]]:
    """Core figures, the number of pixels and a name for each part of the picture.

    Parameters
    ----------
    d_v1
        `[height, width, 3]`, unit directions of the pixels in the world's orientation, for the slant.

    Returns
    -------
    list
        Of tables: `split` (`surface`, `alpha_1_deg`, ...), `part`, `pixels`, and the figures of `measure`.
    """
    return [
        {"split": split, "part": part, "pixels": int(np.count_nonzero(mask)), **measure(mask, valid, found)}
        for split, part, mask in _regions(reference, truth, grid, d_v1)
    ]


def _regions(reference: Reference, truth: Truth, grid: Grid, d_v1: Array) -> Iterator[tuple[str, str, Mask]]:
    domain = reference.domain
    looked_at = np.sin(reference.alpha_1) >= MIN_SINE_ALPHA_1
    # Occluded pixels lie outside the domain: there is no true match, and an estimate is an invention.
    yield "visibility", "visible in both", domain
    yield (
        "visibility",
        "occluded in view 2",
        looked_at & truth.in_field_2 & ~truth.unoccluded & np.isfinite(truth.range_m),
    )
    yield "surface", "wall", domain & reference.wall
    yield "surface", "floor or ceiling", domain & ~reference.wall
    yield "kind", "discontinuity", domain & truth.discontinuity
    yield "kind", "textureless", domain & truth.textureless
    cosine = np.abs(np.sum(truth.normal * d_v1, axis=-1))
    with np.errstate(invalid="ignore"):
        slanted = cosine < np.cos(np.radians(SLANTED_DEG))
    yield "kind", f"slanted by more than {SLANTED_DEG:.0f} deg", domain & slanted
    yield "kind", "none of these", domain & ~truth.discontinuity & ~truth.textureless & ~slanted
    alpha_deg = np.degrees(reference.alpha_1)
    for low, high in zip(ALPHA_1_EDGES_DEG[:-1], ALPHA_1_EDGES_DEG[1:], strict=True):
        yield "alpha_1", f"{low:.0f} to {high:.0f} deg", domain & (alpha_deg >= low) & (alpha_deg < high)
    elevation = np.degrees(np.arctan(grid.z))[:, None]
    for low, high in ((-90, -40), (-40, -20), (-20, 0), (0, 90)):
        yield "elevation", f"{low} to {high} deg", domain & (elevation >= low) & (elevation < high)
    edges = (0.0, 1.5, 2.0, 3.0, 4.0, 6.0, np.inf)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        with np.errstate(invalid="ignore"):
            yield "range", f"{low:g} to {high:g} m", domain & (reference.range_m >= low) & (reference.range_m < high)


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
    order = np.argsort(values, kind="stable")
    half_way = np.searchsorted(np.cumsum(weights[order]), 0.5)
    return float(values[order][min(int(half_way), values.size - 1)])
