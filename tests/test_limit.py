"""Spread against the bound: what known draws must give."""

import numpy as np
import pytest

from harness.evaluation.limit import efficiency


def draws(count, pixels, std, bias=0.0, seed=0):
    return bias + std * np.random.default_rng(seed).standard_normal((count, pixels))


@pytest.mark.parametrize("count", [3, 8, 30])
def test_an_efficient_matcher_has_the_ratio_one_whatever_the_number_of_draws(count):
    bound = np.geomspace(0.01, 0.1, 20_000)
    found = efficiency(draws(count, bound.size, bound), bound)
    # The median of 20,000 spreads, each uncertain by 1/sqrt(2 (n - 1)), is known to 1.25/sqrt(2 (n - 1) 20,000).
    assert found.std_over_bound == pytest.approx(1, abs=4 * 1.25 / np.sqrt(2 * (count - 1) * bound.size))
    assert found.gross == 0
    assert found.density == 1


def test_bias_is_no_spread():
    bound = np.full(20_000, 0.05)
    found = efficiency(draws(20, bound.size, bound, bias=0.2), bound)
    assert found.std_over_bound == pytest.approx(1, abs=0.01)
    assert found.bias_px == pytest.approx(0.2, abs=0.002)
    assert found.rms_over_bound == pytest.approx(np.hypot(0.2, 0.05) / 0.05, rel=0.01)


def test_gross_errors_and_missing_estimates_are_counted_apart():
    errors = draws(20, 5_000, 0.05)
    errors[:, ::10] = np.where(np.arange(20)[:, None] < 5, 50.0, errors[:, ::10])
    errors[:8, 1::10] = np.nan
    found = efficiency(errors, np.full(5_000, 0.05))
    assert found.gross == pytest.approx(0.1 * 5 / 20 / found.density)
    assert found.density == pytest.approx(1 - 0.1 * 8 / 20)
    assert found.std_over_bound == pytest.approx(1, abs=0.02)
    assert found.pixels == 5_000


def test_pixels_without_a_bound_or_with_few_draws_do_not_count():
    errors = draws(10, 100, 0.05)
    errors[:6, :10] = np.nan
    bound = np.full(100, 0.05)
    bound[50:] = np.nan
    assert efficiency(errors, bound).pixels == 40
    assert efficiency(errors, None).std_over_bound is None
    assert efficiency(errors[:2], bound) is None
    assert efficiency(np.full((10, 100), np.nan), bound) is None
