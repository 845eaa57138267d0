"""What residuals have in common is told from noise that is larger than predicted."""

import numpy as np
import pytest

from harness.motion.scatter import common_scatter

NOISE = np.geomspace(0.02, 0.3, 300)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_noise_that_is_larger_than_predicted_is_still_noise(factor):
    for seed in range(20):
        left = np.random.default_rng(seed).normal(0, factor * NOISE)
        assert common_scatter(left, NOISE) == 0


@pytest.mark.parametrize("factor", [1.0, 1.5])  # noise is predicted to a third
def test_what_is_common_is_measured_in_noise(factor):
    found = []
    for seed in range(20):
        draws = np.random.default_rng(seed)
        left = draws.normal(0, 0.2, NOISE.size) + draws.normal(0, factor * NOISE)
        left[draws.random(NOISE.size) < 0.03] *= 20  # mismatches
        found.append(common_scatter(left, NOISE))
    assert np.mean(found) == pytest.approx(0.2, rel=0.1)
    # Of 300 residuals, half of them mostly noise.
    assert np.std(found) < 0.04


def test_where_all_are_determined_equally_well_more_than_noise_is_common():
    noise = np.full(100, 0.02)
    left = np.random.default_rng(0).normal(0, 0.2, 100)
    assert common_scatter(left, noise) == pytest.approx(0.2, rel=0.2)
    assert common_scatter(left / 10, noise) == 0
    assert common_scatter(left[:0], noise[:0]) == 0
