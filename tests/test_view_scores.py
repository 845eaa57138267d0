"""Scores of warped views against other ways to the same number."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from harness.evaluation.view_scores import MOST_DB, score_view, solid_angles
from harness.geometry.panorama import Grid

GRID = Grid(width_px=60, height_px=40)
ALL = np.ones(GRID.shape, dtype=bool)
NONE = np.zeros(GRID.shape, dtype=bool)


def pictures(seed, sigma=10.0):
    rng = np.random.default_rng(seed)
    expected = rng.uniform(0, 255, GRID.shape)
    return np.clip(expected + sigma * rng.standard_normal(GRID.shape), 0, 255), expected


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), sigma=st.floats(0.1, 80))
def test_psnr_is_scikit_images(seed, sigma):
    grey, expected = pictures(seed, sigma)
    score = score_view(GRID, grey, expected, ALL, NONE, NONE)
    assert score.psnr_db == pytest.approx(peak_signal_noise_ratio(expected, grey, data_range=255), abs=1e-9)
    assert score.seen_psnr_db == score.psnr_db


def test_ssim_is_scikit_images():
    grey, expected = pictures(1)
    score = score_view(GRID, grey, expected, ALL, NONE, NONE)
    # Ours goes on across the seam; the reference is of the panorama three times side by side, in its middle.
    _, reference = structural_similarity(np.tile(grey, 3), np.tile(expected, 3), data_range=255, full=True)
    assert score.ssim == pytest.approx(reference[:, 60:120].mean(), abs=1e-12)


def test_a_band_has_the_solid_angle_of_its_sines():
    """2 pi (sin of the upper edge's elevation less that of the lower's), to the midpoint rule's error."""
    angles = solid_angles(GRID)
    lower, upper = (z / math.hypot(1, z) for z in (GRID.z_min, GRID.z_max))
    # The second derivative of (1 + z^2)^(-3/2) is at most 3: z_pitch^2/24 of that, over the whole height.
    bound = 2 * math.pi * 3 * GRID.z_pitch**2 / 24 * (GRID.z_max - GRID.z_min)
    assert abs(angles.sum() - 2 * math.pi * (upper - lower)) < bound


def test_weights_are_solid_angles():
    """An error in one row counts as much as the row's share of the sphere."""
    _, expected = pictures(2)
    for row in (0, 20, 39):
        grey = expected.copy()
        grey[row] += 10
        score = score_view(GRID, grey, expected, ALL, NONE, NONE)
        share = solid_angles(GRID)[row].sum() / solid_angles(GRID).sum()
        assert score.ws_psnr_db == pytest.approx(10 * math.log10(255**2 / (100 * share)), abs=1e-9)


def test_what_is_not_compared_does_not_count():
    grey, expected = pictures(3)
    left = np.broadcast_to(np.arange(60) < 30, GRID.shape)
    grey = np.where(left, grey, np.nan)
    expected_there = np.where(left, expected, np.nan)
    score = score_view(GRID, grey, expected_there, left, ~left, ~left)
    assert score.psnr_db == pytest.approx(peak_signal_noise_ratio(expected[left], grey[left], data_range=255), abs=1e-9)
    assert score.holes == score.disoccluded == 0
    assert score.disoccluded_rmse_grey is None
    assert 0 < score.ssim < 1


def test_holes_and_what_was_not_seen_are_shares_of_what_is_compared():
    _, expected = pictures(4)
    grey = expected.copy()
    unseen, holes = NONE.copy(), NONE.copy()
    unseen[:10], holes[:20] = True, True
    grey[:10] += 30
    score = score_view(GRID, grey, expected, ALL, holes, unseen)
    assert (score.holes, score.disoccluded) == (0.5, 0.25)
    assert score.disoccluded_rmse_grey == pytest.approx(30)
    assert score.seen_psnr_db == MOST_DB
    assert score.psnr_db == pytest.approx(10 * math.log10(255**2 / 225))
