"""A calibration that the images contradict counts in the motion's standard deviations, as large as what they show."""

from dataclasses import replace

import numpy as np
import pytest
from bearings import SENSOR as MIRROR
from bearings import draw, pairs_of
from test_direct import SENSOR, TURN, noisy, off_deg, pair, start

from harness.camera.sensor import Sensor
from harness.motion.direct import DirectFit, fit_direct
from harness.motion.estimate import estimate_from_pairs
from harness.motion.misfit import misfit_px
from harness.motion.sparse import fit
from harness.motion.verdict import Status


@pytest.mark.slow
def test_tiles_miss_their_curves_where_the_centre_is_wrong():
    result, pairs = start()
    for images in (pair(), noisy(10.0, 1)):
        exact = fit_direct(images, (SENSOR, SENSOR), result, pairs)
        assert misfit_px(images, (SENSOR, SENSOR), exact) == 0
    wrong = Sensor(camera=SENSOR.camera.model_copy(update={"cx_px": SENSOR.camera.cx_px + 2}))
    shown = pairs_of(pairs.pixels_1, pairs.pixels_2, wrong)
    direct = fit_direct(pair(), (wrong, wrong), fit(shown, TURN, limit_px=4.0), shown)
    assert max(off_deg(direct.turn)) > 5  # degrees; at 70 degrees of yaw the motion absorbs nearly all of 2 px
    assert 0.06 < misfit_px(pair(), (wrong, wrong), direct) < 2


@pytest.mark.parametrize(
    ("misfit", "given", "status"), [(0.0, 0.0, Status.OK), (2.0, 0.0, Status.WEAK), (0.3, 2.0, Status.WEAK)]
)
def test_it_counts_as_the_calibrations_standard_deviation(misfit, given, status):
    pairs = draw(TURN, noise_px=0.05)

    def refine(start):
        tiles = np.zeros((200, 2), np.int64)
        fine = DirectFit(start.turn, start.covariance / 9, tiles, np.zeros((200, 3)), 1.0, 0.0, 0.0)
        return replace(fine, misfit_px=misfit)

    result = estimate_from_pairs(pairs, (MIRROR, MIRROR), calibration_px=given, refine=refine)
    assert result.status == status
    by_calibration = result.covariance - result.direct.covariance
    effects = result.calibration_effects
    assert np.allclose(by_calibration, max(misfit, given) ** 2 * effects @ effects.T, atol=1e-15)
