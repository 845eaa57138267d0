"""The quality of a matcher's confidence: does it rank the errors, and is a predicted spread the true one?

Three questions, each a pure function of arrays of any one shape. Pixels without an error (no estimate, or no truth:
NaN) are left out. An estimate whose confidence is NaN counts as the least confident.

Equal confidences are never put in an order that the arrays do not hold: results depend neither on the order of pixels
nor on the sort.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.geometry.angles import Array

Statistic = Literal["mean", "median"]

STEPS = 100
"""Shares removed: 0, 1, ... 99 %."""

EXPECTED_WITHIN = (0.6826894921370859, 0.9544997361036416, 0.9973002039367398)
"""Share of a normal distribution within 1, 2 and 3 standard deviations."""

_MAD_TO_STD = 1.482602218505602
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Sparsification:
    """The error of what remains when the least confident are removed; in the error's unit, NaN without any error."""

    removed: Array
    """`[STEPS]`: share of the pixels removed, from 0: 0, 1, ... 99 % in whole pixels; at least one remains."""
    remaining: Array
    """`[STEPS]`: mean or median of |error| over the rest."""
    oracle: Array
    """`[STEPS]`: the same when the largest errors are removed first, which no confidence can beat."""
    random: float
    """The error of the rest for a random confidence, at any share: that of all pixels."""
    ause: float
    """Area between `remaining` and `oracle` over the shares removed (area under the sparsification error)."""
    ause_over_random: float
    """`ause` over the area between `random` and `oracle`: 0 for the oracle, 1 for a random confidence."""
    pixels: int
    """Number of pixels with an error."""


