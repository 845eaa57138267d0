"""Matches on texture that repeats are told from those that are the only ones."""

import tomllib

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

import harness
from harness.api.photographs import photographs_of
from harness.camera.sensor import Sensor, project
from harness.geometry.panorama import directions
from harness.matching.interface import Reason
from harness.matching.pair import Pair
from harness.matching.semi_global.match import SemiGlobal
from harness.motion.tiles import views
from harness.pipeline import _repeated_texture_kernels as kernels
from harness.pipeline.photographs import estimate
from harness.pipeline.repeated_texture import _as_good, _middles, _on_planes, _scales
from harness.shipped import folder

SENSOR = Sensor.model_validate(
    {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.0, "cx_px": 159.5, "cy_px": 119.5}}
)
GRID = harness.Grid(width_px=360, height_px=100)
SHIFT = np.radians(np.arange(-20, 21, 0.5))


def peaks(*at_height: tuple[float, float], width_deg: float = 1.0) -> np.ndarray:
    """Correlations with peaks at some shifts, degrees."""
    shift = np.degrees(SHIFT)
    return np.max([height * np.exp(-(((shift - at) / width_deg) ** 2)) for at, height in at_height], axis=0)


@pytest.mark.parametrize(
    ("correlation", "repeats"),
    [
        (peaks((0, 0.95)), False),
        (peaks((0, 0.95), (8, 0.9)), True),
        (peaks((0, 0.95), (-8, 0.9)), True),
        (peaks((0, 0.95), (8, 0.8)), False),  # less good
        (peaks((0, 0.75), (8, 0.7)), False),  # in noise that may be chance
        (peaks((0, 0.5), (8, 0.9)), True),  # the other one is better
        (peaks((0, 0.95), (2, 0.95), width_deg=2.5), False),  # one wide peak
        (np.where(np.abs(SHIFT) < 0.1, peaks((0, 0.95)), np.nan), False),  # nothing else was searched
    ],
)
def test_another_peak_as_good_is_another_range(correlation, repeats):
    assert _as_good(correlation[None], SHIFT).tolist() == [repeats]


def test_inverse_ranges_are_scaled_by_equal_steps_of_alpha_2():
    a_1, w = np.radians([40.0, 90.0, 140.0]), np.array([0.1, 0.3, 0.2])
    scale, shift = _scales(a_1, w, 0.05, 0.5)
    # A point at distance 1/w in direction a_1; viewpoint 2 is at 1 along t.
    seen = np.arctan2(np.sin(a_1)[:, None] / (scale * w[:, None]), np.cos(a_1)[:, None] / (scale * w[:, None]) - 1)
    here = np.arctan2(np.sin(a_1) / w, np.cos(a_1) / w - 1)
    there = np.isfinite(scale)
    np.testing.assert_allclose((seen - here[:, None])[there], np.broadcast_to(shift, scale.shape)[there], atol=1e-12)
    ranges = (scale * w[:, None])[there & (shift != 0)]
    assert ranges.min() >= 0.05
    assert ranges.max() <= 0.5
    assert (scale[:, shift == 0] == 1).all()
    # All of the search but the last step, at either end.
    assert (there.sum(axis=1) > 10).all()


