"""Where nothing can be seen or matched a trial is refused, by the key that helps; where next to nothing, it is said."""

import numpy as np
import pytest
from sweeps import write_small

import harness
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor
from harness.camera.unwrap import unwrap
from harness.cli import main
from harness.errors import InputError, Notice
from harness.geometry.panorama import Grid
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.sight import check_sensor
from harness.pipeline.specification import Rendering, SecondView, Trial
from harness.pipeline.trial import run_trial
from harness.runs.density import too_sparse
from harness.simulation.scene import load_scene
from harness.spec import parse

CAMERA = {"width_px": 80, "height_px": 60, "focal_px": 76.7, "cx_px": 39.5, "cy_px": 29.5}
GRID = Grid(width_px=90, height_px=25)


def sensor_of(camera, **parts):
    return Sensor(camera=Camera(**CAMERA | camera), **parts)


def trial(*, camera=None, lens=None, field=None, grid=GRID, **changes):
    sensor = sensor_of(camera or {}, lens=lens or Lens(), field=field or FieldOfView())
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


SMALL_CIRCLE = {"focal_px": 12.0, "cx_px": 2.0, "cy_px": 2.0}
"""A circle of 5 pixels about a corner of 80 x 60 pixels."""


def test_a_circle_that_fills_a_corner_is_said():
    with pytest.warns(Notice, match=r"only 0\.\d% of the image's pixels.*sensor\.camera\.focal_px, camera\.cx_px"):
        check_sensor(sensor_of(SMALL_CIRCLE), GRID)


def test_a_circle_that_is_mostly_off_the_image_is_said():
    # Much of the image is in the circle, but that is a sliver of all azimuths.
    far_too_large = {"focal_px": 1000.0, "cx_px": 0.0, "cy_px": 0.0}
    with pytest.warns(Notice, match=r"only \d\.\d% of the panorama is on the image; see sensor\.camera\.focal_px"):
        check_sensor(sensor_of(far_too_large), GRID)


def test_a_circle_that_leaves_nothing_of_the_panorama_is_refused():
    with pytest.raises(InputError, match=r"sensor\.camera\.focal_px"):
        run_trial(trial(camera={"focal_px": 2000.0, "cx_px": 0.0, "cy_px": 0.0}))


@pytest.mark.parametrize("camera", [{"focal_px": 1e6}, {"focal_px": 0.5, "cx_px": -0.5, "cy_px": -0.5}])
def test_a_view_of_a_blind_sensor_is_refused_by_its_key(camera):
    with pytest.raises(InputError, match=r"change sensor\.camera\.focal_px, camera\.cx_px and camera\.cy_px") as caught:
        harness.render("box", sensor=sensor_of(camera))
    assert caught.value.key == "sensor"


def test_the_command_refuses_a_blind_sensor(tmp_path, capsys):
    (tmp_path / "blind.toml").write_text("[camera]\nfocal_px = 1e6\n")
    given = ["render", "box", "--at", "0", "0", "1", "--sensor", tmp_path / "blind.toml", "--out", tmp_path / "out"]
    assert main([str(each) for each in given]) == 2
    assert "sensor: no pixel of the image falls on the panorama" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- After a run ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "matching", "words"),
    [
        ({"WINDOW_LEAVES_IMAGE": 50, "CURVE_LEAVES_IMAGE": 9, "NO_MATCH": 55}, WindowMatcher(), "matching.window_px"),
        ({"NO_EPIPOLAR_PLANE": 90, "MATCHED": 1}, WindowMatcher(), 'matching.sampling ("alpha"'),
        ({"NO_SAMPLE": 60, "NO_MATCH": 40}, SemiGlobal(), "trial.matching.d_min_m, trial.matching.d_max_m"),
        ({"NO_SAMPLE": 60}, WindowMatcher(), "trial.matching.pitch_px (smaller)"),
        ({"INCONSISTENT": 99, "MATCHED": 1}, SemiGlobal(), "rejected its matches"),
        ({}, SemiGlobal(), "trial.view_2"),
    ],
)
def test_the_reasons_of_sparse_trials_name_the_keys(counts, matching, words):
    sparse, dense = ({"figures": {"density": density}, "reasons": counts} for density in (0.049, 0.05))
    one = trial(matching=matching)
    said = too_sparse([(one, sparse), (one, dense), (one, sparse)])
    assert said.startswith("2 of 3 trials have a range for less than 5% of the pixels")
    assert words in said
    assert hasattr(matching, "window_px") or "window_px" not in said
    assert too_sparse([(one, dense)]) == ""


def test_pixels_beyond_all_integers_are_not_seen():
    sensor = sensor_of({"aspect": 1e9})
    assert not unwrap(np.zeros((60, 80), np.float32), sensor, GRID).valid.any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["matching.window_px=49"], "trial.matching.window_px (smaller)"),
        (["view_2.elevation_deg=89.99"], 'trial.matching.sampling ("alpha"'),
        (["matching.d_min_m=900", "matching.d_max_m=901"], "trial.matching.d_min_m"),
    ],
)
def test_a_run_that_finds_next_to_nothing_says_so(changes, words, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    given = write_small(tmp_path / "small.toml")
    sets = [part for change in changes for part in ("--set", change)]
    assert main(["run", str(given), *sets, "--out", str(tmp_path / "out"), "--no-report", "--workers", "1"]) == 0
    said = capsys.readouterr().err
    assert "omnirange: 1 of 1 trials has a range for less than 5% of the pixels that both views see" in said
    assert words in said
