"""Confidence against closed forms, brute force, and known distributions."""

from math import erf, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from harness.evaluation.confidence import EXPECTED_WITHIN, STEPS, calibration, exceeding, roc, sparsification

RNG = np.random.default_rng(20)


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_the_oracle_has_no_area_and_nothing_does_better(statistic):
    error = RNG.normal(size=(40, 50))
    perfect = sparsification(error, -np.abs(error), statistic=statistic)
    assert perfect.ause == 0
    assert perfect.ause_over_random == 0
    any_other = sparsification(error, RNG.normal(size=error.shape), statistic=statistic)
    # Removing the largest first leaves the least at every share; 1e-12 is the rounding of sums.
    assert np.all(any_other.remaining >= any_other.oracle - 1e-12)


def test_oracle_of_uniform_errors():
    # Of errors (i + 0.5)/n the smallest share q remains: a mean of q/2 and a median of q/2, exactly when q n is whole.
    n = 1000
    error = (np.arange(n) + 0.5) / n * np.where(np.arange(n) % 2, 1, -1)
    for statistic in ("mean", "median"):
        result = sparsification(error, np.zeros(n), statistic=statistic)
        np.testing.assert_allclose(result.oracle, (1 - result.removed) / 2, rtol=1e-12)
        # All equally sure: the curve is flat, and the area is that between 1/2 and (1 - r)/2, r from 0 to 0.99.
        np.testing.assert_allclose(result.remaining, 0.5, rtol=1e-12)
        assert result.random == pytest.approx(0.5, rel=1e-12)
        assert result.ause == pytest.approx(0.99**2 / 4, rel=1e-12)
        assert result.ause_over_random == pytest.approx(1, rel=1e-12)


def test_upside_down_confidence_is_worse_than_none():
    error = RNG.normal(size=2000)
    assert sparsification(error, np.abs(error)).ause_over_random > 1


def test_sparsification_by_hand():
    # Ten pixels, two thirds into a tie: at 80 % removed two remain (1, 3); at 60 % those and half of the four with 8.
    error = [1, 3, 8, 8, 8, 8, 20, 20, 20, 20]
    confidence = [5, 5, 4, 4, 4, 4, 1, 1, 1, np.nan]
    mean = sparsification(error, confidence)
    assert mean.remaining[80] == pytest.approx(2)
    assert mean.remaining[60] == pytest.approx((1 + 3 + 2 * 8) / 4)
    assert mean.remaining[10] == pytest.approx((1 + 3 + 4 * 8 + 3 * 20) / 9)
    median = sparsification(error, confidence, statistic="median")
    assert median.remaining[0] == 8
    assert median.remaining[80] == pytest.approx(2)
    # Of 1, 2, 3 and 10, the last three equally sure, two remain: 1, and a third of each. Half the weight ends at the 1.
    assert sparsification([1, 2, 3, 10], [9, 1, 1, 1], statistic="median").remaining[50] == pytest.approx(1.5)


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_sparsification_against_sorting(statistic):
    # Without ties, where a share is a whole number of pixels, it is the statistic of the surest.
    error, confidence = RNG.normal(size=(2, 500))
    result = sparsification(error, confidence, statistic=statistic)
    surest_first = np.abs(error)[np.argsort(-confidence)]
    for i in range(STEPS):
        expected = getattr(np, statistic)(surest_first[: 500 - 5 * i])
        assert result.remaining[i] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_sparsification_does_not_depend_on_the_order_of_pixels(statistic):
    error = RNG.normal(size=3000)
    confidence = RNG.integers(0, 4, size=3000).astype(float)
    order = RNG.permutation(3000)
    one, other = (sparsification(error[i], confidence[i], statistic=statistic) for i in (slice(None), order))
    np.testing.assert_array_equal(one.remaining, other.remaining)
    assert one.ause == other.ause


def test_what_has_no_error_takes_no_part():
    error, confidence = RNG.normal(size=(2, 400))
    with_gaps = np.concatenate([error, np.full(50, np.nan)])
    sure_of_gaps = np.concatenate([confidence, np.full(50, 9.0)])
    one, other = sparsification(error, confidence), sparsification(with_gaps, sure_of_gaps)
    assert one.pixels == other.pixels == 400
    np.testing.assert_array_equal(one.remaining, other.remaining)
    empty = sparsification([np.nan], [1.0])
    assert empty.pixels == 0
    assert np.isnan(empty.ause)


