"""Means over seeds with their intervals, for figures and tables.

Pixels of one image are correlated, and so are the trials of one seed, which share a place and its noise: only seeds are
resampled.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.camera.angles import Array

DRAWS = 1000
FEW_SEEDS = 8
"""Intervals from fewer seeds than these come out too short; the report says so."""


@dataclass(frozen=True)
class Curve:
    """Means over seeds at some places of an axis."""

    x: list[object]
    mean: Array
    low: Array
    high: Array
    """The 95 % interval; NaN where there is one seed only."""


def mean_over_seeds(values: pd.DataFrame, *, logarithmic: bool = False) -> Curve:
    """Means of the columns, with intervals by bootstrap over seeds.

    Parameters
    ----------
    values
        One row a place, one column a value of the axis; `seed` is the first level of the rows' index. Missing values
        count nowhere.
    logarithmic
        Geometric means of positive values.
    """
    table = values.where(values > 0).pipe(np.log) if logarithmic else values
    by_seed = table.groupby(level=0, sort=True)
    sums, counts = by_seed.sum().to_numpy(dtype=np.float64), by_seed.count().to_numpy(dtype=np.float64)
    weights = resampled(len(sums))
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (weights @ sums) / (weights @ counts)
    low, high = between(means[1:], len(sums))
    if logarithmic:
        means, low, high = np.exp(means), np.exp(low), np.exp(high)
    return Curve(list(values.columns), means[0], low, high)


def median_over_seeds(values: Array, seeds: NDArray[np.integer]) -> tuple[float, float, float]:
    """Median of all values, with an interval by bootstrap over seeds."""
    order = np.argsort(values, kind="stable")
    values = values[order]
    names, index = np.unique(seeds[order], return_inverse=True)
    weights = np.cumsum(resampled(names.size, 200)[:, index], axis=1)
    medians = values[np.argmax(weights >= 0.5 * weights[:, -1:], axis=1)]
    low, high = between(medians[1:, None], names.size)
    return float(medians[0]), float(low[0]), float(high[0])


def weighted_median(values: Array, weights: Array) -> float:
    """The value up to which half of the weight lies."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(reached, 0.5 * reached[-1])]])


def balanced(values: pd.DataFrame) -> pd.DataFrame:
    """The places that have a value everywhere on the axis, where there are any; an axis value without any stays."""
    known = values.loc[:, values.notna().any()]
    complete = known.dropna().index
    return values.loc[complete] if len(complete) else values


def between(draws: Array, seeds: int) -> tuple[Array, Array]:
    """The 95 % interval of bootstrap draws `[draws, ...]`; NaN from one seed."""
    if seeds < 2:
        nothing = np.full(draws.shape[1:], np.nan)
        return nothing, nothing
    empty = np.isnan(draws).all(axis=0)
    low, high = np.nanquantile(np.where(empty, 0.0, draws), [0.025, 0.975], axis=0)
    return np.where(empty, np.nan, low), np.where(empty, np.nan, high)


def resampled(seeds: int, draws: int = DRAWS) -> Array:
    """How often each seed counts `[1 + draws, seeds]`: once each in the first row, as drawn below."""
    drawn = np.random.default_rng(0).multinomial(seeds, np.full(seeds, 1 / seeds), size=draws)
    return np.concatenate([np.ones((1, seeds)), drawn.astype(np.float64)])
