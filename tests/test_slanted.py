"""Slanted windows: on a floor whose texture is a formula, so that images, truth and gradients are exact."""

import numpy as np
import pytest
from scipy import ndimage
from slanted_floor import (
    GRID,
    HEIGHT_M,
    SENSOR,
    SETTINGS,
    errors_px,
    motion,
    pair,
    refine,
    seen_along,
    start,
    steep,
    texture,
)

from harness.camera.sensor import pixel_directions, project
from harness.geometry.panorama import directions
from harness.geometry.pose import Motion
from harness.matching.interface import Reason, as_matches
from harness.matching.slanted.field import Step, steps_back, steps_forth
from harness.matching.slanted.refine import Slanted, refine_slanted
from harness.matching.slanted.sigma import density_at_0, smoothed_noise


@pytest.mark.slow
@pytest.mark.parametrize(
    ("t", "turn"),
    [((0.2, 0.05, 0.02), (20.0, 3.0, -2.0)), ((0.0, 0.0, 0.2), (0.0, 0.0, 0.0)), ((-0.1, 0.2, 0.0), (170.0, 0.0, 0.0))],
)
def test_a_plane_is_found(t, turn):
    there = motion(t, turn)
    matches = refine(pair(t, turn), there)
    as_matches(matches, GRID, "slanted")  # what the contract asks for
    error = np.abs(errors_px(matches, there)[steep(there)])
    assert np.mean(np.isfinite(error)) > 0.97
    # A cubic spline between samples of a wave of eight pixels is wrong by (2 pi/8)^4/384 of its height in the middle,
    # 0.1 %, and a pixel moves it by 2 pi/8: 0.001 pixels of the mirror, and some of that averages out.
    assert np.nanmedian(error) < 0.001
    # Beyond the rim the image is continued by its last pixel, which the spline carries a pixel or two inwards.
    assert np.nanquantile(error, 0.99) < 0.01


@pytest.mark.slow
def test_holes_in_the_start_are_filled():
    there = motion()
    begin = start(there)
    begin[20:40, 50:70] = np.nan
    error = np.abs(errors_px(refine(pair(), there, begin), there))
    assert np.nanmedian(error[22:38, 52:68]) < 0.001
    assert np.mean(np.isfinite(error[22:38, 52:68])) > 0.95


@pytest.mark.slow
def test_gain_and_offset_do_not_matter():
    there, (first, second) = motion(), pair()
    plain, changed = (refine((first, image), there) for image in (second, (1.3 * second - 25).astype(np.float32)))
    both = np.isfinite(plain.alpha_2) & np.isfinite(changed.alpha_2)
    assert both.mean() > 0.99 * np.isfinite(plain.alpha_2).mean()
    difference = np.abs(plain.alpha_2 - changed.alpha_2)[both] / GRID.phi_pitch
    # Grey levels in single precision, 1e-5 of 128, over slopes of some ten a pixel.
    assert np.quantile(difference, 0.99) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(threads):
    there = motion()
    one, other = (refine(pair(), there, threads=n) for n in (2, threads))
    for field in ("alpha_2", "sigma_alpha_2", "reason"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))


def test_what_lies_around_the_field_does_not_matter():
    """The same images within larger ones, which the sensor does not see."""
    there, (left, top) = motion(), (37, 80)  # running sums begin anew every 40 rows, at the same ones then
    height, width = pair()[0].shape
    camera = SENSOR.camera.model_copy(
        update={
            "width_px": width + left + 50,
            "height_px": height + top + 30,
            "cx_px": SENSOR.camera.cx_px + left,
            "cy_px": SENSOR.camera.cy_px + top,
        }
    )
    larger = SENSOR.model_copy(update={"camera": camera})
    images = [np.pad(image, ((top, 30), (left, 50)), constant_values=77) for image in pair()]
    here = refine(pair(), there)
    same = refine_slanted((images[0], images[1]), (larger, larger), there, GRID, start(there), settings=SETTINGS)
    np.testing.assert_array_equal(same.reason, here.reason)
    # The spline's coefficients are rounded to single precision, 1e-5 of 128 grey levels, over slopes of some ten.
    np.testing.assert_allclose(same.alpha_2, here.alpha_2, rtol=0, atol=1e-5 * GRID.phi_pitch)
    np.testing.assert_allclose(same.sigma_alpha_2, here.sigma_alpha_2, rtol=1e-4)


