"""The panorama, the limits and the size of image that `omnirange range` takes where nothing is said of them."""

import math

import numpy as np
import pytest

import harness
from harness.api import search_limits
from harness.api.photographs import grid_of, side_of, smaller
from harness.camera.binning import binned_sensor
from harness.camera.fitting_panorama import fitting_grid
from harness.camera.sensor import Sensor, project
from harness.camera.unwrap import can_be_sampled
from harness.cli import main
from harness.errors import InputError
from harness.geometry.panorama import Grid, directions
from harness.matching.slanted.settings import Slanted
from harness.motion.search_limits import limits_of, triangulated
from harness.pipeline.photographs import Photograph

MIRROR = Sensor()
BASELINE_M = 0.4


def enlarged(sensor: Sensor, times: int) -> Sensor:
    camera = sensor.camera
    larger = {
        "width_px": camera.width_px * times,
        "height_px": camera.height_px * times,
        "focal_px": camera.focal_px * times,
        "cx_px": camera.cx_px * times + (times - 1) / 2,
        "cy_px": camera.cy_px * times + (times - 1) / 2,
    }
    return sensor.model_copy(update={"camera": camera.model_copy(update=larger)})


def test_the_default_mirror_gets_720_columns_of_what_it_sees():
    grid = fitting_grid((MIRROR, MIRROR))
    assert grid.width_px == 720
    assert grid.z_pitch == pytest.approx(grid.phi_pitch, rel=1e-12)  # square, to rounding
    # All but the rows that do not fill one more pixel.
    rows = grid_of(Grid(z_min="auto", z_max="auto"), (MIRROR, MIRROR), harness.Motion(np.eye(3), np.eye(3)[0]))
    assert rows.z_max == grid.z_max
    assert rows.z_min <= grid.z_min < rows.z_min + grid.z_pitch
    assert can_be_sampled(MIRROR, directions(grid)).mean() > 0.98  # a row counts from four fifths on


def test_a_turn_at_the_horizon_has_as_many_pixels_as_counted():
    # The length of the horizon's image, a polygon of a thousand corners, by itself.
    phi = np.linspace(-np.pi, np.pi, 1001)
    corners = project(MIRROR, np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=-1))[0]
    around = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
    assert abs(fitting_grid((MIRROR,)).width_px - 0.7 * around) <= 20  # half a step of 40


@pytest.mark.slow
@pytest.mark.parametrize(("times", "width_px", "height_px"), [(2, 1440, None), (4, 2160, 1200)])
def test_larger_images_get_larger_panoramas_up_to_a_limit(times, width_px, height_px):
    grid = fitting_grid((enlarged(MIRROR, times),) * 2)
    assert grid.width_px == width_px
    assert height_px is None or grid.height_px == height_px
    assert grid.z_pitch == pytest.approx(grid.phi_pitch, rel=1e-12)
    # What is too much is left out below, where it is farthest from the horizon.
    assert grid.z_max == pytest.approx(0.36, abs=0.02)


def test_the_smallest_panorama():
    assert fitting_grid((binned_sensor(MIRROR, 4),) * 2).width_px == 360


def test_limits_hold_every_range_but_outliers():
    w = 1 / np.linspace(2.0, 8.0, 1000)
    near, far = limits_of(w)
    # 0.5 % and 2 % of a thousand inverse ranges, by the nearest of them.
    assert near == pytest.approx(0.6 * np.sort(1 / w)[5], rel=0.01)
    assert far == pytest.approx(np.sort(1 / w)[-21] / 0.6, rel=0.01)
    assert limits_of(w, wide=True)[1] == pytest.approx(3 * np.sort(1 / w)[-6], rel=0.01)
    assert limits_of(np.full(60, -1.0)) == (120.0, pytest.approx(200 / 0.6))  # nothing is nearer than 200 baselines


@pytest.fixture(scope="module")
def views():
    return [harness.render("box", position_m=(x, 0, 1), samples=4) for x in (0, BASELINE_M)]


@pytest.mark.slow
def test_limits_from_images_hold_the_scene(views):
    estimate = harness.estimate_range(
        views[0].image, views[1].image, MIRROR, (BASELINE_M, 0, 0), "column", fit_limits=True
    )
    truth = views[0].panorama_range_m
    assert estimate.search.startswith("search: ")
    assert "points of the scene" in estimate.search
    assert 0.4 * np.nanmin(truth) < estimate.matcher.d_min_m < np.nanmin(truth)
    assert np.nanmax(truth) < estimate.matcher.d_max_m < 5 * np.nanmax(truth)
    given = {"kind": "column", "d_min_m": 0.9, "d_max_m": 9.0}
    estimate = harness.estimate_range(
        views[0].image, views[1].image, MIRROR, (BASELINE_M, 0, 0), given, fit_limits=True
    )
    assert (estimate.matcher.d_min_m, estimate.matcher.d_max_m, estimate.search) == (0.9, 9.0, "")


