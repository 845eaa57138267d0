"""Means over seeds with their intervals, for figures and tables.

Pixels of one image are correlated, and so are the trials of one seed, which share a viewpoint and its noise: only seeds
are resampled.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from harness.geometry.angles import Array

if TYPE_CHECKING:  # loading it takes long, and few callers need it
    import pandas as pd

DRAWS = 1000
FEW_SEEDS = 8
"""Intervals from fewer seeds than these come out too short; the report says so."""
_ENDS = (0.025, 0.975)
SHARE = 0.682689492
"""Share of a normal distribution within one standard deviation."""


@dataclass(frozen=True)
class Curve:
    """Means over seeds at some values of an axis."""

    x: list[object]
    mean: Array
    low: Array
    high: Array
    """The 95 % interval; NaN where there is one seed only."""


def mean_over_seeds(values: "pd.DataFrame", *, logarithmic: bool = False) -> Curve:
    """Means of the columns, with intervals by bootstrap over seeds.

    Parameters
    ----------
    values
        One row a group, one column a value of the axis; `seed` is the first level of the rows' index. Missing values
        are left out.
    logarithmic
        Geometric means of positive values.
    """
    import pandas as pd

    table = values.to_numpy(dtype=np.float64)
    if logarithmic:
        table = np.log(table, out=np.full(table.shape, np.nan), where=table > 0)
    codes, names = pd.factorize(values.index.get_level_values(0), sort=True)
    belongs = (codes == np.arange(len(names))[:, None]).astype(np.float64)
    known = ~np.isnan(table)
    sums, counts = belongs @ np.where(known, table, 0.0), belongs @ known
    weights = resampled(len(sums))
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (weights @ sums) / (weights @ counts)
    low, high = between(means[1:], len(sums))
    if logarithmic:
        means, low, high = np.exp(means), np.exp(low), np.exp(high)
    return Curve(list(values.columns), means[0], low, high)


def mean_with_interval(values: Array) -> tuple[float, list[float] | None]:
    """The mean, and its 95 % interval by bootstrap over seeds; None of one seed."""
    weights = resampled(len(values))
    means = (weights @ values) / weights.sum(axis=1)
    if len(values) < 2:
        return float(means[0]), None
    low, high = between(means[1:, None], len(values))
    return float(means[0]), [float(low[0]), float(high[0])]


def median_over_seeds(values: Array, seeds: NDArray[np.integer]) -> tuple[float, float, float]:
    """Median of all values, with an interval by bootstrap over seeds."""
    order = np.argsort(values, kind="stable")
    values = values[order]
    names, index = np.unique(seeds[order], return_inverse=True)
    weights = resampled(names.size, 200)
    # How many values each seed has up to each place: what a draw weighs up to there grows with the place.
    counts = np.cumsum(index == np.arange(names.size)[:, None], axis=1, dtype=np.float64).T
    half = 0.5 * (weights @ counts[-1])
    low, high = np.zeros(len(weights), dtype=np.intp), np.full(len(weights), values.size - 1)
    while (low < high).any():
        middle = (low + high) // 2
        reached = np.einsum("ij,ij->i", weights, counts[middle]) >= half
        low, high = np.where(reached, low, middle + 1), np.where(reached, middle, high)
    medians = values[low]
    ends = between(medians[1:, None], names.size)
    return float(medians[0]), float(ends[0][0]), float(ends[1][0])


def weighted_median(values: Array, weights: Array) -> float:
    """The value up to which half of the weight lies."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(reached, 0.5 * reached[-1])]])


def central_68(sigma_m: Array) -> float:
    """The error that 68.3 % of the points stay within: of a mixture of normal distributions, one for each point."""
    known = sigma_m[np.isfinite(sigma_m)]
    if not known.size or known.size < SHARE * sigma_m.size:
        return float("inf")
    share, scale = SHARE * sigma_m.size / known.size, 1 / (np.sqrt(2) * np.maximum(known, 1e-300))
    low, high = 0.0, 5 * float(known.max())  # 5 sigma hold all but 6e-7
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if erf(middle * scale).mean() < share else (low, middle)
    return high


def balanced(values: "pd.DataFrame") -> "pd.DataFrame":
    """The groups that have a value everywhere on the axis, if there are any; an axis value without any stays."""
    known = values.loc[:, values.notna().any()]
    complete = known.dropna().index
    return values.loc[complete] if len(complete) else values


def between(draws: Array, seeds: int) -> tuple[Array, Array]:
    """The 95 % interval of bootstrap draws `[draws, ...]`; NaN from one seed."""
    if seeds < 2:
        nothing = np.full(draws.shape[1:], np.nan)
        return nothing, nothing
    flat = draws.reshape(len(draws), -1)
    missing = np.isnan(flat)
    ends = np.full((2, flat.shape[1]), np.nan)
    complete = ~missing.any(axis=0)
    ends[:, complete] = np.quantile(flat[:, complete], _ENDS, axis=0)
    for column in np.flatnonzero(~complete & ~missing.all(axis=0)):  # nanquantile takes as long for every column
        ends[:, column] = np.quantile(flat[~missing[:, column], column], _ENDS)
    low, high = ends.reshape(2, *draws.shape[1:])
    return low, high


@lru_cache(maxsize=64)
def resampled(seeds: int, draws: int = DRAWS) -> Array:
    """Bootstrap weights of seeds `[1 + draws, seeds]`: first one for each, then as often as drawn; read-only."""
    drawn = np.random.default_rng(0).multinomial(seeds, np.full(seeds, 1 / seeds), size=draws)
    weights = np.concatenate([np.ones((1, seeds)), drawn.astype(np.float64)])
    weights.flags.writeable = False
    return weights
