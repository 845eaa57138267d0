"""Noise of one view alone, or more of it than the other has: measured view by view, and used so by slanted windows."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage
from slanted_floor import GRID, errors_px, motion, pair, refine, start, steep

from harness.matching.slanted.doubt import _residuals
from harness.matching.slanted.noise import Noise, _unless_alike, finest_variance, noise_between

ALL = np.ones((256, 320), bool)


def texture(seed=0, smooth_px=3.0):
    """Grey levels of a standard deviation of 30 and a mean of 128."""
    waves = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(ALL.shape), smooth_px)
    return 128 + 30 * waves / waves.std()


def noise(sigma, seed=1):
    return sigma * np.random.default_rng(seed).standard_normal(ALL.shape)


def between(first, second):
    return noise_between((first.astype(np.float32), ALL), (second.astype(np.float32), ALL))


@pytest.mark.parametrize("sigma", [1.0, 10.0])
def test_noise_is_measured_beside_texture(sigma):
    # The median of squares' means is 7 % below the variance, with a standard deviation of 1 %.
    found = finest_variance((texture() + noise(sigma)).astype(np.float32), ALL)
    assert found == pytest.approx(0.925 * sigma**2, rel=0.04)


def test_blank_and_saturated_squares_say_nothing_of_noise():
    image = (texture() + noise(5.0)).astype(np.float32)
    image[:160] = 255
    assert finest_variance(image, ALL) == pytest.approx(0.925 * 25, rel=0.07)  # of a third of the squares
    assert finest_variance(np.full(ALL.shape, 90, np.float32), ALL) == 0


def test_of_too_few_pixels_nothing_is_said():
    image = noise(5.0).astype(np.float32)
    known = np.zeros_like(ALL)
    known[:30, :30] = True
    assert finest_variance(image, known) == 0
    assert finest_variance(image[:10], ALL[:10]) == 0
    assert noise_between((image, known), (image, ALL)).excess == 0


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_which_view_is_noisier_whatever_the_gain(gain):
    first, second = texture(), texture() / gain  # view 1 is view 2 times the gain
    for found in (between(first, second), between(first + noise(6), second + noise(6 / gain, seed=2))):
        assert found.excess == 0
        assert found.gain_squared == pytest.approx(gain**2, rel=0.02)
    one = between(first + noise(6), second)
    assert one.excess == pytest.approx(0.925 * 36, rel=0.04)
    assert one.excess_2 == 0
    assert one.ratio > 20
    other = between(first, second + noise(6 / gain))
    assert other.excess == pytest.approx(-0.925 * 36, rel=0.04)
    assert other.excess_1 == 0
    assert other.ratio < gain**2 / 20


def test_ratios_are_1_or_what_they_are_without_a_jump_between():
    assert [_unless_alike(ratio) for ratio in (0.81, 1.0, 1.24, 1.6, 0.5)] == [1, 1, 1, 1.6, 0.5]
    ratios = [_unless_alike(ratio) for ratio in np.geomspace(0.3, 3, 1001)]
    assert np.all(np.diff(ratios) >= 0)
    assert np.max(np.diff(np.log(ratios))) < 0.005


def test_views_turned_are_the_same_noise():
    found = between(texture() + noise(6), texture() / 2)
    turned, expected = found.turned(), between(texture() / 2, texture() + noise(6))
    for key in ("gain_squared", "ratio", "excess", "grey_level_squared"):
        assert getattr(turned, key) == pytest.approx(getattr(expected, key), rel=1e-6)


@pytest.mark.parametrize(("n_1", "n_2"), [(100.0, 0.0), (0.0, 100.0), (100.0, 25.0), (9.0, 9.0)])
def test_the_residual_of_noise_alone_is_shared_out_as_the_noise_is(n_1, n_2):
    gain_squared, of_value = 4.0, 0.8
    ratio = n_1 / n_2 if n_1 and n_2 else 1e6 if n_1 else 1e-6
    views = Noise(1.0, 0.0, gain_squared, ratio, n_1 - gain_squared * n_2)
    residual = np.array([[n_1 + gain_squared * of_value**2 * n_2]], np.float32)
    odds = np.broadcast_to(views.odds_of_1(residual, of_value), (1, 1))
    of_2 = residual / (gain_squared * (odds + of_value**2))
    assert of_2[0, 0] == pytest.approx(n_2, abs=0.01 * float(residual[0, 0]))
    # What is ten times as much is no noise: most of it is put down to both views alike.
    odds = np.broadcast_to(views.odds_of_1(10 * residual, of_value), (1, 1))
    assert 0.6 < odds[0, 0] < 1.6


@pytest.mark.parametrize(("excess", "expected"), [(24.0, 25.0), (0.0, 25.0), (-24.0, 1.0)])
def test_noise_that_view_2_alone_has_leaves_little_unexplained(excess, expected):
    """As a share of a blank image's variance: one grey level squared, and as much as view 2 has more noise."""
    blank, there = np.full((40, 40), 128, np.float32), SimpleNamespace(known=np.ones((40, 40), bool))
    square = np.full((40, 40), 25, np.float32)
    with ThreadPoolExecutor(1) as pool:
        residual, unexplained = _residuals(
            SimpleNamespace(image=blank), Noise(1.0, 0.0, excess=excess), there, square, 9, pool
        )
    assert residual[20, 20] == pytest.approx(25)
    assert unexplained[20, 20] == pytest.approx(expected, rel=1e-5)


def noisy(sigma_1, sigma_2, seed=4):
    """The floor with a third of its contrast."""
    draws = np.random.default_rng(seed)
    images = (0.3 * (image - 128) + 128 for image in pair())
    return tuple(
        (image + sigma * draws.standard_normal(image.shape)).astype(np.float32)
        for image, sigma in zip(images, (sigma_1, sigma_2), strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("one", [(8.0, 0.0), (0.0, 8.0)])
def test_noise_in_one_view_is_no_worse_than_in_both(one):
    """With noise put down to both views alike, 27 % are matched if it is in view 1, and 77 % if it is in both."""
    there = motion()
    seen = steep(there)
    (both_error, _), (error, z) = (
        (errors, errors / (matches.sigma_alpha_2[seen] / GRID.phi_pitch))
        for matches in (refine(noisy(*sigmas), there, start(there)) for sigmas in ((8.0, 8.0), one))
        for errors in [np.abs(errors_px(matches, there)[seen])]
    )
    density = np.isfinite(error).mean()
    assert density > np.isfinite(both_error).mean()
    # Errors beyond one, two and three standard deviations as seldom as Gaussian ones, and most of them within one.
    z = z[np.isfinite(z)]
    assert np.mean(z > 1) < 0.32
    assert np.mean(z > 2) < 0.05
    assert np.mean(z > 3) < 0.003
    assert np.mean(z < 1) < 0.95  # 0.975 before, in view 1


@pytest.mark.slow
def test_noise_of_view_1_makes_no_gain():
    """a is 1 in every window that is mostly noise, too."""
    there = motion()
    recorded = gains(noisy(8.0, 0.0), there)
    assert np.median(recorded) == pytest.approx(1, abs=0.05)  # 1.2 if both views counted as equally noisy
    assert np.median(gains(noisy(0.0, 8.0), there)) == pytest.approx(1, abs=0.05)


def gains(images, there):
    """Gains of the windows on the floor, as they end."""
    from harness.matching.slanted import refine as module

    found = []
    original = module.surroundings_of

    def recording(field, *rest):
        found.append(field.gain[np.isfinite(field.residual)])
        return original(field, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "surroundings_of", recording)
        refine(images, there, start(there))
    return found[0]
