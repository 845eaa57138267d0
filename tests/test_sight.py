"""Where nothing can be seen or matched a trial is refused, by the key that helps; where next to nothing, it is said."""

import pytest

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor
from harness.errors import InputError, Notice
from harness.geometry.panorama import Grid
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import Rendering, SecondView, Trial
from harness.pipeline.trial import run_trial
from harness.simulation.scene import load_scene
from harness.spec import parse

CAMERA = {"width_px": 80, "height_px": 60, "focal_px": 76.7, "cx_px": 39.5, "cy_px": 29.5}
GRID = Grid(width_px=90, height_px=25)


def trial(*, camera=None, lens=None, field=None, grid=GRID, **changes):
    sensor = Sensor(camera=Camera(**CAMERA | (camera or {})), lens=lens or Lens(), field=field or FieldOfView())
    return Trial(scene=load_scene("box"), sensor=sensor, panorama=grid, render=Rendering(samples=1), **changes)


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ({"camera": {"aspect": 256.0}}, "trial.sensor", "sensor.camera.aspect = 256"),
        ({"lens": Lens(k1=1e18)}, "trial.sensor", "sensor.lens"),
        ({"camera": {"focal_px": 1e6}}, "trial.sensor", "change sensor.camera"),
        ({"grid": Grid(width_px=90, height_px=25, z_max=900, z_min=800)}, "trial.panorama.z_max", "-3.73 .. 0.36"),
        (
            {"view_2": SecondView(elevation_deg=90), "matching": WindowMatcher(window_px=5)},
            "trial.matching.sampling",
            'sampling = "alpha"',
        ),
    ],
)
def test_nothing_to_see_is_refused_by_its_key(given, key, words):
    with pytest.raises(InputError) as caught:
        run_trial(trial(**given))
    assert caught.value.key == key
    assert words in str(caught.value)


@pytest.mark.parametrize("matcher", [WindowMatcher(window_px=5, sampling="alpha"), SemiGlobal()])
def test_a_vertical_baseline_is_matched_by_angles(matcher):
    outcome = run_trial(trial(view_2=SecondView(elevation_deg=90), matching=matcher))
    assert outcome.valid.any()


@pytest.mark.parametrize("z", [1e308, -1e308, 1e4, float("nan")])
def test_the_panorama_has_limits(z):
    with pytest.raises(InputError, match="z_m"):
        parse(Grid, {"z_max": z} if z > 0 else {"z_min": z})


def test_next_to_nothing_is_said():
    with pytest.warns(Notice, match=r"only 4\.0% of the panorama.*z_min"):
        run_trial(trial(grid=Grid(width_px=90, height_px=25, z_max=200, z_min=-4)))
