"""Every camera model from the scene to ranges: rendered, unwrapped, matched by every built-in matcher, with a bound."""

import numpy as np
import pytest
from sweeps import omnirange, write_small

from harness.camera.conversions import to_unified, unified_lens
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import BUILT_IN as MODELS
from harness.camera.models import DoubleSphere, ExtendedUnified, Unified
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor
from harness.camera.unwrap import unwrap
from harness.geometry.panorama import Grid
from harness.geometry.pose import Pose
from harness.matching.registry import BUILT_IN
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.simulation.render import render
from harness.simulation.scene import load_scene
from harness.spec import parse

SQUARE = {"width_px": 160, "height_px": 160, "cx_px": 79.5, "cy_px": 79.5}
"""A lens that looks up: 105 degrees off its axis are seen some 72 pixels from the centre."""

SENSORS = {
    "hyperboloid": {"camera": SQUARE | {"focal_px": 186.0}},
    "unified": {"model": {"xi": 1.2}, "camera": SQUARE | {"focal_px": 71.0, "skew_px": 0.5}, "lens": {"k1": -0.01}},
    "eucm": {"model": {"alpha": 0.6, "beta": 1.1}, "camera": SQUARE | {"focal_px": 34.0, "aspect": 1.02}},
    "double_sphere": {"model": {"xi": -0.2, "alpha": 0.6}, "camera": SQUARE | {"focal_px": 28.0}},
    "kannala_brandt": {"model": {"k1": -0.01, "k2": 0.002}, "camera": SQUARE | {"focal_px": 41.0}},
    "ocam": {"model": {"coefficients": [-40.0, 0.0, 8e-3, -2e-5, 4e-7], "d": 0.01}, "camera": SQUARE},
    "equirectangular": {
        "camera": {"width_px": 220, "height_px": 110, "focal_px": 110 / np.pi, "cx_px": 109.5, "cy_px": 54.5}
    },
}
LOOKS_UP = {"field": {"elevation_min_deg": -15, "elevation_max_deg": 90}}
UPRIGHT = ("hyperboloid", "equirectangular")

WORST = {"window": 0.15, "column": 0.12, "sgm": 0.08, "slanted": 0.03, "opencv-bm": 0.08, "opencv-sgbm": 0.1}
"""Median error of the range as a share of it. A pixel of the panorama is 2 degrees, the parallax at 3 m 9.5: a pixel is
a fifth of the range, of which samples may be off by a half."""


def table_of(model: str) -> dict:
    return SENSORS[model] | {"model": {"kind": model} | SENSORS[model].get("model", {})}


def test_no_model_is_left_out():
    assert SENSORS.keys() == MODELS.keys()


@pytest.mark.long
@pytest.mark.slow  # the loops of rendering and of slanted windows are compiled for each model
@pytest.mark.parametrize("model", SENSORS)
def test_every_matcher(model):
    upright = model in UPRIGHT
    sensor = table_of(model) | ({} if upright else LOOKS_UP)
    cache = StageCache()
    for kind in BUILT_IN:
        if kind == "program":
            continue  # somebody's
        table = {
            "scene": load_scene("box").model_dump(mode="json"),
            "sensor": sensor,
            "panorama": {"width_px": 180, "height_px": 50} | ({} if upright else {"z_max": 2.0, "z_min": -0.2}),
            "render": {"samples": 4},
            "matching": {"kind": kind},
            "scoring": {"bound": kind in ("column", "slanted")},
        }
        outcome = run_trial(parse(Trial, table), cache)
        assert all((image > 0).mean() > 0.35 for image in outcome.images)
        domain, range_m = outcome.truth.visible, outcome.truth.range_m
        assert domain.mean() > 0.95
        if kind == "opencv-reconstruct":
            continue  # at two degrees a pixel it leaves out all that is farther than the baseline
        answered = np.isfinite(outcome.range_m) & domain
        assert answered.sum() > 0.4 * domain.sum(), kind
        error = np.abs(outcome.range_m - range_m)[answered] / range_m[answered]
        assert np.median(error) < WORST[kind], kind
        if outcome.bound_px is not None:
            assert np.isfinite(outcome.bound_px).sum() > 1000, kind
            assert (outcome.bound_px[np.isfinite(outcome.bound_px)] > 0).all(), kind


FITTED = "OpenCV's omnidir was given the unified camera nearest to the "
RESAMPLED = "an image of the "
HOW = {
    "hyperboloid": "",
    "unified": "",
    "eucm": FITTED,
    "double_sphere": FITTED,
    "kannala_brandt": FITTED,
    "ocam": RESAMPLED,
    "equirectangular": RESAMPLED,
}
"""What `cv2.omnidir` is given: the camera itself, the nearest of its model, or an image of another camera."""


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("model", SENSORS)
def test_stereo_reconstruct_takes_every_model(model):
    """Scored by the formula of its own, |t| over the disparity; the pair is large enough for 15 pixels of it."""
    upright = model in UPRIGHT
    table = {
        "scene": load_scene("box").model_dump(mode="json"),
        "sensor": table_of(model) | ({} if upright else LOOKS_UP),
        "panorama": {"width_px": 180, "height_px": 50} | ({} if upright else {"z_max": 2.0, "z_min": -0.2}),
        "render": {"samples": 4},
        "matching": {
            "kind": "opencv-reconstruct",
            "rectified_scale": 4,
            "block_px": 7,
            "d_min_m": 1 if upright else 2.5,
        },
        "view_2": {"yaw_deg": 10, "baseline_m": 0.5 if upright else 1.0},
    }
    outcome = run_trial(parse(Trial, table), StageCache())
    true = outcome.reference
    matched = true.domain & np.isfinite(outcome.range_m)
    assert matched.sum() > 0.55 * true.domain.sum()
    formula = outcome.pair.motion.baseline_m / (true.alpha_2 - true.alpha_1)
    apart = np.abs(outcome.range_m / formula - 1)[matched]
    assert np.median(apart) < 0.03  # an error of its disparities of 0.3 px, of some 15: found 0.016 to 0.023
    assert outcome.matches.remark.startswith(HOW[model])
    assert bool(outcome.matches.remark) == bool(HOW[model])


