"""The figures that sum up an estimate. A pixel without an estimate counts in the density and nowhere else."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.evaluation import _grouping_kernels as _kernels
from harness.evaluation.errors import Errors
from harness.evaluation.groups import ascending, mean_of_middles, medians
from harness.evaluation.regions import SURFACES, Layout
from harness.geometry.angles import Array

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

_QUANTILES = np.array([0.5, 0.9, 0.95, 0.99])
_LIMITS_PX = np.array([0.5, 2.0, 4.0])
_LIMITS_RATIO = np.log([1.05, 1.1, 1.25])
_EDGE_BITS = ERROR_EDGES_PX.astype(np.float32).view(np.uint32)


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
class Tally:
    """A trial's errors, added up and sorted once for all figures. Arrays `[n]` are of `layout.groups.pixels`."""

    layout: Layout
    seen: Mask
    """`[n]`: with an estimate."""
    count: NDArray[np.int64]
    """`[groups]`: seen pixels of each."""
    sums: Array
    """`[groups, kinds]`, of their errors; kinds are columns of `_kernels`."""
    median_abs_px: Array
    median_abs_m: Array
    median_px: Array
    """`[groups]`; the last one of signed errors. NaN where nothing is seen."""
    mean_abs_px: float
    abs_rel: float
    logarithm: Array
    """`[seen pixels of the domain]`: log(estimate/truth)."""
    above: NDArray[np.int64]
    within: NDArray[np.int64]
    """Seen pixels of the domain with an error above each of three limits, and with a ratio below each of three."""
    weighted: Array
    """`[kinds]`: the sums over the domain, weighted by solid angle; see `_kernels.add_errors`."""
    quantiles_px: Array
    """Of the domain's absolute errors: the median weighted by solid angle, and four that are not weighted."""
    weighted_median_m: float
    histogram: NDArray[np.int64]
    """`[surfaces, bins]`: absolute errors in pixels between `ERROR_EDGES_PX`."""


def tally(layout: Layout, valid: Mask, found: Errors) -> Tally:
    """Add up and sort a trial's errors.

    Parameters
    ----------
    valid
        `[height, width]`: pixels with an estimate; one without a true point is left out.
    """
    groups, surface, weight = layout.groups, layout.surface, layout.solid_angle
    disparity, distance = found.disparity_px.ravel(), found.range_m.ravel()
    size = groups.pixels.size
    seen, strata = np.empty(size, dtype=bool), np.empty(size, dtype=np.int32)
    absolute_px, off_m, logarithm = np.empty((3, size))
    of_class, sums = (np.zeros((len(each), _kernels.KINDS)) for each in (groups.labels, groups.sizes))
    weighted, domain, (above, within) = np.zeros(_kernels.KINDS), np.zeros(3), np.zeros((2, 3), dtype=np.int64)
    _kernels.add_errors(
        groups.pixels, groups.classes, surface, weight, layout.range_m, disparity, distance, valid.ravel(),
        _LIMITS_PX, _LIMITS_RATIO,
        seen, strata, absolute_px, off_m, logarithm, of_class, domain, weighted, above, within,
    )  # fmt: skip
    _kernels.add_classes(groups.labels, of_class, sums)
    count, negative = sums[:, [_kernels.COUNT, _kernels.NEGATIVE]].astype(np.int64).T
    number = int(domain[0])
    by_px, by_m = ascending(seen, absolute_px), ascending(seen, off_m)
    middles_px, middles_signed = medians(groups, strata, count, negative, by_px)
    middles_m, _ = medians(groups, strata, count, negative, by_m)
    ranks = np.minimum((_QUANTILES * number).astype(np.int64), number - 1)
    histogram, quantiles = np.zeros((len(SURFACES), ERROR_EDGES_PX.size - 1), dtype=np.int64), np.full(5, np.nan)
    half = weighted[_kernels.COUNT] / 2
    _kernels.distribution(
        by_px, absolute_px, surface, weight, half, ERROR_EDGES_PX, _EDGE_BITS, ranks, histogram, quantiles
    )
    with np.errstate(invalid="ignore"):
        mean_abs_px, abs_rel = domain[1:] / number
    return Tally(
        layout=layout,
        seen=seen,
        count=count,
        sums=sums,
        median_abs_px=mean_of_middles(middles_px, absolute_px),
        median_abs_m=mean_of_middles(middles_m, off_m),
        median_px=mean_of_middles(middles_signed, disparity[groups.pixels]),
        mean_abs_px=float(mean_abs_px),
        abs_rel=float(abs_rel),
        logarithm=logarithm[:number],
        above=above,
        within=within,
        weighted=weighted,
        quantiles_px=quantiles,
        weighted_median_m=_kernels.weighted_middle(by_m, off_m, surface, weight, half),
        histogram=histogram,
    )


def measure_more(errors: Tally) -> Measures:
    """The rest of the field's usual figures, over the domain.

    Disparity: mean absolute error, median signed error, shares of absolute errors above 0.5, 2 and 4 px, and the values
    that 50, 90, 95 and 99 % of them do not exceed. Range: mean relative absolute error, the scale-invariant
    logarithmic error (standard deviation of `log(estimate/truth)`), and the shares with
    `max(estimate/truth, truth/estimate)` below 1.05, 1.1 and 1.25.
    """
    number = errors.logarithm.size
    if not number:
        return dict.fromkeys(MORE)
    values = [
        errors.mean_abs_px,
        errors.median_px[0],
        *(errors.above / number),
        *errors.quantiles_px[1:],
        errors.abs_rel,
        np.std(errors.logarithm),
        *(errors.within / number),
    ]
    return dict(zip(MORE, map(float, values), strict=True))


def measure_by_solid_angle(errors: Tally) -> Measures:
    """Core figures of the domain with every pixel weighted by the solid angle that it covers, `dphi dz/(1 + z²)^(3/2)`.

    A panorama's pixels do not cover the sphere evenly: near its lower border they are a fifth of those at the horizon.
    """
    sums = errors.weighted
    seen, whole = float(sums[_kernels.COUNT]), float(sums[_kernels.NEGATIVE])
    measures: Measures = {"density": seen / whole if whole else None}
    if not seen:
        return measures | dict.fromkeys(CORE)
    mean = sums / seen
    return measures | _core_of(mean, errors.quantiles_px[0], errors.weighted_median_m)


def measure_regions(errors: Tally) -> list[dict[str, Any]]:
    """Core figures and the number of pixels of each part of the picture.

    Returns
    -------
    list
        Of tables: `split` (`surface`, `alpha_1`, ...), `part`, `pixels`, and the figures of `measure`.
    """
    table = []
    for i, region in enumerate(errors.layout.regions):
        number = int(errors.count[i])
        row = {"split": region.split, "part": region.part, "pixels": int(region.pixels.size)}
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
    _kernels.add_fractions(errors.layout.groups.pixels, errors.layout.surface, errors.seen, k.ravel(), histogram)
    return dict(zip(SURFACES, histogram.tolist(), strict=True))


def share_of_estimates(errors: Tally, flags: Mask) -> float | None:
    """Share of the domain's estimates that have a flag `[height, width]`; None where there are none."""
    layout, number = errors.layout, errors.logarithm.size
    found = _kernels.count_flags(layout.groups.pixels, layout.surface, errors.seen, flags.ravel())
    return float(found / number) if number else None


def _share(part: Mask, whole: Mask) -> float | None:
    return float(np.count_nonzero(part) / np.count_nonzero(whole)) if whole.any() else None