def test_calibration_of_normal_errors():
    n = 40_000
    sigma = RNG.uniform(0.01, 3, size=n)
    error = RNG.normal(size=n) * sigma
    right = calibration(error, sigma)
    for result, expected in zip(right.within, EXPECTED_WITHIN, strict=True):
        # Binomial: four standard deviations.
        assert abs(result - expected) < 4 * np.sqrt(expected * (1 - expected) / n)
    # The median absolute deviation has a relative standard deviation of 1.166/sqrt(n), the median 1.253/sqrt(n).
    assert right.spread == pytest.approx(1, abs=4 * 1.166 / np.sqrt(n))
    assert right.bias == pytest.approx(0, abs=4 * 1.253 / np.sqrt(n))
    boastful = calibration(error, sigma / 2)
    assert boastful.spread == pytest.approx(2 * right.spread, rel=1e-12)
    assert boastful.within[1] == right.within[0]


def test_expected_shares_are_those_of_the_error_function():
    assert pytest.approx([erf(k / sqrt(2)) for k in (1, 2, 3)], rel=1e-15) == EXPECTED_WITHIN


def test_calibration_by_hand():
    result = calibration([1, -3, 5, 7, np.nan, 2, 2], [1, 2, 2, 2, 1, 0, np.inf])
    assert result.pixels == 4
    assert result.predicted == pytest.approx(4 / 6)
    assert result.within == pytest.approx((0.25, 0.5, 0.75))
    assert result.bias == pytest.approx((1 + 2.5) / 2)
    nothing = calibration([np.nan, 1.0], [1.0, np.nan])
    assert nothing.pixels == 0
    assert nothing.predicted == 0
    assert np.isnan(nothing.spread)


few = hnp.arrays(np.float64, st.shared(st.integers(1, 40), key="n"), elements=st.sampled_from([0, 1, 2, 3, np.nan]))
flags = hnp.arrays(bool, st.shared(st.integers(1, 40), key="n"))


@given(few, flags, flags)
def test_area_is_the_share_of_pairs_in_the_right_order(confidence, bad, among):
    result = roc(confidence, bad, among=among)
    level = np.nan_to_num(confidence, nan=-1)
    below, above = level[bad & among], level[~bad & among]
    assert (result.bad, result.good) == (below.size, above.size)
    if not below.size or not above.size:
        assert np.isnan(result.auc)
        return
    pairs = np.sign(above[None, :] - below[:, None])
    # Sums of at most 400 fractions.
    assert result.auc == pytest.approx(np.mean((pairs + 1) / 2), abs=1e-13)
    assert result.caught[0] == result.lost[0] == 0
    assert result.caught[-1] == result.lost[-1] == 1


def test_roc_of_errors():
    error = np.array([[0.1, -2.0, np.nan], [5.0, 0.3, -0.9]])
    bad, among = exceeding(error, 1.0)
    perfect = roc(-np.abs(error), bad, among=among)
    assert (perfect.bad, perfect.good, perfect.auc) == (2, 3, 1)
    assert roc(np.abs(error), bad, among=among).auc == 0
    assert roc(np.zeros(error.shape), bad, among=among).auc == 0.5


def test_roc_of_two_normal_distributions():
    # Confidence N(1, 1) for good and N(0, 1) for bad pixels: AUC = Phi(1/sqrt 2) = 0.76025.
    n = 20_000
    confidence = np.concatenate([RNG.normal(1, 1, n), RNG.normal(0, 1, n)])
    result = roc(confidence, np.arange(2 * n) >= n)
    # The variance of the area is below auc (1 - auc)/n.
    assert result.auc == pytest.approx(0.76025, abs=4 * np.sqrt(0.76025 * 0.23975 / n))


def test_shapes_have_to_fit():
    for call in (sparsification, calibration, roc):
        with pytest.raises(ValueError, match="shapes differ"):
            call(np.zeros(3), np.zeros(4))
