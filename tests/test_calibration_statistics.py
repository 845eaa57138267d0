"""Predicted standard deviations against the scatter of a hundred calibrations of corners with noise."""

import numpy as np
import pytest
from boards import MIRROR, UNIFIED, noisy, visible_boards

from harness.calibration.adjust import adjust
from harness.calibration.corners import Board
from harness.calibration.parameters import Parameters, choose_keys
from harness.calibration.sensor_calibration import calibrate_sensor
from harness.calibration.uncertainty import ray_difference, ray_grid, ray_sigma, uncertainty_of

pytestmark = pytest.mark.slow

NOISE_PX, DRAWS = 0.1, 100


@pytest.mark.long
@pytest.mark.parametrize("sensor", [MIRROR, UNIFIED], ids=["hyperboloid", "unified"])
def test_numbers_and_rays_scatter_as_predicted(sensor):
    exact, poses = visible_boards(sensor, 20, 30)
    parameters = Parameters(sensor, choose_keys(sensor))
    truth, start = parameters.values(parameters.vector(sensor)), parameters.vector(sensor)
    grid = ray_grid(sensor)
    scores, squares, predicted = [], [], []
    for draw in range(DRAWS):
        fitted = adjust(parameters, noisy(exact, NOISE_PX, 5000 + draw), start, poses)
        uncertainty = uncertainty_of(fitted)
        scores.append((uncertainty.values - truth) / uncertainty.sigma)
        squares.append(np.sum(ray_difference(sensor, parameters.sensor_at(fitted.vector), grid) ** 2, axis=-1))
        if draw < 10:
            predicted.append(ray_sigma(fitted, uncertainty.vector_covariance, grid)[0] ** 2)
    within = np.mean(np.abs(scores) < 1)
    # 68.3 % expected; numbers that trade off count as two or three each time, so that the share scatters by 3 %.
    assert within == pytest.approx(0.683, abs=0.04)
    assert np.abs(scores).max() < 5
    # Of the rays' mean squares, dominated by a few modes over the field: 1/sqrt(100) of each, 6 % of the root.
    ratio = np.sqrt(np.nanmean(squares) / np.mean(predicted))
    assert ratio == pytest.approx(1, abs=0.12)


def test_many_corners_bring_rays_to_a_fiftieth_of_a_pixel():
    """Noise of 0.1 px in 60 images of a board of 12 x 9 corners, close by."""
    exact, _ = visible_boards(UNIFIED, 60, 31, board=Board(columns=12, rows=9, square_m=0.03))
    calibration = calibrate_sensor(noisy(exact, NOISE_PX, 5), "unified")
    error = np.linalg.norm(ray_difference(calibration.sensor, UNIFIED, calibration.grid), axis=-1)
    assert np.median(error) < 0.02
    assert np.median(calibration.ray_sigma_px) < 0.02