@pytest.mark.slow
def test_the_seam_is_no_border():
    """A quarter turn of a square image about its middle is exact, and moves the seam by a quarter of the panorama."""
    there = motion()
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = Motion(quarter @ there.R_v2_from_v1 @ quarter.T, quarter @ there.t_v1)
    begin = start(there)
    straight = refine(pair(), there, begin)
    images = tuple(np.ascontiguousarray(np.rot90(image, -1)) for image in pair())
    shift = GRID.width_px // 4
    rolled = refine(images, turned, np.roll(begin, shift, axis=1))
    difference = np.abs(straight.alpha_2 - np.roll(rolled.alpha_2, -shift, axis=1)) / GRID.phi_pitch
    assert np.mean(np.isfinite(difference)) > 0.97
    # Sums run the other way, which is rounding; but a start on the edge of two mirror pixels may fall to the other, and
    # in the outer rows, whose windows are cut, of two planes that fit alike the other may be taken.
    assert np.nanmedian(difference) < 1e-6
    assert np.nanmax(difference[10:40]) < 1e-4


def test_without_texture_there_is_no_answer():
    there = motion()
    flat = np.full((220, 220), 90, np.float32)
    matches = refine((flat, flat), there)
    assert np.isnan(matches.alpha_2).all()
    assert set(np.unique(matches.reason)) == {Reason.NO_MATCH}


def test_texture_beside_a_blank_place_is_no_answer_for_it():
    there, x = motion(), directions(GRID)
    x_1, visible = pixel_directions(SENSOR)

    def contrast(directions_v1, viewpoint):
        with np.errstate(divide="ignore", invalid="ignore"):
            at = viewpoint + directions_v1 * ((-HEIGHT_M - viewpoint[2]) / directions_v1[..., 2:])
        return np.clip((np.hypot(at[..., 0] + 1, at[..., 1]) - 0.6) / 0.15, 0, 1)

    rays_of_both = (x_1, np.zeros(3)), (x_1 @ there.R_v2_from_v1, there.t_v1)
    images = [128 + (image - 128) * contrast(*warp) for image, warp in zip(pair(), rays_of_both, strict=True)]
    matches = refine(tuple(np.where(visible, image, 0).astype(np.float32) for image in images), there)
    pixels, _ = project(SENSOR, x)
    row, column = np.moveaxis(np.rint(pixels[..., ::-1]).astype(int), -1, 0)
    depth = ndimage.distance_transform_edt((contrast(*rays_of_both[0]) == 0) & visible)[row, column]
    # Surroundings of 9 pixels reach 4, corners 5.7; windows of 13 pixels moved by 6 reach 12, so there are planes.
    inside = (depth > 6.5) & (depth < 12)
    assert inside.sum() > 100
    assert np.isfinite(matches.alpha_2[inside]).mean() < 0.05
    assert np.isfinite(matches.alpha_2[depth == 0]).mean() > 0.95


def test_noise_is_not_taken_for_texture():
    there = motion()
    draws = np.random.default_rng(8)
    matches = refine(tuple(draws.normal(90, 5, (2, 220, 220)).astype(np.float32)), there)
    # Two windows of noise correlate by 3 standard deviations now and then.
    assert np.mean(np.isfinite(matches.alpha_2)) < 0.01


def test_what_view_2_does_not_see_has_no_answer():
    there, (first, second) = motion(), pair()
    hidden = np.zeros(second.shape, bool)
    hidden[:, :70] = True
    other = np.where(hidden, texture(*np.meshgrid(np.linspace(50, 54, 220), np.linspace(9, 13, 220))), second)
    matches = refine((first, other.astype(np.float32)), there)
    x = directions(GRID)
    pixels, _ = project(SENSOR, there.apply(x * (-HEIGHT_M / x[..., 2:])))
    gone = pixels[..., 0] < 70 - 9
    assert np.isfinite(matches.alpha_2[gone]).mean() < 0.1
    assert (matches.reason[gone] == Reason.INCONSISTENT).any()
    assert np.isfinite(matches.alpha_2[pixels[..., 0] > 70 + 14]).mean() > 0.9


