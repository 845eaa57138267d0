"""Lens distortion: against OpenCV's published formula by hand, and its inverse against a general root finder."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import root

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, distort, fold_radius
from harness.camera.sensor import Sensor, rays_of

# Coefficients several times as strong as those of a real lens behind a mirror, of either sign.
lenses = st.builds(
    Lens,
    k1=st.floats(-0.6, 0.6),
    k2=st.floats(-0.4, 0.4),
    k3=st.floats(-0.3, 0.3),
    p1=st.floats(-0.05, 0.05),
    p2=st.floats(-0.05, 0.05),
)


def disc(radius: float, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    r, angle = radius * np.sqrt(rng.random(count)), rng.uniform(-np.pi, np.pi, count)
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)


def undistort(lens: Lens, points: np.ndarray) -> np.ndarray:
    """What `unproject` finds for normalised points: a camera of 1 px focal length whose rim is well within any fold."""
    camera = Camera(focal_px=1.0, cx_px=0.0, cy_px=0.0)
    # The sensor is made without its validation, which wants the image in pixels and the fold outside it.
    sensor = Sensor.model_construct(model=Sensor().model, camera=camera, lens=lens, field=FieldOfView())
    return rays_of(sensor, points[:, 0].copy(), points[:, 1].copy())[:2].T


def test_default_is_a_pinhole() -> None:
    points = disc(2.0, 50, seed=0)
    assert Lens().is_pinhole
    assert fold_radius(Lens()) == math.inf
    np.testing.assert_array_equal(distort(Lens(), points), points)


@pytest.mark.parametrize("name", ["k1", "k2", "p1", "p2", "k3"])
def test_every_coefficient_makes_a_lens(name: str) -> None:
    assert not Lens(**{name: 1e-3}).is_pinhole


def test_worked_example() -> None:
    """OpenCV's formula at (0.3, 0.4), r² = 0.25, worked out on paper with one coefficient after the other."""
    point = [0.3, 0.4]
    expected = {
        "k1": [0.3 + 0.3 * 0.1 * 0.25, 0.4 + 0.4 * 0.1 * 0.25],
        "k2": [0.3 + 0.3 * 0.1 * 0.0625, 0.4 + 0.4 * 0.1 * 0.0625],
        "k3": [0.3 + 0.3 * 0.1 * 0.015625, 0.4 + 0.4 * 0.1 * 0.015625],
        "p1": [0.3 + 0.1 * 2 * 0.12, 0.4 + 0.1 * (0.25 + 2 * 0.16)],
        "p2": [0.3 + 0.1 * (0.25 + 2 * 0.09), 0.4 + 0.1 * 2 * 0.12],
    }
    for name, value in expected.items():
        # A few roundings of numbers below 1.
        np.testing.assert_allclose(distort(Lens(**{name: 0.1}), point), value, rtol=0, atol=1e-15, err_msg=name)


@given(lenses, st.integers(0, 2**32 - 1))
def test_undistort_undoes_distort_everywhere_within_the_fold(lens: Lens, seed: int) -> None:
    assume(not lens.is_pinhole)
    # At the fold itself the inverse has infinite slope: 1 % inside it, rounding grows by less than 1e4.
    points = disc(0.99 * min(fold_radius(lens), 2.0), 200, seed)
    np.testing.assert_allclose(undistort(lens, distort(lens, points)), points, rtol=0, atol=1e-11)


@given(lenses, st.integers(0, 2**32 - 1))
def test_what_is_undistorted_lies_within_the_fold_and_distorts_back(lens: Lens, seed: int) -> None:
    assume(not lens.is_pinhole)
    bent = disc(5.0, 200, seed)  # mostly where the lens shows nothing
    points = undistort(lens, bent)
    result = ~np.isnan(points[:, 0])
    assert np.all(np.hypot(*points[result].T) <= fold_radius(lens))
    # The solver accepts 1e-13 of the radius, here at most 5.
    np.testing.assert_allclose(distort(lens, points[result]), bent[result], rtol=0, atol=1e-12)


def test_undistort_agrees_with_a_general_root_finder() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        lens = Lens(k1=rng.uniform(-0.3, 0.3), k2=rng.uniform(-0.1, 0.1), p1=0.004, p2=-0.003)
        point = disc(0.5 * min(fold_radius(lens), 1.0), 1, seed=2)[0]
        bent = distort(lens, point)
        solution = root(lambda p, lens=lens, bent=bent: distort(lens, p) - bent, bent, tol=1e-14)
        assert solution.success
        # MINPACK's finite differences stop it at about 1e-12.
        np.testing.assert_allclose(undistort(lens, bent[None])[0], solution.x, rtol=0, atol=1e-10)


def test_lens_that_bends_both_ways_is_undone() -> None:
    """Plain Newton swings from side to side here: found by search, kept as an example."""
    lens = Lens(k1=0.5982751108999195, k2=0.20974579012774164, p1=0.0168, p2=-0.0151, k3=-0.10218389249462609)
    points = disc(0.9 * fold_radius(lens), 5000, seed=3)
    np.testing.assert_allclose(undistort(lens, distort(lens, points)), points, rtol=0, atol=1e-11)


@given(lenses)
def test_fold_radius_is_where_the_slope_first_vanishes(lens: Lens) -> None:
    r = np.linspace(0, 3, 30_001)[1:]
    takes_away = 6 * np.hypot(lens.p1, lens.p2)
    slope = 1 + 3 * lens.k1 * r**2 + 5 * lens.k2 * r**4 + 7 * lens.k3 * r**6 - takes_away * r
    # A slope that only just touches zero is a fold for one method and none for the other.
    assume(np.abs(slope[np.r_[True, (slope[1:-1] < slope[:-2]) & (slope[1:-1] < slope[2:]), True]]).min() > 1e-3)
    folded = np.nonzero(slope <= 0)[0]
    if folded.size:
        assert fold_radius(lens) == pytest.approx(r[folded[0]], abs=1.1e-4)  # one step of the search
    else:
        assert fold_radius(lens) > 3 - 1e-4


@given(lenses, st.integers(0, 2**32 - 1))
def test_no_two_points_within_the_fold_share_an_image(lens: Lens, seed: int) -> None:
    """The Jacobian, by central differences, is positive definite: on a disc that makes the map one-to-one."""
    points = disc(0.99 * min(fold_radius(lens), 2.0), 200, seed)
    h = 1e-6
    columns = [(distort(lens, points + step) - distort(lens, points - step)) / (2 * h) for step in ([h, 0], [0, h])]
    # The slope left at 99 % of the fold is far above the 1e-9 of the differences.
    assert np.linalg.eigvalsh(np.stack(columns, axis=-1)).min() > 1e-6
