"""Means over seeds with their intervals, and weighted medians."""

import numpy as np
import pandas as pd

from harness.evaluation.statistics import balanced, mean_over_seeds, median_over_seeds, weighted_median


def frame(values: list[list[float]], seeds: list[int]) -> pd.DataFrame:
    index = pd.MultiIndex.from_arrays([seeds, range(len(seeds))], names=["seed", "place"])
    return pd.DataFrame(values, index=index, columns=["a", "b"])


def test_means_over_seeds_and_their_intervals():
    curve = mean_over_seeds(frame([[1, 4], [3, np.nan], [5, 8]], [1, 1, 2]))
    np.testing.assert_allclose(curve.mean, [3, 6])
    np.testing.assert_allclose([curve.low, curve.high], [[2, 4], [5, 8]])


def test_one_seed_has_no_interval():
    curve = mean_over_seeds(frame([[1, 4], [3, 4]], [7, 7]), logarithmic=True)
    np.testing.assert_allclose(curve.mean, [np.sqrt(3), 4])
    assert np.isnan([curve.low, curve.high]).all()


def test_intervals_of_means_cover_the_truth_about_as_often_as_they_say():
    generator = np.random.default_rng(5)
    hits = 0
    for _ in range(200):
        values = generator.standard_normal((12, 1)).repeat(2, axis=1)
        curve = mean_over_seeds(frame(values.tolist(), list(range(12))))
        hits += curve.low[0] <= 0 <= curve.high[0]
    assert 0.86 <= hits / 200 <= 0.98  # a percentile bootstrap of 12 covers somewhat less than 95 %


def test_medians():
    values = np.array([3.0, 1.0, 2.0, 10.0, 4.0])
    median, low, high = median_over_seeds(values, np.array([1, 2, 3, 4, 5]))
    assert median == 3
    assert 1 <= low <= median <= high <= 10
    assert weighted_median(values, np.ones(5)) == 3
    assert weighted_median(values, np.array([0, 0, 0, 1.0, 0])) == 10


def test_places_without_a_value_somewhere_are_left_out_where_others_remain():
    table = frame([[1, 2], [3, np.nan], [5, 6]], [1, 2, 3])
    assert balanced(table)["a"].tolist() == [1, 5]
    nothing = frame([[1, np.nan], [np.nan, 2]], [1, 2])
    assert balanced(nothing) is nothing
