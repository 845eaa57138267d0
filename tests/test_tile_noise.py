"""What noise does to fits of tiles, against draws of noise."""

import numpy as np
import pytest
from scipy import ndimage

import harness
from harness.camera.sensor import Sensor, pixel_directions
from harness.geometry.panorama import Grid, pixel_that_holds
from harness.geometry.pose import relative_motion
from harness.motion.across import fit_across
from harness.motion.residuals import Turn
from harness.motion.tile_noise import TileNoise, autocorrelation, by_correlation
from harness.motion.tiles import SIDE_PX


def noise(seed: int, *shape: int, blur_px: float = 0.0) -> np.ndarray:
    white = np.random.default_rng(seed).normal(size=shape)
    return ndimage.gaussian_filter(white, (0, blur_px, blur_px)) if blur_px else white


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 1.0])
def test_view_2s_part_of_what_fits_leave(blur_px):
    """The residual I_1 - a I_2 - b has the variance n_1² + a² n_2², and view 2, which is interpolated, its part."""
    gain = np.array([0.5, 1.0, 2.0])
    first, second = noise(8, 1, 600, 600), noise(9, 1, 600, 600)
    first, second = (ndimage.gaussian_filter(each[0], blur_px) if blur_px else each[0] for each in (first, second))
    places = np.random.default_rng(10).uniform(5, 594, (2, 200_000))
    between = ndimage.map_coordinates(second, places, order=3, mode="mirror")
    level = 3.0 * first.ravel()[:200_000], 4.0 * between
    residual = np.var(level[0] - gain[:, None] * level[1], axis=1)
    given = TileNoise(3.0, 4.0).smoothed(blur_px)
    # 360,000 pixels, of which smoothing by 1 px leaves some 30,000 independent ones: their variance is known to 0.8 %.
    np.testing.assert_allclose(given.in_residuals(gain), residual, rtol=0.03)
    np.testing.assert_allclose(given.of_2_in_residuals(gain), given.of_2**2 / residual, rtol=0.03)


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 1.0])
def test_pixels_are_as_alike_as_the_smoothing_makes_them(blur_px):
    """The autocorrelation of smoothed noise is that of the kernel with itself."""
    point = np.zeros((41, 41))
    point[20, 20] = 1.0
    kernel = ndimage.gaussian_filter(point, blur_px) if blur_px else point
    alone = ndimage.convolve(kernel, kernel[::-1, ::-1], mode="constant")[16:25, 16:25]
    found = autocorrelation(noise(5, 2000, 31, 31, blur_px=blur_px)[:, 7:-7, 7:-7])
    # The median of 2,000 tiles knows it to 0.01, but each is divided by the variance of few independent pixels.
    np.testing.assert_allclose(found, alone / alone[4, 4], atol=0.06)


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 1.0])
def test_the_variance_of_sums_over_smoothed_noise(blur_px):
    parts = noise(1, 4, SIDE_PX, SIDE_PX, blur_px=1.0)
    draws = noise(2, 6000, 31, 31, blur_px=blur_px)[:, 7:-7, 7:-7]
    sums = np.einsum("irc,drc->id", parts, draws)
    inflation = np.var(sums, axis=1) / (np.var(draws) * np.sum(parts**2, axis=(1, 2)))
    found = by_correlation(np.repeat(parts, 500, axis=0), draws[:2000])[::500]
    # The variance of 6,000 sums is known to 2 %, each of 80 correlations of 2,000 tiles to some 0.005.
    np.testing.assert_allclose(found, inflation, rtol=0.1)
    assert (inflation > 1.5).all() == (blur_px > 0)


def test_no_tiles():
    assert by_correlation(np.zeros((0, SIDE_PX, SIDE_PX)), np.zeros((0, SIDE_PX, SIDE_PX))).shape == (0,)


@pytest.mark.slow
def test_angles_are_found_in_full_in_noisy_images():
    """A focal length that is off moves tiles across their curves as far in noisy images as in noise-free ones, and as
    surely as their standard deviations say.
    """
    poses = harness.Pose(position_m=(0.0, 0.0, 1.0)), harness.Pose(position_m=(0.4, 0.25, 1.05), yaw_deg=70.0)
    views = [harness.render("corridor", position_m=each.position_m, yaw_deg=each.yaw_deg) for each in poses]
    camera = views[0].sensor.camera
    sensor = views[0].sensor.model_copy(
        update={"camera": camera.model_copy(update={"focal_px": 1.01 * camera.focal_px})}
    )
    motion = relative_motion(*poses)
    turn = Turn(motion.R_v2_from_v1, motion.t_v1 / motion.baseline_m)
    w = inverse_range(sensor, views[0].panorama_range_m, motion.baseline_m)
    exact, (noisy, _) = (
        fit_across(
            tuple(each.image + std * noise(k, *each.image.shape) for k, each in enumerate(views)),  # type: ignore[arg-type]
            (sensor, sensor), turn, w,
        )
        for std in (0.0, 20.0)
    )  # fmt: skip
    at = {tuple(tile): i for i, tile in enumerate(exact[0].tiles.tolist())}
    both = np.array([(i, at[tuple(tile)]) for i, tile in enumerate(noisy.tiles.tolist()) if tuple(tile) in at])
    found, true = noisy.delta[both[:, 0]], exact[0].delta[both[:, 1]]
    sigma = noisy.sigma[both[:, 0]]
    z = (found - true) / sigma
    near = np.abs(z) < 4
    weight = near / sigma**2
    part = np.sum(weight * found * true) / np.sum(weight * true**2)
    # Without smoothing 0.7 to 0.8 of them was found, in two thirds as many tiles.
    assert len(both) > 300
    assert part == pytest.approx(1.0, abs=2.5 / np.sqrt(np.sum(weight * true**2)))
    # Standard deviations are to first order in the noise, as large as the texture here, and 0.8 of the scatter; what
    # fits errors to the angles scales them to it. 400 tiles tell it to 5 %.
    assert 1.4826 * np.median(np.abs(z)) == pytest.approx(1.2, abs=0.2)


def inverse_range(sensor: Sensor, range_m: np.ndarray, baseline_m: float) -> np.ndarray:
    x, seen = pixel_directions(sensor)
    row, column, inside = pixel_that_holds(Grid(), np.nan_to_num(x))
    w = np.full(x.shape[:2], np.nan)
    inside &= seen
    w[inside] = baseline_m / range_m[row[inside].astype(int), column[inside]]
    return w
