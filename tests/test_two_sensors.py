"""A sensor of its own for view 2: as good as two equal ones, shared as far as it is equal, and never mixed up."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from sweeps import write_small

import harness
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models.kannala_brandt import KannalaBrandt
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.errors import InputError, Notice
from harness.geometry.panorama import Grid
from harness.matching.opencv.settings import StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted.settings import Slanted
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import Trial
from harness.pipeline.stages import StageKeys, setup_of
from harness.pipeline.trial import MATCH, NOISE, PAIR, RENDER, TRUTH, run_trial
from harness.runs.load import load_experiment
from harness.simulation.noise import words_of
from harness.simulation.scene import load_scene
from harness.spec import as_table, dump_toml, parse
from harness.testing.pairs import GRID, OTHER_SENSOR, SENSOR, TURNED, fresh, scenery

MATCHERS = {
    "window": WindowMatcher(),
    "column": WindowMatcher(kind="column"),
    "sgm": SemiGlobal(),
    "slanted": Slanted(),
    "opencv-sgbm": StereoSGBM(),
    "opencv-bm": StereoBM(),
    "opencv-reconstruct": StereoReconstruct(),
}


@lru_cache
def median_error_px(matcher, sensor_2=None, assumed=None):
    """Median error of alpha_2 in columns, and the share of pixels with a match.

    assumed : the sensors that the matcher is given, where they are not the true ones.
    """
    there = scenery(TURNED, sensor_2=sensor_2)
    pair = fresh(there.pair) if assumed is None else replace(fresh(there.pair), sensors=assumed)
    alpha_2 = matcher.match(pair).alpha_2
    scored = there.domain & np.isfinite(alpha_2)
    return float(np.median(np.abs(alpha_2 - there.alpha_2)[scored])) / GRID.phi_pitch, scored.sum() / there.domain.sum()


def test_the_sensors_differ_in_all_that_they_may():
    ours, other = SENSOR.camera, OTHER_SENSOR.camera
    assert SENSOR.model != OTHER_SENSOR.model
    assert (ours.width_px, ours.height_px) != (other.width_px, other.height_px)
    assert ours.focal_px != other.focal_px
    assert (ours.cx_px, ours.cy_px) != (other.cx_px, other.cy_px)
    assert OTHER_SENSOR.lens != Lens()


@pytest.mark.slow
@pytest.mark.parametrize("kind", MATCHERS)
def test_two_sensors_are_as_good_as_two_equal_ones(kind):
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    matcher = MATCHERS[kind]
    equal, density = median_error_px(matcher)
    error, share = median_error_px(matcher, OTHER_SENSOR)
    # The other sensor's pixels are 0.8 of the first one's: a little more detail, of which a matcher may make more or
    # less. Sensors mixed up are off by whole columns, see below. StereoReconstruct matches 3 % of the pixels, of which
    # a quarter is there for one sensor and not for the other.
    assert error < (1.4 if kind == "opencv-reconstruct" else 1.15) * equal
    assert share > density - 0.03


FISHEYE = Sensor(
    model=KannalaBrandt(k1=0.01),
    camera=Camera(width_px=180, height_px=170, focal_px=42.0, cx_px=88.0, cy_px=86.0),
    mount=Mount(looks="down"),
    field=FieldOfView(elevation_min_deg=-85.0, elevation_max_deg=20.0),
)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["window", "column", "sgm", "slanted"])
def test_a_fisheye_that_looks_down_beside_a_mirror(kind):
    """Two camera models and two mounts; OpenCV's matchers take the unified model alone."""
    equal, density = median_error_px(MATCHERS[kind])
    error, share = median_error_px(MATCHERS[kind], FISHEYE)
    # As many pixels to the radian as the mirror's at the horizon, fewer on the floor; the images differ in shape, which
    # square windows mind a little.
    assert error < 1.15 * equal
    assert share > density - 0.05


@pytest.mark.parametrize("assumed", [(SENSOR, SENSOR), (OTHER_SENSOR, SENSOR)], ids=["the first twice", "swapped"])
def test_a_pair_whose_sensors_are_mixed_up_is_refused(assumed):
    pair = scenery(TURNED, sensor_2=OTHER_SENSOR).pair
    with pytest.raises(ValueError, match=r"image \d is \(\d+, \d+\), its sensor"):
        replace(fresh(pair), sensors=assumed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MATCHERS)
def test_mixed_up_sensors_of_one_size_give_wrong_ranges(kind):
    """So that the test above can fail: with sensors of one size only the ranges tell."""
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    camera = SENSOR.camera.model_copy(update={"focal_px": 190.0, "cx_px": 82.0})
    other = SENSOR.model_copy(update={"camera": camera, "lens": OTHER_SENSOR.lens})
    right, density = median_error_px(MATCHERS[kind], other)
    wrong, share = median_error_px(MATCHERS[kind], other, (SENSOR, SENSOR))
    swapped, share_swapped = median_error_px(MATCHERS[kind], other, (other, SENSOR))
    # Either no longer finds matches, or finds wrong ones.
    assert wrong > 3 * right or share < 0.5 * density
    assert swapped > 3 * right or share_swapped < 0.5 * density


