"""The Laplacian of Gaussian on the panorama."""

import numpy as np
import pytest

from harness.geometry.panorama import Grid, Panorama
from harness.matching.filter import laplacian_of_gaussian

GRID = Grid(width_px=120, height_px=80, z_max=1.0, z_min=-1.0)


def panorama(values, valid=None):
    return Panorama(GRID, values.astype(np.float32), np.ones(GRID.shape, bool) if valid is None else valid)


@pytest.mark.parametrize("column", [60, 0, 119])
def test_answer_to_a_blob_is_the_analytic_one_also_across_the_seam(column):
    rows, columns = np.indices(GRID.shape)
    dx = np.mod(columns - column + 60, 120) - 60
    r2 = dx**2 + (rows - 40) ** 2
    s, sigma = 3.0, 2.0
    blob = 100 * np.exp(-r2 / (2 * s * s))
    answer = laplacian_of_gaussian(panorama(blob), sigma)
    # A Gaussian blurred by a Gaussian is one of variance S = s² + sigma², and its Laplacian is known.
    S = s * s + sigma * sigma
    expected = sigma**2 * 100 * (s * s / S) * np.exp(-r2 / (2 * S)) * (r2 / S**2 - 2 / S)
    # The kernel is sampled and cut at 4 sigma: relative error 2e-3 of the peak (32 grey levels).
    np.testing.assert_allclose(answer.values, expected, atol=0.1)


def test_the_seam_is_no_border():
    values = np.random.default_rng(3).uniform(0, 255, GRID.shape)
    straight = laplacian_of_gaussian(panorama(values), 1.5).values
    rolled = laplacian_of_gaussian(panorama(np.roll(values, 37, axis=1)), 1.5).values
    np.testing.assert_array_equal(np.roll(straight, 37, axis=1), rolled)


def test_offset_and_slope_of_the_light_are_taken_out():
    values = np.random.default_rng(4).uniform(0, 255, GRID.shape)
    rows, _ = np.indices(GRID.shape)
    straight = laplacian_of_gaussian(panorama(values), 1.5).values
    lit = laplacian_of_gaussian(panorama(values + 40 + 0.5 * rows), 1.5).values
    # Single precision; the kernel of the cut LoG sums to 1e-4 rather than 0. Rows within reach of the border are
    # continued as constants, where a slope bends.
    np.testing.assert_allclose(lit[8:-8], straight[8:-8], atol=0.05)
    assert np.abs(straight).std() > 5


def test_validity_shrinks_by_the_kernel():
    valid = np.ones(GRID.shape, bool)
    valid[:, 30] = False
    answer = laplacian_of_gaussian(panorama(np.zeros(GRID.shape), valid), 1.0)
    assert not answer.valid[:, 26:35].any()
    assert answer.valid[:, :26].all()
    assert answer.valid[:, 35:].all()


def test_zero_sigma_is_no_filter():
    image = panorama(np.random.default_rng(5).uniform(0, 255, GRID.shape))
    assert laplacian_of_gaussian(image, 0) is image