@pytest.mark.slow
def test_errors_are_near_the_bound_and_as_predicted():
    """White noise against the Cramér-Rao bound of the window, from the texture's formula."""
    there, images, noise, seeds = motion(), pair(), 6.0, 6
    all_errors, sigmas = [], []
    for seed in range(seeds):
        draws = np.random.default_rng(100 + seed)
        noisy = tuple((image + noise * draws.standard_normal(image.shape)).astype(np.float32) for image in images)
        matches = refine(noisy, there, start(there, seed=seed))
        all_errors.append(errors_px(matches, there))
        sigmas.append(matches.sigma_alpha_2 / GRID.phi_pitch)
    there_and_inside = np.isfinite(all_errors).all(axis=0) & steep(there)
    there_and_inside[:6] = there_and_inside[-6:] = False  # windows are cut at the rim
    errors, sigma = np.array(all_errors)[:, there_and_inside], np.array(sigmas)[:, there_and_inside]
    bound = noise * bound_px(there)[there_and_inside]
    efficiency = np.median(np.sqrt(np.mean(errors**2, axis=0)) / bound)
    within = np.mean(np.abs(errors) < sigma)
    # The bound is for a single unknown and gradients that are known: slopes do not cost, noise in gradients does.
    assert 0.85 < efficiency < 1.3
    # Neighbouring errors share their windows: some 300 windows apart in six trials make 1 % of standard deviation.
    assert 0.64 < within < 0.72


def bound_px(there):
    """sqrt(2/sum (dI_2/dw)²) over each pixel's window, times d alpha_2/dw, in columns."""
    x, visible = pixel_directions(SENSOR)
    h = 1e-5

    def grey(w):
        return seen_along(x - w[..., None] * there.t_v1, there.t_v1)

    with np.errstate(invalid="ignore", divide="ignore"):
        w = -x[..., 2] / HEIGHT_M
        squares = np.where(visible, ((grey(w + h) - grey(w - h)) / (2 * h)) ** 2, 0)
    total = ndimage.uniform_filter(squares, SETTINGS.window_px, mode="constant") * SETTINGS.window_px**2
    direction = directions(GRID)
    pixels, _ = project(SENSOR, direction)
    row, column = np.moveaxis(np.rint(pixels[..., ::-1]).astype(int), -1, 0)
    w = -direction[..., 2:] / HEIGHT_M
    across = np.linalg.norm(np.cross(there.t_v1, direction), axis=-1)
    rate = across / np.sum((direction - w * there.t_v1) ** 2, axis=-1)
    return np.sqrt(2 / total[row, column]) * rate / GRID.phi_pitch


def test_densities_of_sums():
    # Of equal sides, centres of B-splines: cubic 2/3, quintic 11/20 (Schoenberg).
    assert [density_at_0({1.0: m}) for m in (2, 3, 4, 6)] == pytest.approx([1, 3 / 4, 2 / 3, 11 / 20], abs=1e-14)
    # Of two sides: the lower of the two densities.
    assert density_at_0({0.25: 1, 2.0: 1}) == pytest.approx(0.5, abs=1e-14)
    # A triangle of sides 1/2 over a side of 1: all of it is under the density 1.
    assert density_at_0({0.5: 2, 1.0: 1}) == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("f", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("narrow", [0, 3])
def test_noise_that_steps_leave(f, narrow):
    """The recursion itself, on an impulse of noise; every window's plane is the mean of its noise."""
    impulse = np.zeros((321, 321))
    impulse[160, 160] = 1
    steps = steps_forth(Slanted(narrow_iterations=narrow, sharp_iterations=2))
    field = np.zeros_like(impulse)
    for step in steps:
        part = f if step.sharp else f * f
        plane, before = (ndimage.uniform_filter(each, step.window_px) for each in (impulse, field))
        field = (1 - part) / (1 - f) * plane + part * before
    # Windows of 11 and 17 samples for a continuum: 1/11², a few times over.
    expected = np.sum(field**2) / np.sum(plane**2)
    assert np.polynomial.polynomial.polyval(f, smoothed_noise(steps)) == pytest.approx(expected, rel=0.015)


def test_the_last_steps_are_sharp_and_wide_whatever_their_number():
    far, narrow, sharp = Step(17, sharp=False), Step(11, sharp=False), Step(17, sharp=True)
    assert steps_forth(Slanted()) == (*[narrow] * 3, *[far] * 2, *[sharp] * 3)
    assert steps_forth(Slanted(iterations=4)) == (narrow, *[sharp] * 3)
    assert steps_forth(Slanted(iterations=1)) == (sharp,)
    assert steps_back(Slanted(window_px=5)) == (Step(5, sharp=False), Step(5, sharp=True))


@pytest.mark.parametrize("key", ["window_px", "patch_px"])
def test_windows_have_a_centre(key):
    with pytest.raises(ValueError, match=f"{key} must be odd"):
        Slanted(**{key: 8})


def test_wrong_sizes_are_refused():
    there, (first, second) = motion(), pair()
    with pytest.raises(ValueError, match="the sensor"):
        refine((first[1:], second), there)
    with pytest.raises(ValueError, match="the panorama"):
        refine((first, second), there, np.zeros((3, 3)))