@pytest.mark.slow
def test_a_motion_that_the_keypoints_contradict_leaves_the_default(views):
    estimate = harness.estimate_range(
        views[0].image, views[1].image, MIRROR, (0, BASELINE_M, 0), "column", fit_limits=True
    )
    assert (estimate.matcher.d_min_m, estimate.matcher.d_max_m) == (1.0, 10.0)
    assert "1 to 10 m, the default" in estimate.search
    assert "agree with the motion, too few" in estimate.search


@pytest.mark.slow
def test_half_the_size_gives_the_same_ranges_on_the_same_panorama(views):
    whole, half = (
        harness.estimate_range(
            views[0].image, views[1].image, MIRROR, (BASELINE_M, 0, 0), "slanted", grid="auto", scale=scale
        )
        for scale in (1, 0.5)
    )
    assert whole.pair.grid == half.pair.grid
    assert half.pair.images[0].shape == (240, 320)
    both = whole.valid & half.valid
    assert both.mean() > 0.6
    # At 3 m the parallax is 0.13 rad: this is a twentieth of a pixel of the half.
    assert np.median(np.abs(half.range_m / whole.range_m - 1)[both]) < 0.005


def test_scales_that_are_refused():
    for scale in (0.0, -1.0, 0.7, 2.0, math.nan):
        with pytest.raises(InputError, match="scale: must be 1, or one over a whole number"):
            side_of(scale, (MIRROR, MIRROR))
    assert [side_of(each, (MIRROR, MIRROR)) for each in (1, 0.5, 0.33, 0.25)] == [1, 2, 3, 4]
    with pytest.raises(InputError, match="scale: leaves 15 pixels of 480"):
        side_of(1 / 32, (MIRROR, MIRROR))


def test_a_smaller_photograph_has_means(tmp_path):
    rng = np.random.default_rng(0)
    colour = rng.integers(0, 256, (480, 640, 3)).astype(np.uint8)
    grey = colour.mean(axis=-1).astype(np.float32)
    made = smaller(Photograph(tmp_path, grey, colour, ""), MIRROR, 2)
    assert made.grey[3, 5] == pytest.approx(grey[6:8, 10:12].mean(), rel=1e-6)
    assert np.abs(made.colour[3, 5] - colour[6:8, 10:12].reshape(4, 3).mean(axis=0)).max() <= 0.5


def test_no_pairs_no_points():
    from harness.motion.features import Correspondences

    none = Correspondences(*(np.empty((0, 3)),) * 2, *(np.empty((0, 3, 2)),) * 2, *(np.empty((0, 2)),) * 2)
    assert triangulated(none, harness.Motion(np.eye(3), np.array([1.0, 0, 0]))).size == 0


def test_a_grid_of_another_kind_is_refused():
    with pytest.raises(InputError, match="grid: must be a Grid, 'auto' or None; found 7"):
        grid_of(7, (MIRROR, MIRROR), harness.Motion(np.eye(3), np.array([1.0, 0, 0])))


def test_the_command_says_what_large_images_take(capsys):
    from argparse import Namespace

    from harness.cli.range import _tell_size, ranging
    from harness.runs.photograph_settings import own_settings

    large, settings = enlarged(MIRROR, 4), own_settings("", [])
    _tell_size(Namespace(scale=1.0), large, settings)
    told = capsys.readouterr().out
    assert told.startswith("4.9 megapixels: about 25 s of CPU time and 1.2 GB of memory; --scale 0.5 --set panorama.")
    _tell_size(Namespace(scale=1.0), large, own_settings("sgm", []))
    assert capsys.readouterr().out == told
    _tell_size(Namespace(scale=0.5), large, settings)
    _tell_size(Namespace(scale=1.0), MIRROR, settings)
    assert capsys.readouterr().out == ""
    options = Namespace(scale=1.0, bits=None)
    assert ranging(options, settings)["grid"] == "auto"
    assert ranging(options, own_settings("", ["panorama.width_px=360"]))["grid"] == Grid(width_px=360)


def test_a_scale_that_is_refused_names_the_option(capsys):
    command = ["range", "a.png", "b.png", "--sensor", "mirror", "--out", "o", "--scale", "0.7"]
    assert main(command) == 2
    assert "omnirange: --scale: must be 1, or one over a whole number" in capsys.readouterr().err


def test_without_the_extra_the_limits_are_the_defaults(monkeypatch):
    def missing(*_):
        raise InputError("needs the extra")

    monkeypatch.setattr(search_limits, "points_along", missing)
    image, motion = np.zeros((480, 640), np.float32), harness.Motion(np.eye(3), np.array([0.4, 0, 0]))
    settings, told = search_limits.in_metres(Slanted(), (image, image), (MIRROR, MIRROR), motion, None)
    assert settings == Slanted()
    assert told == "search: 1 to 10 m, the default; the scene's own need pip install 'omnirange[motion]'"