def test_a_matcher_of_one_sensor_is_refused():
    pair = scenery(TURNED, sensor_2=OTHER_SENSOR).pair
    with pytest.raises(InputError, match=r"mine: the views have different sensors.*pair\.sensors"):
        _ = replace(pair, owner="mine").sensor
    assert scenery(TURNED).pair.sensor == SENSOR


# --- In the pipeline ----------------------------------------------------------------------------------------------

SMALL = {"width_px": 80, "height_px": 60, "focal_px": 76.7, "cx_px": 39.5, "cy_px": 29.5}
LONGER = {"width_px": 100, "height_px": 90, "focal_px": 100.0, "cx_px": 50.5, "cy_px": 44.0}


def trial(**changes):
    table = {"sensor": {"camera": SMALL}, "panorama": {"width_px": 90, "height_px": 25}, "render": {"samples": 1}}
    return parse(Trial, {"scene": as_table(load_scene("box")), **table, "noise": {"sigma_grey": 2.0}, **changes})


def keys(one, stage):
    made = StageKeys(setup_of(one))
    return [made.of(stage, view) for view in stage.views]


def test_equal_sensors_are_one_trial_with_the_same_work():
    one, other = trial(), trial(sensor_2={"camera": SMALL})
    assert one.key == other.key
    assert one.key != trial(sensor_2={"camera": LONGER}).key
    for stage in (RENDER, NOISE, TRUTH, PAIR, MATCH):
        assert keys(one, stage) == keys(other, stage)


def test_what_the_first_view_sees_is_shared_with_any_second_sensor():
    one, other = trial(), trial(sensor_2={"camera": LONGER})
    for stage in (RENDER, NOISE):
        assert keys(one, stage)[0] == keys(other, stage)[0]
        assert keys(one, stage)[1] != keys(other, stage)[1]
    for stage in (TRUTH, PAIR, MATCH):
        assert keys(one, stage) != keys(other, stage)


def test_each_view_is_what_its_sensor_sees():
    outcome, equal = run_trial(trial(sensor_2={"camera": LONGER})), run_trial(trial())
    other = run_trial(trial(sensor={"camera": LONGER}))
    assert np.array_equal(outcome.images[0], equal.images[0])
    assert np.array_equal(outcome.images[1], other.images[1])
    assert np.array_equal(outcome.panoramas[0].values, equal.panoramas[0].values)
    assert np.array_equal(outcome.panoramas[1].values, other.panoramas[1].values)
    assert np.array_equal(outcome.truth.range_m, equal.truth.range_m, equal_nan=True)
    assert [image.shape for image in outcome.images] == [(60, 80), (90, 100)]


def test_the_second_sensors_field_says_what_is_visible():
    field = {"elevation_min_deg": -30.0}
    low = run_trial(trial(sensor_2={"camera": SMALL, "field": field})).truth
    both, first = run_trial(trial(sensor={"camera": SMALL, "field": field})).truth, run_trial(trial()).truth
    assert np.array_equal(low.range_m, first.range_m, equal_nan=True)
    visible = np.isfinite(both.range_m)
    assert np.array_equal(low.in_field_2[visible], both.in_field_2[visible])
    assert low.in_field_2.sum() < first.in_field_2.sum()


def test_noise_is_drawn_as_it_always_was():
    assert words_of(Sensor()) == (
        '{"mirror":{"a_m":0.0281,"b_m":0.0234},"camera":{"width_px":640,"height_px":480,"focal_px":614.12,"aspect":1.0,'
        '"cx_px":319.5,"cy_px":239.5},"lens":{"k1":0.0,"k2":0.0,"p1":0.0,"p2":0.0,"k3":0.0},'
        '"field":{"elevation_min_deg":-75.0,"elevation_max_deg":20.0}}'
    )
    assert words_of(Sensor(lens=Lens(k1=1e-5))) != words_of(Sensor())


def test_a_blind_second_sensor_is_refused_by_its_key():
    with pytest.raises(InputError, match=r"change sensor_2\.camera\.focal_px") as caught:
        run_trial(trial(sensor_2={"camera": SMALL | {"focal_px": 1e6}}))
    assert caught.value.key == "trial.sensor_2"


def test_a_second_sensor_that_sees_little_of_the_panorama_is_said():
    sensor_2 = Sensor(camera=Camera(**SMALL | {"focal_px": 200.0}), field=FieldOfView(elevation_max_deg=-55.0))
    with pytest.warns(Notice, match=r"only \d\.\d% of the panorama is seen: z from -3\.73 \.\. -1\.43"):
        run_trial(trial(sensor_2=as_table(sensor_2)))


# --- In files and on the command line -----------------------------------------------------------------------------


