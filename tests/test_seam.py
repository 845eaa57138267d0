"""A panorama of 360 degrees has no beginning: where its seam lies must not show in anything that is made of it."""

import numpy as np
import pytest

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.models import Equirectangular
from harness.camera.sensor import Sensor, seam_px
from harness.camera.unwrap import unwrap
from harness.geometry.panorama import Grid
from harness.geometry.pose import Pose
from harness.matching.slanted.refine import refine_slanted
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.simulation.render import render, render_every_sample
from harness.simulation.scene import load_scene
from harness.spec import parse

TURNED_PX = 50
"""How far the two sensors' seams lie apart: whole pixels, so that both have the same rays."""
GRID = Grid(width_px=180, height_px=50)
POSE = Pose(position_m=(0.3, 0.2, 1.2), pitch_deg=20, roll_deg=-8)


def panorama_sensor(cx_px: float) -> Sensor:
    return Sensor(
        model=Equirectangular(),
        camera=Camera(width_px=160, height_px=80, focal_px=80 / np.pi, cx_px=cx_px, cy_px=39.5),
        field=FieldOfView(elevation_min_deg=-90, elevation_max_deg=90),
    )


HERE, THERE = panorama_sensor(79.5), panorama_sensor(79.5 - TURNED_PX)


def test_only_an_image_that_goes_round_has_a_seam():
    assert seam_px(HERE) == 32
    assert seam_px(HERE, 1000) == 160
    assert seam_px(Sensor()) == 0
    half = HERE.model_copy(update={"camera": HERE.camera.model_copy(update={"width_px": 80, "cx_px": 39.5})})
    assert seam_px(half) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["box", "room"])
def test_image_is_every_sample_of_it(name):
    """At the seam, at the poles, where pixels are narrow, and at edges across both."""
    scene = load_scene(name)
    image = render(scene, HERE, POSE, samples=4)
    np.testing.assert_array_equal(image, render_every_sample(scene, HERE, POSE, samples=4))
    # Both round the angles of the same rays.
    np.testing.assert_allclose(np.roll(image, -TURNED_PX, axis=1), render(scene, THERE, POSE, samples=4), atol=1e-4)


@pytest.mark.parametrize("interpolation", ["bilinear", "cubic"])
def test_panorama(interpolation):
    image = np.random.default_rng(0).uniform(0, 255, (80, 160)).astype(np.float32)
    image[45, 1] = np.nan  # a gap, whose neighbours are on the other side
    here = unwrap(image, HERE, GRID, interpolation=interpolation)
    there = unwrap(np.roll(image, -TURNED_PX, axis=1), THERE, GRID, interpolation=interpolation)
    np.testing.assert_array_equal(here.valid, there.valid)
    assert 0 < (~here.valid).sum() < 40
    # Coordinates are rounded by 3e-14 pixels, grey levels by 3e-5.
    np.testing.assert_allclose(here.values[here.valid], there.values[here.valid], rtol=0, atol=1e-4)


def outcome(sensor: Sensor, kind: str, cache: StageCache, *, bound: bool = False, **settings):
    table = {
        "scene": load_scene("box").model_dump(mode="json"),
        "sensor": sensor.model_dump(mode="json"),
        "panorama": GRID.model_dump(),
        "render": {"samples": 4},
        "matching": {"kind": kind} | settings,
        "scoring": {"bound": bound},
    }
    return run_trial(parse(Trial, table), cache)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["column", "slanted"])
def test_bound(kind):
    """Windows of the panorama, and of the image itself."""
    cache = StageCache()
    here, there = (outcome(sensor, kind, cache, bound=True).bound_px for sensor in (HERE, THERE))
    np.testing.assert_array_equal(np.isfinite(here), np.isfinite(there))
    assert np.isfinite(here).sum() > {"column": 1000, "slanted": 10}[kind]
    # Sums of thousands of products, in another order.
    np.testing.assert_allclose(here, there, rtol=1e-9)


@pytest.mark.slow
def test_slanted_windows():
    """And semi-global matching, which they start from: on whole numbers, so that the start is the same."""
    cache = StageCache()
    here, there = (outcome(sensor, "sgm", cache, plane_px=1) for sensor in (HERE, THERE))
    start = here.matches.alpha_2
    np.testing.assert_array_equal(start, there.matches.alpha_2)
    refined = [
        refine_slanted(each.pair.images, each.pair.sensors, each.pair.motion, GRID, start).alpha_2
        for each in (here, there)
    ]
    # The match back is read at the nearest pixel of view 2. Half-way between two it is either of them, by rounding, and
    # beside an edge these differ; how far it misses is part of the standard deviation, which decides.
    assert np.mean(np.isfinite(refined[0]) != np.isfinite(refined[1])) < 1e-3
    assert np.isfinite(refined[0]).mean() > 0.9
    # Images and planes are continued by six windows, beyond which next to nothing reaches back.
    assert np.nanmax(np.abs(refined[0] - refined[1])) < 1e-5 * GRID.phi_pitch
