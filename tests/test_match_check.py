"""Matches that cannot be right are marked: views that do not look alike, blank walls, things that moved."""

import tomllib

import numpy as np
import pytest

import harness
from harness.camera.sensor import Sensor
from harness.matching.interface import Matches, Reason
from harness.matching.pair import Pair
from harness.matching.semi_global.match import SemiGlobal
from harness.pipeline.match_check import without, without_unlike
from harness.shipped import folder

SENSOR = Sensor.model_validate(
    {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.0, "cx_px": 159.5, "cy_px": 119.5}}
)
GRID = harness.Grid(width_px=360, height_px=100)
T = (0.5, 0.0, 0.0)


@pytest.fixture(scope="module")
def views():
    return [harness.render("box", sensor=SENSOR, position_m=(x, 0, 1), samples=4, grid=GRID) for x in (0.0, 0.5)]


def test_a_match_that_does_not_look_alike_goes(views):
    pair = Pair(tuple(each.image for each in views), (SENSOR, SENSOR), harness.Motion(np.eye(3), np.array(T)), GRID)
    matcher = SemiGlobal()
    matches = matcher.match(pair)
    wrong = np.zeros(GRID.shape, bool)
    wrong[10:60, 90:150] = True
    # A twentieth of a radian is three pixels of this panorama.
    moved = np.where(wrong, matches.alpha_2 + 0.05, matches.alpha_2)
    left = without_unlike(pair, matcher, Matches(moved, reason=matches.reasons))
    inside = matches.reasons == Reason.MATCHED
    assert np.mean(left.reasons[inside & wrong] == Reason.NO_MATCH) > 0.9
    far = ~np.roll(np.roll(wrong, 8, axis=1), -16, axis=1) & ~wrong
    assert np.mean(left.reasons[inside & far] == Reason.MATCHED) > 0.95
    np.testing.assert_array_equal(np.isnan(left.alpha_2), left.reasons != Reason.MATCHED)


def test_a_blank_wall_has_no_match_in_sgm_either(views):
    images = [each.image.copy() for each in views]
    for image in images:
        image[:, 200:] = 128.0
    estimate = harness.estimate_range(*images, SENSOR, T, "sgm", grid=GRID)
    blank = np.abs(np.degrees(GRID.phi)) < 30  # u grows with x
    assert estimate.valid[:20, blank].mean() < 0.1  # a window at its border sees what is beside it
    assert estimate.valid[:, ~blank].mean() > 0.6


def test_a_matcher_that_predicts_its_sigma_is_left_as_it_is(views):
    pair = Pair(tuple(each.image for each in views), (SENSOR, SENSOR), harness.Motion(np.eye(3), np.array(T)), GRID)
    alpha_2 = np.full(GRID.shape, 1.0)
    matches = Matches(alpha_2, sigma_alpha_2=np.full(GRID.shape, 0.01))
    assert without_unlike(pair, SemiGlobal(), matches) is matches
    assert without(matches, np.zeros(GRID.shape, bool), Reason.OFF_CURVE) is matches


def _with_a_pillar(height_m):
    scene = tomllib.loads((folder("scenes") / "box.toml").read_text())
    texture = {"kind": "bundled", "name": "gravel", "tile_m": 2.0}
    pillar = {"kind": "box", "name": "pillar", "size_m": [1.6, 0.4, 1.5], "texture": texture}
    return scene | {"objects": [*scene["objects"], pillar | {"position_m": [0.25, 1.7, height_m]}]}


def _front(view):
    """The pillar's front, 1.5 m away along y, at elevations above -23 degrees."""
    grid = harness.Grid()
    elevation = np.arctan(grid.z)[:, None]
    away = np.sin(grid.phi) * view.panorama_range_m * np.cos(elevation)
    front = np.isclose(away, 1.5, atol=0.01) & (np.abs(np.degrees(grid.phi) - 81) < 20)[None, :] & (elevation > -0.4)
    assert front.sum() > 2000
    return front


@pytest.mark.slow
def test_what_moved_is_marked_and_does_not_blame_the_geometry():
    """Between the views a pillar rises by 1 cm, 1.2 px across the curves of a level baseline, and by 2 cm."""
    left = harness.render(_with_a_pillar(0.2), position_m=(0, 0, 1))
    front = _front(left)
    for rise_m, matcher in ((0.01, "sgm"), (0.02, "sgm"), (0.02, "slanted")):
        right = harness.render(_with_a_pillar(0.2 + rise_m), position_m=(0.5, 0, 1))
        estimate = harness.estimate_range(left.image, right.image, left.sensor, T, matcher)
        assert estimate.geometry.verdict == harness.Verdict.OK
        off = estimate.reason == Reason.OFF_CURVE
        if rise_m == 0.01:  # half of it lies less than a pixel off
            assert np.mean(off[front]) > 0.4
        else:
            assert np.mean(estimate.valid[front]) < 0.3
        assert np.mean(off[left.panorama_range_m > 2.5]) < 0.01