def test_a_key_of_the_second_sensor_changes_the_first_ones_copy(tmp_path):
    """Whether or not the first one is changed too, and in whatever order."""
    path = write_small(tmp_path / "small.toml")
    first = load_experiment(path).trial.sensor
    changed = load_experiment(path, ["sensor_2.camera.cx_px=70", "sensor.camera.cy_px=50"]).trial
    assert changed.sensor.camera == first.camera.model_copy(update={"cy_px": 50.0})
    assert changed.sensor_2.camera == first.camera.model_copy(update={"cy_px": 50.0, "cx_px": 70.0})
    swept = load_experiment(path, axes=["sensor_2.camera.focal_px=100,153.53"]).planned
    assert [each.trial.sensors[1].camera.focal_px for each in swept] == [100.0, 153.53]
    assert all(each.trial.sensors[1].camera.width_px == first.camera.width_px for each in swept)


def test_a_file_is_relative_to_the_experiment_and_written_out(tmp_path):
    (tmp_path / "other.toml").write_text(dump_toml(OTHER_SENSOR), encoding="utf-8")
    path = write_small(tmp_path / "small.toml")
    path.write_text(path.read_text(encoding="utf-8").replace("seed = 1", 'seed = 1\nsensor_2 = "other.toml"'))
    experiment = load_experiment(path)
    assert experiment.trial.sensors[1] == OTHER_SENSOR
    (tmp_path / "elsewhere").mkdir()
    written = tmp_path / "elsewhere" / "experiment.toml"
    written.write_text(dump_toml(experiment), encoding="utf-8")
    assert load_experiment(written).trial == experiment.trial
    swept = load_experiment(write_small(tmp_path / "plain.toml"), axes={"sensor_2": [str(tmp_path / "other.toml")]})
    assert swept.planned[0].trial.sensors[1] == OTHER_SENSOR


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two views of the box as image files, each with its sensor's file, and the true range of the first."""
    folder = tmp_path_factory.mktemp("photographs")
    grid = Grid(width_px=180, height_px=50)
    for name, x_m, sensor in (("left", 0.0, SENSOR), ("right", 0.5, OTHER_SENSOR)):
        view = harness.render("box", position_m=(x_m, 0, 1), samples=4, sensor=sensor, grid=grid)
        view.write(folder / name)
    return folder, np.load(folder / "left" / "panorama_range.npy")


def ranged(folder, *more):
    pictures = [folder / "left" / "omni.png", folder / "right" / "omni.png"]
    sizes = ["--set", "panorama.width_px=180", "--set", "panorama.height_px=50", "--matcher", "sgm"]
    given = ["--sensor", folder / "left" / "sensor.toml", "--baseline", 0.5, 0, 0, *sizes, "--out", folder / "out"]
    return main([str(each) for each in ("range", *pictures, *given, *more)])


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_photographs_by_two_sensors(photographs, capsys):
    folder, true_m = photographs
    assert ranged(folder, "--sensor-2", folder / "right" / "sensor.toml") == 0
    estimate = np.load(folder / "out" / "range.npy")
    assert np.isfinite(estimate).mean() > 0.8
    # Of 2 degrees a column and 3 m at half a metre of baseline, a tenth of a column is 6 cm.
    assert np.nanmedian(np.abs(estimate - true_m)) < 0.08
    page = (folder / "out" / "range.html").read_text(encoding="utf-8")
    assert "160 × 160 and 224 × 208 pixels, each with a sensor of its own" in page
    assert "<h3>Sensor of view 1</h3>" in page
    assert "<h3>Sensor of view 2</h3>" in page
    estimate = harness.estimate_range(
        folder / "left" / "omni.png", folder / "right" / "omni.png", SENSOR, (0.5, 0, 0), "sgm",
        sensor_2=OTHER_SENSOR, grid=Grid(width_px=180, height_px=50), fit_limits=True,
    ).range_m  # fmt: skip
    assert np.array_equal(estimate, np.load(folder / "out" / "range.npy"), equal_nan=True)
    capsys.readouterr()
    assert ranged(folder) == 2
    assert "224x208 pixels, the sensor 160x160; give the sensor that took it with --sensor-2" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_report_says_both_sensors(tmp_path):
    camera = {"width_px": 200, "height_px": 150, "focal_px": 190, "cx_px": 98, "cy_px": 75.5}
    sets = {f"sensor_2.camera.{key}": value for key, value in camera.items()}
    experiment = harness.load_experiment(write_small(tmp_path / "small.toml"), sets=sets)
    harness.run(experiment, out=tmp_path / "out").report()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Two mirror images of 160 × 120 and 200 × 150 pixels, each with a sensor of its own" in page
    assert "with a sensor of its own: hyperboloid mirror,\n200 × 150 px" in page
    assert "Mirror image of view 2, 200 by 150 pixels" in page


def test_a_mistake_names_the_key(tmp_path):
    path = write_small(tmp_path / "small.toml", "[trial.sensor_2.camera]\nfocal_pixels = 3\n")
    with pytest.raises(InputError, match=r"small\.toml: trial\.sensor_2\.camera\.focal_pixels: unknown key"):
        load_experiment(path)
