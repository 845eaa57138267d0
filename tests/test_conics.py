"""Epipolar conics: points of the plane lie on them, their kind is right, distances are those of brute force."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from harness.geometry.angles import normalise
from harness.geometry.conics import epipolar_conic

VECTORS = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
XI = st.one_of(st.floats(0, 1), st.floats(1, 4), st.sampled_from([0.0, 1.0]))


def seen(directions, xi):
    """The unified projection, written out once more."""
    d = normalise(directions)
    with np.errstate(divide="ignore", invalid="ignore"):  # along the horizon of a pinhole: not there
        return d[..., :2] / (d[..., 2:] + xi), d[..., 2] + xi > 0.05


def plane_points(normal, n=200):
    some = np.random.default_rng(1).normal(size=(n, 3))
    return some - np.outer(some @ normal, normal) / (normal @ normal)


@pytest.mark.slow
@settings(deadline=None)
@given(t=VECTORS, x=VECTORS, xi=XI)
def test_points_of_the_epipolar_plane_lie_on_it(t, x, xi):
    normal = np.cross(t, x)
    assume(np.linalg.norm(normal) > 1e-3)
    conic = epipolar_conic(normal, xi)
    points, there = seen(plane_points(normalise(normal)), xi)
    # Rounding of some products of numbers up to 20 (1/0.05), squared.
    assert np.abs(conic.residual(points[there])).max(initial=0) < 1e-12
    assert conic.distance(points[there][:20]).max(initial=0) < 1e-9


@given(t=VECTORS, x=VECTORS, xi=XI)
def test_points_off_the_plane_lie_off_it(t, x, xi):
    normal = np.cross(t, x)
    assume(np.linalg.norm(normal) > 1e-2)
    points, there = seen(plane_points(normalise(normal)) + 0.3 * normalise(normal), xi)
    assume(there.any())
    assert conic_zero_share(epipolar_conic(normal, xi).residual(points[there])) < 0.05


def conic_zero_share(residual):
    return np.mean(np.abs(residual) < 1e-12)


@pytest.mark.parametrize(
    ("normal", "xi", "kind"),
    [
        ((0, 0, 1), 0.9, "ellipse"),  # the horizon: a circle
        ((1, 2, 0), 0.9, "line"),  # a plane through the axis
        ((1, 2, 3), 0.0, "line"),  # a pinhole
        ((0.1, 0, 1), 1.0, "ellipse"),  # a paraboloid makes circles of all but the planes through its axis
        ((3, 0, 0.1), 1.0, "ellipse"),
        ((1, 2, 0), 1.0, "line"),
        ((3, 0, 0.1), 0.9, "hyperbola"),  # n_z² < 1 - xi²
        ((0.1, 0, 1), 0.9, "ellipse"),
        ((np.sqrt(1 - 0.36), 0, 0.6), 0.8, "parabola"),  # n_z² = 1 - xi²
        ((3, 0, 0.1), 1.4, "ellipse"),
    ],
)
def test_kinds(normal, xi, kind):
    conic = epipolar_conic(normal, xi)
    assert conic.kind == kind
    # By the invariants of a conic: the determinant of its leading block, and its own.
    block, whole = np.linalg.det(conic.matrix[:2, :2]), np.linalg.det(conic.matrix)
    if kind == "line":
        assert abs(whole) < 1e-15
    else:
        assert abs(whole) > 1e-9
        assert {"ellipse": block > 1e-9, "hyperbola": block < -1e-9, "parabola": abs(block) < 1e-12}[kind]


def test_a_paraboloid_makes_circles():
    conic = epipolar_conic((0.5, -0.3, 0.4), 1.0)
    C = conic.matrix
    assert C[0, 0] == pytest.approx(C[1, 1])
    assert C[0, 1] == pytest.approx(0, abs=1e-15)
    points = conic.points(np.linspace(0, 6, 50))
    radius = np.linalg.norm(points + C[:2, 2] / C[0, 0], axis=1)
    assert np.ptp(radius) < 1e-12 * radius.mean() * 10  # rounding


@pytest.mark.parametrize("xi", [0.0, 0.6, 0.97, 1.0, 1.8])
def test_distance_is_the_least_over_the_plane(xi):
    normal = np.array([0.4, -0.2, 0.5])
    K = np.array([[300.0, 2.0, 320.0], [0.0, 290.0, 240.0], [0.0, 0.0, 1.0]])
    conic = epipolar_conic(normal, xi).in_image(K)
    a = normalise(np.cross(normal, [1, 0, 0]))
    b = np.cross(normalise(normal), a)

    def pixel(angle):
        m, there = seen(np.cos(angle) * a + np.sin(angle) * b, xi)
        return K[:2, :2] @ m + K[:2, 2] if there else np.full(2, np.inf)

    for point in np.random.default_rng(2).uniform([0, 0], [640, 480], (5, 2)):
        starts = np.linspace(0, 2 * np.pi, 400)
        apart = [np.linalg.norm(pixel(s) - point) for s in starts]
        best = starts[np.argmin(apart)]
        result = minimize_scalar(
            lambda s, p=point: np.linalg.norm(pixel(s) - p), bounds=(best - 0.02, best + 0.02), method="bounded",
            options={"xatol": 1e-10},
        )  # fmt: skip
        assert conic.distance(point) == pytest.approx(result.fun, rel=1e-6, abs=1e-6)  # of a bounded search


def test_in_pixels_the_points_are_the_same():
    K = np.array([[300.0, 2.0, 320.0], [0.0, 290.0, 240.0], [0.0, 0.0, 1.0]])
    conic = epipolar_conic((0.4, -0.2, 0.5), 0.9)
    m = conic.points(np.linspace(0.1, 3, 40))
    pixels = m @ K[:2, :2].T + K[:2, 2]
    assert np.allclose(conic.in_image(K).points(np.linspace(0.1, 3, 40)), pixels, rtol=1e-14)
    assert np.abs(conic.in_image(K).residual(pixels)).max() < 1e-13
    assert conic.in_image(K).kind == conic.kind


@pytest.mark.parametrize(("normal", "xi"), [((0, 0, 0), 1.0), ((1, 0, 0), -0.1), ((np.nan, 0, 1), 0.5)])
def test_what_is_no_plane_is_refused(normal, xi):
    with pytest.raises(ValueError, match="must not be zero"):
        epipolar_conic(normal, xi)
