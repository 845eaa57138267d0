"""The noise of one image is measured where it has least texture."""

import numpy as np
import pytest
from scipy import ndimage

import harness
from harness.camera.image_noise import noise_of
from harness.camera.sensor import pixels_seen
from harness.matching.slanted.noise import finest_variance

SHAPE = (240, 320)
ALL = np.ones(SHAPE, bool)


def _ramp():
    rows, columns = np.indices(SHAPE)
    return 20.0 + 0.4 * rows + 0.3 * columns


def test_grey_levels_that_rise_evenly_are_no_noise():
    assert noise_of(_ramp(), ALL) < 1e-9


@pytest.mark.parametrize("sigma", [0.5, 4.0, 25.0])
def test_white_noise_is_measured(sigma):
    draws = np.random.default_rng(3)
    measured = [noise_of(_ramp() + draws.normal(0, sigma, SHAPE), ALL) for _ in range(4)]
    # A quantile of 252 blocks, each of 289 correlated values.
    np.testing.assert_allclose(measured, sigma, rtol=0.04)


def test_pixels_that_are_not_known_do_not_count():
    image = np.random.default_rng(4).normal(128, 5, SHAPE)
    known = np.indices(SHAPE)[1] < 160
    hidden = np.where(known, image, np.nan)
    assert noise_of(hidden, known) == noise_of(np.where(known, image, 1e6), known)
    assert noise_of(hidden, known) == noise_of(hidden, ALL)
    assert noise_of(hidden, known) == pytest.approx(5, rel=0.15)
    assert noise_of(image, np.zeros(SHAPE, bool)) == 0


def test_of_noise_that_pixels_share_more_is_found_than_by_fourth_differences():
    shared = ndimage.convolve(np.random.default_rng(6).normal(0, 10, SHAPE), np.outer([1, 2, 1], [1, 2, 1]) / 16)
    found = noise_of(128 + shared, ALL) / shared.std()
    assert found == pytest.approx(0.15, abs=0.02)
    assert np.sqrt(finest_variance((128 + shared).astype(np.float32), ALL)) / shared.std() < 0.5 * found


@pytest.mark.slow
def test_texture_adds_little_to_it():
    view = harness.render("room", position_m=(0, 0, 1), samples=4)
    known, draws = pixels_seen(view.sensor), np.random.default_rng(5)
    # Brick and gravel as fine as pixels fill most of this image: its median second difference is 6.
    assert noise_of(view.image, known) < 1.5
    assert noise_of(view.image + draws.normal(0, 10, view.image.shape), known) == pytest.approx(10, rel=0.1)
