"""What a matcher is given."""

import dataclasses

import numpy as np
import pytest

from harness.camera.sensor import Sensor, pixel_directions
from harness.camera.unwrap import unwrap
from harness.geometry.epipolar import epipolar_curves
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Pose, relative_motion
from harness.geometry.triangulation import exact_alpha_2
from harness.matching.interface import Matches
from harness.matching.pair import Pair
from harness.matching.uncertainty import sigma_alpha_2
from harness.matching.window.settings import WindowMatcher
from harness.simulation.exposure import with_exposure
from harness.simulation.render import render
from harness.simulation.scene import load_scene
from harness.simulation.truth import truth

SENSOR = Sensor()
GRID = Grid(width_px=360, height_px=100)
VIEWS = Pose(position_m=(0.0, 0.0, 1.0)), Pose(position_m=(0.4, 0.1, 1.0), yaw_deg=30.0)


@pytest.fixture(scope="module")
def pair():
    scene = load_scene("box")
    first, second = (render(scene, SENSOR, view, 4) for view in VIEWS)
    return Pair((first, second), (SENSOR, SENSOR), relative_motion(*VIEWS), GRID)


def test_both_panoramas_have_the_first_views_orientation(pair):
    first, second = pair.panoramas()
    assert np.array_equal(first.values, unwrap(pair.images[0], SENSOR, GRID).values)
    # Unwrapped in its own orientation and then turned by 30 degrees, 30 columns of this grid.
    own = unwrap(pair.images[1], SENSOR, GRID)
    assert np.array_equal(np.roll(own.valid, 30, axis=1), second.valid)
    # Two ways to interpolate the same image: alike up to the rounding of places in single-precision grey levels.
    assert np.abs(np.roll(own.values, 30, axis=1) - second.values)[second.valid].max() < 1e-3


def test_what_was_made_is_shared_and_what_differs_is_not():
    made = []
    stored = {}

    def share(stage, key, make):
        if (stage, key) not in stored:
            made.append(stage)
            stored[stage, key] = make()
        return stored[stage, key]

    image = np.zeros((480, 640), np.float32)
    one, other = (Pair((image, image), (SENSOR, SENSOR), relative_motion(*VIEWS), GRID, share=share) for _ in range(2))
    one.filtered()
    one.filtered()
    assert made == ["unwrap", "unwrap", "filter", "filter"]
    one.filtered(2.0)
    assert made.count("unwrap") == 2
    assert made.count("filter") == 4
    one.panoramas("cubic")
    assert made.count("unwrap") == 4
    other.panoramas()  # other images, for all that is known
    assert made.count("unwrap") == 6


def test_what_matchers_share_depends_on_how_panoramas_are_made():
    image = np.zeros((480, 640), np.float32)
    pair = Pair((image, image), (SENSOR, SENSOR), relative_motion(*VIEWS), GRID)
    other = dataclasses.replace(pair, log_sigma_px=3.0)
    another = dataclasses.replace(pair, interpolation="cubic")
    assert [each.shared("mine", "settings", object) is pair.shared("mine", "settings", object) for each in
            (pair, other, another)] == [True, False, False]  # fmt: skip


def test_exposure_changes_what_the_sensor_sees_and_nothing_else():
    image = np.random.default_rng(1).uniform(0, 255, (480, 640)).astype(np.float32)
    visible = pixel_directions(SENSOR)[1]
    changed = with_exposure(image, SENSOR, 1.05, -3.0)
    assert np.allclose(changed[visible], 1.05 * image[visible] - 3, atol=1e-4)  # single precision
    assert np.array_equal(changed[~visible], image[~visible])
    assert with_exposure(image, SENSOR, 1.0, 0.0) is image


@pytest.mark.slow
def test_a_predicted_standard_deviation_is_the_spread_over_noise(pair):
    """One step of least squares at the true match, whose spread the formula is about, over draws of the noise."""
    visible = truth(load_scene("box"), VIEWS[0], directions(GRID), np.ones(GRID.shape, bool), pose_2=VIEWS[1])
    t = pair.t_v1
    alpha_2 = exact_alpha_2(visible.range_m[..., None] * directions(GRID), t)
    curves = epipolar_curves(GRID, t, d_min_m=1.0, d_max_m=20.0)
    matcher = WindowMatcher(kind="column", window_px=9, d_max_m=20.0)
    draws = np.random.default_rng(3)
    sigma_grey, steps, predicted = 32.0, [], []
    for _ in range(24):
        images = tuple(
            (image + sigma_grey * draws.standard_normal(image.shape)).astype(np.float32) for image in pair.images
        )
        noisy = Pair(images, (SENSOR, SENSOR), pair.motion, GRID)
        predicted.append(sigma_alpha_2(noisy, matcher, Matches(alpha_2)))
        steps.append(one_step(noisy, curves, alpha_2, matcher.window_px))
    spread = np.std(steps, axis=0, ddof=1)
    there = np.isfinite(spread) & np.isfinite(predicted).all(axis=0) & (np.sin(curves.alpha_1) > 0.5) & visible.visible
    there &= np.abs(visible.normal[..., 2]) < 0.5
    there[:10] = there[-10:] = False
    assert there.sum() > 3000
    # The noise is so strong that what else is in the residuals (interpolation, slant: they make the prediction of weak
    # noise too large) hardly counts. Its correlation is measured over all of the panorama, but differs within it.
    assert np.median(np.mean(predicted, axis=0)[there] / spread[there]) == pytest.approx(1, abs=0.25)


def one_step(pair, curves, alpha_2, window_px):
    from scipy import ndimage

    from harness.matching.uncertainty import sampled_at

    first, second = pair.filtered()
    step = GRID.phi_pitch / 2
    before, after = (sampled_at(second, curves, alpha_2 + side * step) for side in (-1, 1))
    g, r = (after - before) / (2 * step), first.values - (after + before) / 2
    total = [
        ndimage.uniform_filter(np.nan_to_num(each), window_px, mode=("constant", "wrap")) for each in (g * r, g * g)
    ]
    textured = total[1] > 0
    return np.where(textured, total[0], np.nan) / np.where(textured, total[1], 1.0)


def test_whole_samples_add_their_own_uncertainty(pair):
    curves = epipolar_curves(GRID, pair.t_v1, d_min_m=1.0, d_max_m=10.0)
    alpha_2 = np.where(curves.defined, curves.alpha_1 + 0.1, np.nan)
    fine, whole = (
        sigma_alpha_2(pair, WindowMatcher(kind="column", subpixel=step), Matches(alpha_2))
        for step in ("parabola", "none")
    )
    there = np.isfinite(fine)
    assert there.mean() > 0.3
    assert (whole[there] > fine[there]).all()


def test_a_matchers_own_prediction_stands(pair):
    own = np.full(GRID.shape, 0.01)
    assert sigma_alpha_2(pair, WindowMatcher(), Matches(np.ones(GRID.shape), sigma_alpha_2=own)) is own
