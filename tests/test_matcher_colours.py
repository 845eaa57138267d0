"""Matchers that ask for colours: those of a trial's own sensor and noise, and of photographs."""

import numpy as np
import pytest
from plugin_modules import Write
from test_colour import painted

import harness
from harness.camera.sensor import Sensor, pixel_directions
from harness.images import LUMA
from harness.matching.registry import Plugin
from harness.pipeline.specification import Noise, SecondView, Trial
from harness.pipeline.trial import run_trial

pytestmark = pytest.mark.slow

SENSOR = Sensor(camera={"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5})
ASKS = """
import numpy as np

seen = []

def match(pair, limits):
    views = pair.equirectangular(90, elevation_deg=(-55, 18), colour=True)
    seen.append([pair.colours(view) for view in (0, 1)])
    seen.append(views.images)
    return views.answer(range_m=np.full(views.shape, 3.0))
"""


def test_colours_of_a_trial_are_those_of_its_sensor(module: Write, tmp_path) -> None:
    """Without noise their luma is the grey image; each band has noise of its own, of the trial's sigma."""
    name = module(ASKS)
    trial = Trial(
        scene=painted(tmp_path),
        sensor=SENSOR,
        panorama={"width_px": 90, "height_px": 24},
        view_2=SecondView(baseline_m=0.3),
        exposure_2={"gain": 0.8, "offset_grey": 5.0},
        matching=Plugin(kind=f"{name}:match"),
    )
    outcome = run_trial(trial)
    (bands, images) = __import__(name).seen
    lit = pixel_directions(SENSOR)[1]
    for view in (0, 1):
        luma = sum(weight * band for weight, band in zip(LUMA, bands[view], strict=True))
        # Greys of single precision, three of them summed.
        np.testing.assert_allclose(luma[lit], outcome.images[view][lit], atol=2e-4)
        assert np.ptp([np.median(band[lit]) for band in bands[view]]) > 20  # a painted room
    assert images[0].shape == (18, 90, 3)
    assert outcome.valid[outcome.reference.domain].mean() > 0.95
    np.testing.assert_allclose(outcome.range_m[outcome.valid], 3.0, rtol=1e-12)

    noisy = run_trial(trial.model_copy(update={"noise": Noise(sigma_grey=4.0)}))
    assert noisy.trial.noise.sigma_grey == 4.0
    noise = [after[lit] - before[lit] for before, after in zip(bands[0], __import__(name).seen[2][0], strict=True)]
    # 12,000 pixels: a standard deviation is known to 1 %, a correlation to 0.01.
    np.testing.assert_allclose([each.std() for each in noise], 4.0, rtol=0.04)
    grey = noisy.images[0][lit] - outcome.images[0][lit]
    correlations = np.corrcoef([*noise, grey])
    assert np.abs(correlations - np.eye(4)).max() < 0.05


def test_colours_of_photographs(module: Write) -> None:
    name = module(ASKS)
    draws = np.random.default_rng(3)
    left, right = draws.integers(0, 256, (2, 120, 160, 3), dtype=np.uint8)
    kind, grid = f"{name}:match", harness.Grid(width_px=90, height_px=24)
    harness.estimate_range(left, right, SENSOR, (0.3, 0, 0), {"kind": kind}, grid=grid)
    (bands, _) = __import__(name).seen
    np.testing.assert_array_equal(np.stack(bands[0], axis=-1), left)
    np.testing.assert_array_equal(np.stack(bands[1], axis=-1), right)
    harness.estimate_range(left[..., 0], right[..., 0], SENSOR, (0.3, 0, 0), {"kind": kind}, grid=grid)
    for band in __import__(name).seen[2][0]:
        np.testing.assert_array_equal(band, left[..., 0])
