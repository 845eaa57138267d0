"""What errors of a motion do to ranges, against ranges triangulated with a motion that is off."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from harness.geometry.angles import angle_between, normalise
from harness.geometry.motion_error import MotionError, range_sigma, sensitivity_to_motion
from harness.geometry.triangulation import triangulate
from harness.motion.floor import find_floor

seeds = st.integers(0, 10_000)


def ranges(x, point, t, R, omega, tau):
    """d_1 of what both views see, for an observer with another motion: |t| stays."""
    length = np.linalg.norm(t)
    assumed_R = R @ Rotation.from_rotvec(omega).as_matrix()
    assumed_t = length * normalise(t / length + tau)
    x_2 = (point - t) @ R.T  # in view 2's frame
    y = x_2 @ assumed_R
    return triangulate(angle_between(x, assumed_t), angle_between(y, assumed_t), length)[0]


@settings(deadline=None)  # the first call loads the compiled loop
@given(seeds)
def test_sensitivity_is_that_of_triangulation(seed):
    draws = np.random.default_rng(seed)
    t = draws.uniform(0.1, 1.0) * normalise(draws.normal(size=3))
    R = Rotation.random(random_state=seed).as_matrix()
    x = normalise(draws.normal(size=(20, 3)))
    x = x[(angle_between(x, t) > 0.3) & (angle_between(x, t) < np.pi - 0.3)]
    d_1 = draws.uniform(1.5, 5.0, len(x))
    j = sensitivity_to_motion(x, d_1, t)
    # tau is at right angles to t: a part along it changes nothing.
    across = np.eye(3) - np.outer(normalise(t), normalise(t))
    step = 1e-5
    for i in range(6):
        change = np.zeros(6)
        change[i] = step
        change[3:] = across @ change[3:]
        ahead, behind = (ranges(x, d_1[:, None] * x, t, R, s * change[:3], s * change[3:]) for s in (1, -1))
        # Central differences: third derivatives of d³/|t|² a radian³ at most, times 1e-10; rounding over the step.
        np.testing.assert_allclose((ahead - behind) / (2 * step), j @ change / step, rtol=1e-5, atol=1e-4)


def test_spread_of_ranges_is_the_predicted_one():
    draws = np.random.default_rng(5)
    t, R = np.array([0.3, 0.1, 0.05]), Rotation.from_euler("zyx", [1.0, 0.02, -0.03]).as_matrix()
    x, d_1 = normalise(draws.normal(size=(30, 3))), draws.uniform(1, 4, 30)
    away = np.sin(angle_between(x, t)) > 0.5
    x, d_1 = x[away], d_1[away]
    root = np.vstack([1e-4 * draws.normal(size=(3, 5)), np.zeros((3, 5))])
    root[3:] = 4e-4 * (np.eye(3) - np.outer(normalise(t), normalise(t))) @ draws.normal(size=(3, 5))
    errors = draws.normal(size=(2000, 5)) @ root.T
    measured = np.std([ranges(x, d_1[:, None] * x, t, R, e[:3], e[3:]) for e in errors], axis=0)
    predicted = range_sigma(x, d_1, t, MotionError(root @ root.T, np.zeros(6)))
    np.testing.assert_allclose(measured, predicted, rtol=0.08)  # five sigma of 2000 draws: 5/sqrt(4000)
    by_length = range_sigma(x, d_1, t, MotionError(np.zeros((6, 6)), np.zeros(6), 0.01))
    np.testing.assert_allclose(by_length, 0.01 * d_1, rtol=1e-12)  # ranges are in proportion to |t|


# --- The floor ------------------------------------------------------------------------------------------------------


def room(draws, height, tilt_deg=3.0, count=300):
    """Directions and inverse ranges: two thirds on a floor that is a little tilted, the rest anywhere."""
    normal = Rotation.from_euler("y", tilt_deg, degrees=True).apply([0, 0, 1])
    x = normalise(draws.normal(size=(count, 3)) * [1, 1, 0.3] - [0, 0, 0.6])
    x = x[x @ normal < -0.1]
    w = -(x @ normal) / height
    other = draws.random(len(w)) < 0.33
    w[other] *= draws.uniform(1.1, 2.0, other.sum())
    return x, w, normal


def test_a_floor_is_found_among_other_things():
    draws = np.random.default_rng(2)
    x, w, normal = room(draws, 4.0)
    floor = find_floor(x, w, np.array([1.0, 0, 0]))
    assert floor.height == pytest.approx(4.0, rel=1e-6)  # rounding, and what is left of points just beside the floor
    assert floor.normal @ normal == pytest.approx(1, abs=1e-9)
    assert floor.length(1.2) == pytest.approx(0.3, rel=1e-6)
    assert find_floor(-x, w, np.array([1.0, 0, 0])) is None  # a ceiling
    assert find_floor(x[:15], w[:15], np.array([1.0, 0, 0])) is None


@pytest.mark.slow
def test_its_height_moves_with_the_motion_as_predicted():
    draws = np.random.default_rng(3)
    x, w, _ = room(draws, 3.0)
    w = w * (1 + 1e-3 * draws.normal(size=len(w)))
    t, R = normalise(np.array([1.0, 0.3, 0.1])), Rotation.from_euler("z", 1.1).as_matrix()
    floor = find_floor(x, w, t)
    step, numeric, predicted = 1e-5, [], []
    for i in range(6):
        change = np.zeros(6)
        change[i] = step
        change[3:] -= t * (t @ change[3:])
        heights = [
            find_floor(x, 1 / ranges(x, x / w[:, None], t, R, s * change[:3], s * change[3:]), t).height
            for s in (1, -1)
        ]
        numeric.append(np.log(heights[0] / heights[1]) / (2 * step))
        predicted.append(floor.by_motion @ change / step)
    # The loss's scale, a median of 70 points, moves with single ones, which the prediction leaves out.
    size = np.linalg.norm(numeric), np.linalg.norm(predicted)
    assert size[1] == pytest.approx(size[0], rel=0.3)
    assert np.dot(numeric, predicted) > 0.7 * size[0] * size[1]


@pytest.mark.long
@pytest.mark.slow
def test_the_foot_of_a_wall_does_not_lift_the_floor():
    """A camera 1 m above the floor of a room of 5 m, with a baseline of 0.1 m: just above its foot a wall looks like
    floor but for less than a pixel, always nearer.
    """
    t, sigma = np.array([1.0, 0.0, 0.0]), np.radians(0.06)
    azimuth, below = np.meshgrid(np.radians(np.arange(0, 360, 5)), np.radians(np.arange(3, 75, 5)))
    x = np.stack([np.cos(azimuth) * np.cos(below), np.sin(azimuth) * np.cos(below), -np.sin(below)], -1).reshape(-1, 3)
    w = 0.1 * np.maximum(-x[:, 2], np.abs(x[:, :2]).max(axis=1) / 2.5)
    sharp = np.linalg.norm(np.cross(t, x), axis=1) / np.sum((x - w[:, None] * t) ** 2, axis=1)
    off = []
    for seed in range(40):
        draws = np.random.default_rng(seed)
        floor = find_floor(x, w + sigma / np.maximum(sharp, 0.1) * draws.normal(size=len(w)), t)
        off.append(np.log(0.1 * floor.height) / floor.share)
    # 40 deviates: their mean is known to 0.16, their root mean square to 0.11. Cauchy's loss alone has -0.5 and 1.9.
    assert abs(np.mean(off)) < 0.5
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.35)