@pytest.mark.slow
@pytest.mark.parametrize("sensor_2", ["unified", "equirectangular"])
def test_stereo_reconstruct_of_a_mirror_image_and_one_that_is_none(sensor_2):
    """omnidir takes two of a kind: what cannot be turned over by its frame is resampled."""
    table = {
        "scene": load_scene("box").model_dump(mode="json"),
        "sensor": table_of("hyperboloid"),
        "sensor_2": table_of(sensor_2) | {"mount": {"looks": "down" if sensor_2 == "unified" else "forward"}},
        "panorama": {"width_px": 180, "height_px": 40, "z_max": 0.2, "z_min": -1.2},
        "render": {"samples": 4},
        "matching": {"kind": "opencv-reconstruct", "rectified_scale": 4, "block_px": 7},
        "view_2": {"yaw_deg": 10},
    }
    outcome = run_trial(parse(Trial, table), StageCache())
    true = outcome.reference
    matched = true.domain & np.isfinite(outcome.range_m)
    assert matched.sum() > 0.5 * true.domain.sum()
    apart = np.abs(outcome.range_m * (true.alpha_2 - true.alpha_1) / 0.5 - 1)[matched]
    assert np.median(apart) < 0.03
    assert outcome.matches.remark.startswith(RESAMPLED)


@pytest.mark.slow
def test_stereo_reconstruct_of_one_camera_in_two_models():
    """A hyperboloid by OpenCV's maps, and the same written in the unified model by the harness's."""
    mirror = Sensor()
    unified = to_unified(mirror)
    hanging = Sensor(
        model=Unified(xi=unified.xi),
        camera=Camera(focal_px=unified.gamma_u_px),
        field=mirror.field,
        mount=Mount(looks="down", mirrored=True),
    )
    outcomes = []
    for sensor in (mirror, hanging):
        table = {
            "scene": load_scene("box").model_dump(mode="json"),
            "sensor": sensor.model_dump(mode="json"),
            "render": {"samples": 1},
            "matching": {"kind": "opencv-reconstruct"},
            "view_2": {"yaw_deg": 10},
        }
        outcomes.append(run_trial(parse(Trial, table), StageCache()).range_m)
    assert np.isfinite(outcomes[0]).mean() > 0.1
    np.testing.assert_allclose(outcomes[1], outcomes[0], rtol=1e-6)


@pytest.mark.slow
def test_same_rays_same_panorama():
    """A hyperboloid written as a unified camera that hangs, and three models that are the same lens."""
    pose, scene = Pose(position_m=(0.2, -0.3, 1.5), yaw_deg=20), load_scene("box")
    mirror = Sensor(camera=Camera(**SQUARE, focal_px=186.0, skew_px=1.0), lens=Lens(k1=-0.05, k2=0.01, p1=1e-3))
    unified = to_unified(mirror)
    hanging = Sensor(
        model=Unified(xi=unified.xi),
        camera=Camera(**SQUARE, focal_px=unified.gamma_u_px, skew_px=unified.skew_px),
        lens=unified_lens(mirror),
        field=mirror.field,
        mount=Mount(looks="down", mirrored=True),
    )
    xi, field = 0.8, FieldOfView(elevation_min_deg=-15, elevation_max_deg=90)
    lenses = [
        Sensor(model=model, camera=Camera(**SQUARE, focal_px=focal), field=field)
        for model, focal in (
            (Unified(xi=xi), 22.0 * (1 + xi)),
            (ExtendedUnified(alpha=xi / (1 + xi), beta=1.0), 22.0),
            (DoubleSphere(xi=0.0, alpha=xi / (1 + xi)), 22.0),
        )
    ]
    grids = Grid(width_px=180, height_px=50), Grid(width_px=180, height_px=50, z_max=2.0, z_min=-0.2)
    for sensors, grid in zip(([mirror, hanging], lenses), grids, strict=True):
        images = [render(scene, sensor, pose) for sensor in sensors]
        made = [unwrap(image, sensor, grid) for image, sensor in zip(images, sensors, strict=True)]
        assert made[0].valid.mean() > 0.9
        for other in made[1:]:
            np.testing.assert_array_equal(other.valid, made[0].valid)
            assert np.abs(other.values - made[0].values)[made[0].valid].max() < 0.05  # single precision, 255 levels


@pytest.mark.long
@pytest.mark.slow
def test_what_omnidir_was_given_is_said(tmp_path):
    sets = """
[trial.matching]
kind = "opencv-reconstruct"
[trial.sensor.model]
kind = "eucm"
alpha = 0.6
beta = 1.1
[trial.sensor.mount]
looks = "down"
[axes]
seed = [1, 2]
"""
    write_small(tmp_path / "small.toml", sets)
    (tmp_path / "small.toml").write_text((tmp_path / "small.toml").read_text().replace("153.53", "25.0"))
    done = omnirange(tmp_path, "run", "small.toml", "--out", "out")
    assert done.returncode == 0, done.stderr
    line = f"opencv-reconstruct, 2 trials: {FITTED}extended unified camera: "
    assert line in " ".join(done.stderr.split())
    assert line.replace("'", "&#39;") in (tmp_path / "out" / "report.html").read_text().replace("’", "&#39;")
