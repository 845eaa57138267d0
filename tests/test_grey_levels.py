"""Grey levels have no unit: a gain that both images share changes no match."""

import numpy as np
import pytest
from slanted_floor import GRID, SENSOR, SETTINGS, motion, pair, refine

from harness.matching.grey_levels import Moments, grey_level_squared
from harness.matching.pair import Pair
from harness.matching.semi_global.match import SemiGlobal

POWERS = [2.0**-16, 2.0**-8, 16.0]
GAINS = [1 / 255, 0.3, 7.0]


def images(gain, sigma):
    draws = np.random.default_rng(2)
    noisy = (image + sigma * draws.standard_normal(image.shape) for image in pair())
    return tuple(np.float32(gain) * image.astype(np.float32) for image in noisy)


def matched(gain, sigma, matcher):
    """Matches of the whole matcher, start and all."""
    return matcher.match(Pair(images(gain, sigma), (SENSOR, SENSOR), motion(), GRID, threads=2))


def refined(gain, sigma):
    """Matches from a start that is given."""
    return refine(images(gain, sigma), motion())


def assert_same(one, other):
    for key in ("alpha_2", "sigma_alpha_2", "reason"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.0, 12.0])
def test_a_gain_of_a_power_of_two_changes_no_bit(sigma):
    """Before, nothing was matched at 2^-16, as windows had no texture, and nothing right at 16, beyond 255."""
    expected = matched(1.0, sigma, SETTINGS)
    assert np.isfinite(expected.alpha_2).mean() > 0.8
    for gain in POWERS:
        assert_same(matched(gain, sigma, SETTINGS), expected)


@pytest.mark.slow
@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("sigma", [0.0, 12.0])
def test_another_gain_changes_what_rounding_changes(gain, sigma):
    expected, found = refined(1.0, sigma), refined(gain, sigma)
    assert np.mean(found.reason != expected.reason) < 1e-3
    apart = np.abs(found.alpha_2 - expected.alpha_2)[np.isfinite(found.alpha_2) & np.isfinite(expected.alpha_2)]
    # Grey levels in single precision, 1e-5 of 128, over slopes of some ten a pixel.
    assert np.quantile(apart, 0.99) < 1e-4 * GRID.phi_pitch
    sigmas = found.sigma_alpha_2 / expected.sigma_alpha_2
    assert np.nanquantile(np.abs(sigmas - 1), 0.99) < 1e-3


@pytest.mark.parametrize("gain", [*POWERS, *GAINS])
def test_semi_global_matching_sees_about_as_many_steps_whatever_the_unit(gain):
    matcher = SemiGlobal(d_min_m=0.5)
    expected, found = matched(1.0, 5.0, matcher), matched(gain, 5.0, matcher)
    assert np.isfinite(expected.alpha_2).mean() > 0.8
    if gain in POWERS:
        np.testing.assert_array_equal(found.alpha_2, expected.alpha_2)
    # A sixteenth of a grey level is then between 0.7 and 1.4 of what it was, and rounds other pixels up.
    assert np.mean(found.reason != expected.reason) < 0.02
    apart = np.abs(found.alpha_2 - expected.alpha_2)[np.isfinite(expected.alpha_2) & np.isfinite(found.alpha_2)]
    assert np.median(apart) < 0.02 * GRID.phi_pitch
    assert np.mean(apart > 0.5 * GRID.phi_pitch) < 0.01


def test_a_hot_pixel_is_no_overflow():
    matcher, (first, second) = SemiGlobal(d_min_m=0.5), images(1.0, 0.0)
    hot = first.copy()
    hot[61, 110] = 1e9  # more than 2^31 sixteenths of a grey level, in a row that is not looked at for the latter
    expected, found = (
        matcher.match(Pair((each, second), (SENSOR, SENSOR), motion(), GRID, threads=2)) for each in (first, hot)
    )
    # It rings through the spline some 20 pixels far.
    both = np.isfinite(expected.alpha_2) & np.isfinite(found.alpha_2)
    assert np.mean(np.abs(found.alpha_2 - expected.alpha_2)[both] < 0.5 * GRID.phi_pitch) > 0.99


def test_images_of_nothing_have_no_grey_level():
    nothing = np.zeros((20, 20), np.float32)
    assert grey_level_squared([Moments.of(nothing, nothing > 0)] * 2) == 0
    matches = SETTINGS.match(Pair((np.zeros((220, 220), np.float32),) * 2, (SENSOR, SENSOR), motion(), GRID))
    assert np.isnan(matches.alpha_2).all()


def test_a_grey_level_is_one_of_256():
    eight_bits = np.random.default_rng(0).uniform(0, 221, (400, 400)).astype(np.float32)  # a quadratic mean of 128
    everywhere = np.ones(eight_bits.shape, bool)
    moments = Moments.of(eight_bits, everywhere), Moments.of(eight_bits / 255, everywhere)
    assert grey_level_squared(moments[:1]) == pytest.approx(1, rel=0.02)
    assert grey_level_squared(moments[1:]) == pytest.approx(1 / 255**2, rel=0.02)
    assert moments[0].variance == pytest.approx(221**2 / 12, rel=0.02)
