"""Unwrapping the mirror image onto the cylinder."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from harness.camera import _sampling_kernels as _kernels
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, pixel_directions
from harness.camera.unwrap import unwrap
from harness.geometry.panorama import Grid, cylinder, pixel_of, pixel_that_holds

SENSOR = Sensor()
GRID = Grid()


def pattern(directions):
    """A smooth function of the direction: it changes by at most about 2 grey levels a mirror pixel."""
    x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
    return 128 + 60 * np.sin(3 * np.arctan2(y, x)) * np.sqrt(1 - z * z) + 30 * np.cos(5 * z)


def picture(sensor):
    directions, visible = pixel_directions(sensor)
    return np.where(visible, pattern(np.nan_to_num(directions, nan=1.0)), 0).astype(np.float32)


@pytest.mark.parametrize("interpolation", ["bilinear", "cubic"])
@pytest.mark.parametrize(
    "sensor",
    [
        SENSOR,
        Sensor(lens=Lens(k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3)),
        Sensor(camera=Camera(cx_px=310.3, cy_px=236.8, aspect=0.98)),
    ],
    ids=["default", "distorted", "off-centre"],
)
def test_panorama_shows_the_world_where_it_is(sensor, interpolation):
    panorama = unwrap(picture(sensor), sensor, GRID, interpolation=interpolation)
    error = (panorama.values - pattern(cylinder(GRID)))[panorama.valid]
    assert panorama.valid.mean() > 0.95
    # Bilinear interpolation is off by at most 1/8 of the second difference of a pixel, 0.07 grey levels here; a shift
    # of half a pixel in the chain would be off by a whole grey level.
    assert np.abs(error).max() < 0.1
    assert abs(error.mean()) < 0.01


def test_bilinear_values_are_the_weighted_mean_of_four_pixels():
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 255, (480, 640)).astype(np.float32)
    panorama = unwrap(image, SENSOR, GRID)
    from harness.camera.sensor import project

    pixels, _ = project(SENSOR, cylinder(GRID))
    u, v = pixels[..., 0], pixels[..., 1]
    i, j = np.floor(v).astype(int), np.floor(u).astype(int)
    a, b = v - i, u - j
    by_hand = (
        (1 - a) * (1 - b) * image[i, j]
        + (1 - a) * b * image[i, j + 1]
        + a * (1 - b) * image[i + 1, j]
        + a * b * image[i + 1, j + 1]
    )
    # Single precision of values up to 255.
    np.testing.assert_allclose(panorama.values, by_hand, atol=1e-4)


def test_bilinear_samples_are_scipys_beyond_the_border_too():
    rng = np.random.default_rng(5)
    image = rng.uniform(0, 255, (20, 30)).astype(np.float32)
    where = np.concatenate([rng.uniform(-3, 33, (2, 1000)), np.mgrid[-2:21, -2:31].reshape(2, -1)], axis=1)
    result = np.empty(where.shape[1], np.float32)
    _kernels.bilinear(image, where[0], where[1], result)
    expected = ndimage.map_coordinates(image, where, order=1, mode="nearest", output=np.float64)
    np.testing.assert_allclose(result, expected, rtol=2e-7)  # single precision


@pytest.mark.parametrize("columns", [1, 90, -250])
def test_a_turn_by_whole_columns_shifts_the_panorama_exactly(columns):
    image = np.random.default_rng(2).uniform(0, 255, (480, 640)).astype(np.float32)
    turn = Rotation.from_euler("z", columns * GRID.phi_pitch).as_matrix()
    turned = unwrap(image, SENSOR, GRID, R_sensor_from_panorama=turn)
    straight = unwrap(image, SENSOR, GRID)
    # The same points are sampled but for rounding of 1e-13 px, times a slope of up to 255 a pixel, in single precision.
    np.testing.assert_allclose(turned.values, np.roll(straight.values, -columns, axis=1), atol=1e-3)


def test_taking_out_a_rotation_shows_the_world_unrotated():
    rotation = Rotation.from_euler("ZYX", [40, 4, -3], degrees=True).as_matrix()
    directions, visible = pixel_directions(SENSOR)
    image = np.where(visible, pattern(np.nan_to_num(directions, nan=1.0) @ rotation.T), 0).astype(np.float32)
    panorama = unwrap(image, SENSOR, GRID, R_sensor_from_panorama=rotation.T)
    error = (panorama.values - pattern(cylinder(GRID)))[panorama.valid]
    assert np.abs(error).max() < 0.1  # as above
    # The tilt hides a part of the top rows from the sensor.
    assert 0.9 < panorama.valid.mean() < 1


@pytest.mark.parametrize("interpolation", ["bilinear", "cubic"])
def test_valid_pixels_are_made_of_seen_pixels_alone(interpolation):
    tall = Grid(height_px=400, z_max=0.6, z_min=-6.0)
    image = picture(SENSOR)
    visible = pixel_directions(SENSOR)[1]
    poisoned = np.where(visible, image, np.float32(1e6))
    clean, dirty = (unwrap(each, SENSOR, tall, interpolation=interpolation) for each in (image, poisoned))
    assert not clean.valid.all()
    np.testing.assert_array_equal(clean.values[clean.valid], dirty.values[clean.valid])
    # Rows above the rim (20 deg) and below the blind disc (-75 deg) are not valid, those well inside are.
    elevation = np.degrees(np.arctan(tall.z))
    assert not clean.valid[(elevation > 20) | (elevation < -75)].any()
    assert clean.valid[(elevation < 18.5) & (elevation > -73)].all()


def test_the_default_grid_is_seen_whole_and_its_pixels_are_square():
    for interpolation in ("bilinear", "cubic"):
        assert unwrap(picture(SENSOR), SENSOR, GRID, interpolation=interpolation).valid.all()
    # To the four digits that the default z_min is written with.
    assert GRID.z_pitch == pytest.approx(GRID.phi_pitch, rel=1e-4)


def test_columns_are_centred_as_documented():
    assert GRID.phi[0] == pytest.approx(-np.pi + np.pi / 720, abs=1e-15)
    assert GRID.phi[-1] == pytest.approx(np.pi - np.pi / 720, abs=1e-14)
    assert GRID.z[0] == pytest.approx(GRID.z_max - GRID.z_pitch / 2, abs=1e-15)


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="the image is"):
        unwrap(np.zeros((10, 10), np.float32), SENSOR, GRID)


def test_pixels_of_directions_are_those_whose_centres_they_are():
    grid = Grid(width_px=90, height_px=25)
    row, column = pixel_of(grid, 3.7 * cylinder(grid))
    expected = np.mgrid[:25, :90].astype(float)
    # Both come of a handful of operations on numbers up to 90.
    assert np.allclose(row, expected[0], atol=1e-11)
    assert np.allclose(column, expected[1], atol=1e-11)
    inside_row, inside_column, inside = pixel_that_holds(grid, cylinder(grid))
    assert inside.all()
    assert np.array_equal(inside_row, expected[0])
    assert np.array_equal(inside_column, expected[1])
    _, _, above = pixel_that_holds(grid, [[1.0, 0.0, grid.z_max + 1e-9], [0.0, 0.0, 1.0], [1.0, 0.0, grid.z_min]])
    assert not above.any()
    seam = pixel_that_holds(grid, [-1.0, 0.0, 0.0])[1], pixel_that_holds(grid, [-1.0, -1e-12, 0.0])[1]
    assert seam == (0, 0)  # phi = pi is phi = -pi