def test_windows_have_the_planes_through_their_ranges():
    draws = np.random.default_rng(3)
    x = draws.normal([1, 0, 0], 0.1, (5, 81, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    planes = draws.normal([0.3, 0, 0], 0.02, (5, 3))
    w = np.einsum("nmi,ni->nm", x, planes)
    given = w * draws.normal(1, 0.01, w.shape)
    given[:, :20] = np.nan
    given[:, 20:30] *= 3  # another surface
    found = _on_planes(given, x, w[:, 40])
    # 51 ranges of 1 % tell a plane to 0.01/sqrt(51) times the square root of its 3 numbers, farther at its border.
    np.testing.assert_allclose(found, w, rtol=0.02)
    # With a single range there is no plane but the one that faces the view.
    alone = np.where(np.arange(81) == 40, w, np.nan)
    np.testing.assert_allclose(_on_planes(alone, x, w[:, 40])[:, 40], w[:, 40], rtol=1e-4)


def test_a_cell_is_judged_by_its_known_pixel_nearest_to_the_middle():
    known = np.zeros((10, 12), bool)
    known[1, 1] = known[2, 3] = known[9, 11] = True
    row, column = _middles(known, 4)
    assert sorted(zip(row.tolist(), column.tolist(), strict=True)) == [(2, 3), (9, 11)]
    assert not _middles(np.zeros((10, 12), bool), 4)[0].size


def test_correlations_are_numpys():
    sensor = Sensor.model_validate(
        {"camera": {"width_px": 160, "height_px": 120, "focal_px": 153.5, "cx_px": 79.5, "cy_px": 59.5}}
    )
    images = tuple(
        harness.render("box", sensor=sensor, position_m=(x, 0, 1), samples=4).image.astype(np.float32) for x in (0, 0.5)
    )
    grid = harness.Grid(width_px=180, height_px=50)
    pair = Pair(images, (sensor, sensor), harness.Motion(np.eye(3), np.array([0.5, 0, 0])), grid)
    x = np.ascontiguousarray(directions(grid)[10:15, 40:45].reshape(1, 25, 3))
    w, scale = np.full((1, 25), 0.15), np.array([[0.5, 1.0, 1.5, np.nan]])
    grey = pair.panoramas()[0].values[10:15, 40:45].reshape(1, 25).astype(np.float64)
    given, found = views(images, pair.sensors), np.empty((1, 4))
    t = np.array([1.0, 0, 0])
    kernels.correlations(0, 1, x, w, scale, grey, np.eye(3), t, given.camera, given.coefficients, 0.5, found)
    spline = ndimage.spline_filter(images[1].astype(np.float64), 3, mode="mirror")
    for k in range(3):
        pixels, inside = project(sensor, x[0] - scale[0, k] * w[0, :, None] * t)
        assert inside.all()
        other = ndimage.map_coordinates(spline, pixels[:, ::-1].T, order=3, mode="mirror", prefilter=False)
        # Coefficients are kept in single precision.
        assert found[0, k] == pytest.approx(np.corrcoef(grey[0], other)[0, 1], abs=1e-4)
    assert np.isnan(found[0, 3])
    # Fewer samples than half of them, or no texture: nothing is said.
    few = np.where(np.arange(25) < 10, grey, np.nan)
    for given_grey in (few, np.full((1, 25), 100.0)):
        kernels.correlations(0, 1, x, w, scale, given_grey, np.eye(3), t, given.camera, given.coefficients, 0.5, found)
        assert np.isnan(found).all()


@pytest.fixture(scope="module")
def striped(tmp_path_factory):
    """The box with a floor of stripes, 0.2 m wide."""
    file = tmp_path_factory.mktemp("stripes") / "stripes.png"
    Image.fromarray(np.tile(np.where(np.arange(128) // 16 % 2, 180, 70).astype(np.uint8), (128, 1))).save(file)
    scene = tomllib.loads((folder("scenes") / "box.toml").read_text())
    floor = {"bottom": {"kind": "image", "file": str(file), "tile_m": 1.6}}
    return scene | {"objects": [scene["objects"][0] | floor]}


@pytest.mark.slow
def test_a_floor_of_stripes_is_left_out_where_another_period_fits(striped):
    first, second = (harness.render(striped, position_m=(x, 0, 1)) for x in (0, 0.5))
    estimate = harness.estimate_range(first.image, second.image, first.sensor, (0.5, 0, 0))
    truth_m = first.panorama_range_m
    wrong = np.abs(estimate.range_m / truth_m - 1) > 0.1
    repeated = estimate.reason == Reason.REPEATED
    floor = np.sin(np.arctan(estimate.pair.grid.z))[:, None] * truth_m < -0.99
    # Stripes cross the baseline, and one period makes ranges 5 times as long: three in four of the floor's were.
    assert repeated.mean() > 0.3
    assert repeated[~floor].mean() < 0.02
    assert wrong[estimate.valid].mean() < 0.03
    assert any("its texture repeats" in line for line in estimate.lines())


@pytest.mark.slow
@pytest.mark.parametrize("matcher", ["slanted", "sgm"])
def test_texture_that_does_not_repeat_keeps_its_ranges(matcher):
    first, second = (harness.render("box", position_m=(x, 0, 1)) for x in (0, 0.5))
    draws = np.random.default_rng(5)
    for noise in (0.0, 10.0):
        images = [np.clip(each.image + noise * draws.normal(size=each.image.shape), 0, 255) for each in (first, second)]
        estimate = harness.estimate_range(*images, first.sensor, (0.5, 0, 0), matcher)
        assert not (estimate.reason == Reason.REPEATED).any()
        assert not any("repeats" in line for line in estimate.lines())


@pytest.mark.slow
def test_a_period_that_was_not_searched_is_no_other_range(striped):
    first, second = (harness.render(striped, sensor=SENSOR, position_m=(x, 0, 1), grid=GRID) for x in (0, 0.5))
    near = first.panorama_range_m < 1.8
    shares = []
    for matcher in (SemiGlobal(), SemiGlobal(d_min_m=1.15, d_max_m=1.9)):
        estimate = harness.estimate_range(first.image, second.image, SENSOR, (0.5, 0, 0), matcher, grid=GRID)
        shares.append(np.mean((estimate.reason == Reason.REPEATED)[near]))
    # A period more or less makes them 5 times as long, or 0.56 times.
    assert shares[0] > 0.2
    assert shares[1] == 0


@pytest.mark.slow
def test_limits_that_were_estimated_are_not_trusted(striped):
    """A floor of stripes has hardly any keypoints, and may be nearer than those of the walls."""
    left, right = (harness.render(striped, sensor=SENSOR, position_m=(x, 0, 1), grid=GRID).image for x in (0, 0.5))
    images = photographs_of(left, right, (SENSOR, SENSOR), None)
    motion = harness.Motion(np.eye(3), np.array([0.5, 0, 0]))
    shares = []
    for known in (True, False):
        matcher = SemiGlobal(d_min_m=1.9)  # most of the floor is nearer
        estimated = estimate(*images, (SENSOR, SENSOR), motion, matcher, GRID, limits_known=known)
        shares.append(np.mean(estimated.reason == Reason.REPEATED))
    assert shares[1] > shares[0] + 0.05
