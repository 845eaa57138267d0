"""Photographs of unequal sharpness, soft ones, and images made smaller."""

import numpy as np
import pytest
from repeats import few
from scipy import ndimage

import harness
from harness.camera.binning import binned, binned_sensor
from harness.camera.sensor import Sensor, project
from harness.geometry.panorama import directions
from harness.matching.interface import Matches, Reason
from harness.matching.pair import Pair
from harness.pipeline.sharpness import compare_sharpness, equalised, filled, half_size, has_few_matches

SMALL = Sensor.model_validate(
    {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.0, "cx_px": 159.5, "cy_px": 119.5}}
)
GRID = harness.Grid(width_px=360, height_px=100)
MODELS = {
    "hyperboloid": {},
    "fisheye": {"model": {"kind": "kannala_brandt"}, "field": {"angle_max_deg": 90}, "camera": {"focal_px": 140.0}},
    "ocam": {
        "model": {"kind": "ocam", "coefficients": [-180.0, 0.0, 1e-3, 1e-7], "c": 0.99, "d": 0.01, "e": -0.02},
        "field": {"angle_max_deg": 80},
    },
    "equirectangular": {
        "model": {"kind": "equirectangular"},
        "camera": {"width_px": 480, "height_px": 240, "focal_px": 480 / (2 * np.pi), "cx_px": 239.5, "cy_px": 119.5},
    },
}


@pytest.fixture(scope="module")
def views():
    poses = {"position_m": (0.0, 0.0, 1.0)}, {"position_m": (0.4, 0.25, 1.05), "yaw_deg": 70.0}
    return [harness.render("box", sensor=SMALL, samples=4, grid=GRID, **pose) for pose in poses]


def compared(views, images):
    motion = harness.relative_motion(*(each.pose for each in views))
    return compare_sharpness(images, (SMALL, SMALL), motion, GRID)


def blurred(image, sigma_px):
    return ndimage.gaussian_filter(image, sigma_px).astype(np.float32) if sigma_px else image


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("side", [2, 3])
def test_a_binned_sensor_projects_to_the_middle_of_the_square(name, side):
    sensor = Sensor.model_validate(MODELS[name])
    x = directions(GRID)[::7, ::5]
    pixels, valid = project(sensor, x)
    mine, _ = project(binned_sensor(sensor, side), x)
    # Square j holds pixels side j .. side j + side - 1; coordinates of some hundred pixels.
    np.testing.assert_allclose(mine[valid], (pixels[valid] - (side - 1) / 2) / side, atol=1e-9)


def test_binning_takes_means_and_leaves_out_what_is_missing():
    image = np.arange(240 * 320, dtype=np.float32).reshape(240, 320)
    image[10, 11] = np.nan
    small = binned(image, SMALL, 2)
    assert np.isnan(small[5, 5])
    assert np.isnan(small).sum() == 1
    assert small[0, 1] == np.mean(image[:2, 2:4])
    assert binned(np.repeat(image[..., None], 3, axis=2), SMALL, 3).shape == (80, 106, 3)


def test_images_that_are_equally_sharp_stay_the_same_arrays(views):
    images = views[0].image, views[1].image
    for blur_px in (0.0, 0.4):
        given = images[0], blurred(images[1], blur_px)
        sharpness = compared(views, given)
        assert sharpness.added_px == (0.0, 0.0)
        assert sharpness.lines() == []
        made = equalised(given, (SMALL, SMALL), sharpness)
        assert all(a is b for a, b in zip(made, given, strict=True))


@pytest.mark.parametrize("blur_px", [1.0, 2.0])
@pytest.mark.parametrize("softer", [0, 1])
def test_the_difference_in_blur_is_found(views, blur_px, softer):
    images = [each.image for each in views]
    images[softer] = blurred(images[softer], blur_px)
    sharpness = compared(views, tuple(images))
    assert sharpness.added_px[softer] == 0
    # Parallax shows each view something else, on this small image by a tenth of the blur.
    assert sharpness.added_px[1 - softer] == pytest.approx(blur_px, rel=0.2)
    assert f"view {2 - softer} is sharper" in sharpness.lines()[0]
    made = equalised(tuple(images), (SMALL, SMALL), sharpness)
    assert made[softer] is images[softer]


def test_sensors_of_another_scale_are_not_compared(views):
    other = SMALL.model_copy(update={"camera": SMALL.camera.model_copy(update={"focal_px": 250.0})})
    motion = harness.relative_motion(*(each.pose for each in views))
    images = views[0].image, blurred(views[1].image, 2.0)
    assert compare_sharpness(images, (SMALL, other), motion, GRID).added_px == (0.0, 0.0)


def test_gaps_stay_gaps_and_do_not_spread(views):
    images = [each.image.copy() for each in views]
    images[0][100:110, 200:220] = np.nan
    images[1] = blurred(images[1], 2.0)
    made = equalised(tuple(images), (SMALL, SMALL), compared(views, tuple(images)))
    np.testing.assert_array_equal(np.isnan(made[0]), np.isnan(images[0]))


def test_only_soft_images_with_few_matches_are_tried_at_half_size(views):
    soft = compared(views, tuple(blurred(each.image, 2.0) for each in views))
    sharp = compared(views, tuple(each.image for each in views))
    large = (np.zeros((480, 640), np.float32),) * 2
    assert has_few_matches(soft, 0.3, large)
    assert not has_few_matches(soft, 0.6, large)
    assert not has_few_matches(sharp, 0.3, large)
    assert not has_few_matches(soft, 0.3, tuple(each.image for each in views))


def test_others_fill_what_is_missing_alone():
    matched, none = Reason.MATCHED, Reason.NO_MATCH
    first = Matches(np.array([[1.0, np.nan, np.nan]]), reason=np.array([[matched, none, none]], np.uint8))
    second = Matches(np.array([[2.0, 2.0, np.nan]]), reason=np.array([[matched, matched, none]], np.uint8))
    both = filled(first, second)
    np.testing.assert_array_equal(both.alpha_2, [[1.0, 2.0, np.nan]])
    np.testing.assert_array_equal(both.reasons, [[matched, matched, none]])


def test_a_pair_of_half_the_size_sees_the_same(views):
    motion = harness.relative_motion(*(each.pose for each in views))
    pair = Pair(tuple(blurred(each.image, 2.0) for each in views), (SMALL, SMALL), motion, GRID)
    small, large = half_size(pair).panoramas()[0], pair.panoramas()[0]
    both = small.valid & large.valid
    # A mean over 2 x 2 pixels adds little to a blur of 2 px; a shift of half a pixel would take 1 % off.
    assert np.corrcoef(small.values[both], large.values[both])[0, 1] > 0.995


@pytest.mark.slow
@pytest.mark.parametrize("blur_px", few(1, [2.0, 1.0]))
def test_a_blurred_view_costs_little(blur_px):
    """Without a remedy 22 % of the panorama has a range with a blur of 1 px in one view, and none with 2."""
    left, right = (harness.render("box", position_m=p, yaw_deg=y) for p, y in (((0, 0, 1), 0), ((0.4, 0.25, 1.05), 70)))
    motion = harness.relative_motion(left.pose, right.pose)
    estimate = harness.estimate_range(left.image, blurred(right.image, blur_px), left.sensor, motion)
    assert estimate.valid.mean() > 0.8
    error = np.abs(estimate.range_m / left.panorama_range_m - 1)
    assert np.nanmedian(error) < 0.003
    assert estimate.geometry.verdict == harness.Verdict.OK