def sparsification(error: ArrayLike, confidence: ArrayLike, *, statistic: Statistic = "mean") -> Sparsification:
    """Sparsification curve of a confidence, as introduced for optical flow (Ilg et al., ECCV 2018).

    Where a share ends within a group of equal confidences, all of the group stay with the same part of their weight:
    for the mean that is its expectation over all orders.

    Parameters
    ----------
    error
        Signed or absolute; NaN for a pixel without an error.
    confidence
        Of the same shape; higher is more confident. Only its order counts.
    """
    error, confidence = _paired(error, confidence)
    has_error = ~np.isnan(error)
    absolute, ordered_by = np.abs(error[has_error]), _least_if_missing(confidence[has_error])
    counts = np.maximum(absolute.size - np.arange(STEPS) * absolute.size // STEPS, 1)
    if not absolute.size:
        nothing = np.full(STEPS, np.nan)
        return Sparsification(np.arange(STEPS) / STEPS, nothing, nothing, np.nan, np.nan, np.nan, 0)
    removed = 1 - counts / absolute.size
    remaining = _remaining(absolute, ordered_by, counts, statistic)
    oracle = _remaining(absolute, -absolute, counts, statistic)
    ause = float(np.trapezoid(remaining - oracle, removed))
    worst = float(np.trapezoid(remaining[0] - oracle, removed))
    return Sparsification(
        removed=removed,
        remaining=remaining,
        oracle=oracle,
        random=float(remaining[0]),
        ause=ause,
        ause_over_random=ause / worst if worst > 0 else np.nan,
        pixels=absolute.size,
    )


@dataclass(frozen=True)
class Calibration:
    """Errors in units of the standard deviation that was predicted for each; NaN without any."""

    within: tuple[float, float, float]
    """Share with |error| at most 1, 2 and 3 predicted standard deviations; `EXPECTED_WITHIN` if normal and right."""
    spread: float
    """Robust standard deviation of error/sigma, 1.4826 times the median absolute deviation from the median: above 1 the
    prediction is too small."""
    bias: float
    """Median of error/sigma."""
    pixels: int
    """Number of pixels with an error and a prediction that is finite and above zero."""
    predicted: float
    """`pixels` over the number of all pixels with an error."""


def calibration(error: ArrayLike, sigma: ArrayLike) -> Calibration:
    """Errors in units of the standard deviation that was predicted for each.

    Parameters
    ----------
    error
        Signed; NaN for a pixel without an error.
    sigma
        Of the same shape and unit. One that is NaN, infinite or not above zero is no prediction.
    """
    error, sigma = _paired(error, sigma)
    has_error = ~np.isnan(error)
    counted = has_error & np.isfinite(sigma) & (sigma > 0)
    share = float(counted.sum() / has_error.sum()) if has_error.any() else np.nan
    if not counted.any():
        return Calibration((np.nan, np.nan, np.nan), np.nan, np.nan, 0, share)
    scaled = error[counted] / sigma[counted]
    one, two, three = (float(np.mean(np.abs(scaled) <= k)) for k in (1, 2, 3))
    bias = float(np.median(scaled))
    spread = _MAD_TO_STD * float(np.median(np.abs(scaled - bias)))
    return Calibration((one, two, three), spread, bias, int(counted.sum()), share)


@dataclass(frozen=True)
class Roc:
    """The receiver operating characteristic of thresholds on confidence that separate bad pixels from good ones."""

    caught: Array
    """`[thresholds + 1]`: share of the bad pixels below each threshold, ascending from 0 to 1 (true positives)."""
    lost: Array
    """`[thresholds + 1]`: share of the good pixels below it (false positives). NaN without any, as is `caught`."""
    auc: float
    """Area under `caught` over `lost`: the chance that a bad pixel has less confidence than a good one, ties half. NaN
    unless there are both."""
    bad: int
    good: int


def roc(confidence: ArrayLike, bad: ArrayLike, *, among: ArrayLike | None = None) -> Roc:
    """Receiver operating characteristic of confidence as a warning of bad pixels.

    Parameters
    ----------
    confidence
        Higher is more confident; only its order counts.
    bad
        Of the same shape, bool: such as errors above one pixel (`exceeding`), or pixels without texture.
    among
        Of the same shape, bool: the pixels that count; all when not given.
    """
    confidence = np.asarray(confidence, dtype=np.float64)
    chosen = np.ones(confidence.shape, dtype=bool) if among is None else np.asarray(among, dtype=bool)
    bad = np.asarray(bad, dtype=bool)
    if not confidence.shape == bad.shape == chosen.shape:
        raise ValueError(f"shapes differ: {confidence.shape}, {bad.shape}, {chosen.shape}")
    _, level = np.unique(_least_if_missing(confidence[chosen]), return_inverse=True)
    is_bad = bad[chosen]
    levels = int(level.max()) + 1 if level.size else 0
    below_bad, below_good = (
        np.concatenate([[0], np.cumsum(np.bincount(level[which], minlength=levels))]) for which in (is_bad, ~is_bad)
    )
    n_bad, n_good = int(below_bad[-1]), int(below_good[-1])
    caught = below_bad / n_bad if n_bad else np.full(levels + 1, np.nan)
    lost = below_good / n_good if n_good else np.full(levels + 1, np.nan)
    auc = float(np.trapezoid(caught, lost)) if n_bad and n_good else np.nan
    return Roc(caught, lost, auc, n_bad, n_good)


def exceeding(error: ArrayLike, limit: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The pixels whose |error| is above a limit, and those with an error at all: `bad` and `among` of `roc`."""
    error = np.asarray(error, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(error) > limit), np.asarray(~np.isnan(error))


def _paired(error: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    error, other = np.asarray(error, dtype=np.float64), np.asarray(other, dtype=np.float64)
    if error.shape != other.shape:
        raise ValueError(f"shapes differ: {error.shape}, {other.shape}")
    return error, other


def _least_if_missing(confidence: Array) -> Array:
    return np.where(np.isnan(confidence), -np.inf, confidence)


def _remaining(absolute: Array, ordered_by: Array, counts: NDArray[np.intp], statistic: Statistic) -> Array:
    """The statistic over the most confident pixels, for each of `counts`."""
    # By confidence, and by error among equal ones: an order that does not depend on that of the pixels.
    order = np.lexsort((absolute, -ordered_by))
    absolute, ordered_by = absolute[order], ordered_by[order]
    first = np.concatenate([[True], ordered_by[1:] != ordered_by[:-1]])
    start = np.flatnonzero(first)
    end = np.append(start[1:], absolute.size)
    if statistic == "mean":
        # A sum grows evenly within a group.
        sums = np.cumsum(np.add.reduceat(absolute, start))
        return np.asarray(np.interp(counts, np.append(0, end), np.append(0.0, sums)) / counts)
    group = np.cumsum(first)[counts - 1] - 1
    medians = np.empty(counts.size)
    for i, (count, low, high) in enumerate(zip(counts, start[group], end[group], strict=True)):
        if count == high:
            medians[i] = np.median(absolute[:high])
        else:
            weight = np.ones(high)
            weight[low:] = (count - low) / (high - low)
            medians[i] = _weighted_median(absolute[:high], weight)
    return medians


def _weighted_median(values: Array, weight: Array) -> float:
    """Least value that half the weight does not exceed; the middle of two where exactly half stops between them."""
    order = np.argsort(values, kind="stable")
    ascending, passed = values[order], np.cumsum(weight[order])
    # Fractions of pixels add up to exactly half only by chance, up to the rounding of the sum.
    half, slack = 0.5 * passed[-1], 1e-12 * passed[-1]
    low = int(np.searchsorted(passed, half - slack))
    high = int(np.searchsorted(passed, half + slack, side="right"))
    return float(0.5 * (ascending[low] + ascending[min(high, ascending.size - 1)]))
