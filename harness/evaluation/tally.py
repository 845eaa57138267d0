"""A trial's errors added up and sorted, once for all figures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from harness.evaluation import _grouping_kernels as _kernels
from harness.evaluation.groups import Groups, Indices, ascending, mean_of_middles, medians
from harness.evaluation.pixel_errors import Errors
from harness.evaluation.regions import SURFACES, Layout
from harness.evaluation.shape_scores import ShapeScores, shape_scores
from harness.geometry.angles import Array

Mask = NDArray[np.bool_]

ERROR_EDGES_PX = np.concatenate([[0.0], np.geomspace(1e-3, 300, 56)])
"""Edges of the histogram of absolute disparity errors, from which distributions are drawn."""

FRACTION_BINS = 40

_QUANTILES = np.array([0.5, 0.9, 0.95, 0.99])
_LIMITS_PX = np.array([0.5, 2.0, 4.0])
_LIMITS_RATIO = np.log([1.05, 1.1, 1.25])
_EDGE_BITS = ERROR_EDGES_PX.astype(np.float32).view(np.uint32)


@dataclass(frozen=True)
class Tally:
    """A trial's errors, added up and sorted once for all figures. Arrays `[n]` are of `layout.groups.pixels`."""

    layout: Layout
    scored: Mask
    """`[n]`: with an error, which takes an estimate and a truth."""
    count: NDArray[np.int64]
    """`[groups]`: scored pixels of each."""
    sums: Array
    """`[groups, kinds]`, of their errors; kinds are columns of `_kernels`."""
    median_abs_px: Array
    median_abs_m: Array
    median_px: Array
    """`[groups]`; the last one of signed errors. NaN where nothing is scored."""
    mean_abs_px: float
    abs_rel: float
    logarithm: Array
    """`[scored pixels of the domain]`: log(estimate/truth)."""
    above: NDArray[np.int64]
    within: NDArray[np.int64]
    """Scored pixels of the domain with an error above each of three limits, and with a ratio below each of three."""
    weighted: Array
    """`[kinds]`: the sums over the domain, weighted by solid angle; see `_kernels.add_errors`."""
    quantiles_px: Array
    """Quantiles of the domain's absolute errors: the median weighted by solid angle, and four that are not weighted."""
    weighted_median_m: float
    histogram: NDArray[np.int64]
    """`[surfaces, bins]`: absolute errors in pixels between `ERROR_EDGES_PX`."""

    errors: Errors
    valid: Mask
    """`[height, width]`: pixels with an estimate."""

    @cached_property
    def shape(self) -> ShapeScores:
        """The figures of the map's shape; made when one of them is asked for."""
        return shape_scores(self.layout.shape, self.errors.range_m, self.errors.disparity_px, self.valid)

    @property
    def sq_rel_m(self) -> float:
        """The mean over the domain of the squared error over the true range, metres."""
        true = self.layout.range_m[self.scored & (self.layout.surface >= 0)]
        return float(np.mean(true * np.expm1(self.logarithm) ** 2))

    @property
    def matched(self) -> int:
        """Number of pixels of the domain with an estimate."""
        return self.logarithm.size


def _pixels_of(middles: Indices, groups: Groups) -> Indices:
    """The pixels of the picture that middles are at; -1 for an empty group."""
    return np.where(middles < 0, -1, groups.pixels[middles]) if groups.pixels.size else middles


def tally(layout: Layout, valid: Mask, errors: Errors) -> Tally:
    """Add up and sort a trial's errors.

    Parameters
    ----------
    valid
        `[height, width]`: pixels with an estimate; one without a true point is left out.
    """
    groups, surface, weight = layout.groups, layout.surface, layout.solid_angle
    disparity, distance = errors.disparity_px.ravel(), errors.range_m.ravel()
    size = groups.pixels.size
    scored, strata = np.empty(size, dtype=bool), np.empty(size, dtype=np.int32)
    absolute_px, off_m, logarithm = np.empty((3, size))
    of_class, sums = (np.zeros((len(each), _kernels.KINDS)) for each in (groups.labels, groups.sizes))
    weighted, domain, (above, within) = np.zeros(_kernels.KINDS), np.zeros(3), np.zeros((2, 3), dtype=np.int64)
    _kernels.add_errors(
        groups.pixels, groups.classes, surface, weight, layout.range_m, disparity, distance, valid.ravel(),
        _LIMITS_PX, _LIMITS_RATIO,
        scored, strata, absolute_px, off_m, logarithm, of_class, domain, weighted, above, within,
    )  # fmt: skip
    _kernels.add_classes(groups.labels, of_class, sums)
    count, negative = sums[:, [_kernels.COUNT, _kernels.NEGATIVE]].astype(np.int64).T
    number = int(domain[0])
    by_px, by_m = ascending(scored, absolute_px), ascending(scored, off_m)
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
        scored=scored,
        count=count,
        sums=sums,
        median_abs_px=mean_of_middles(middles_px, absolute_px),
        median_abs_m=mean_of_middles(middles_m, off_m),
        median_px=mean_of_middles(_pixels_of(middles_signed, groups), disparity),
        mean_abs_px=float(mean_abs_px),
        abs_rel=float(abs_rel),
        logarithm=logarithm[:number],
        above=above,
        within=within,
        weighted=weighted,
        quantiles_px=quantiles,
        weighted_median_m=_kernels.weighted_middle(by_m, off_m, surface, weight, half),
        histogram=histogram,
        errors=errors,
        valid=valid,
    )
