"""Triangulation and the law of sensitivity, against numeric derivatives and the paper's own forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.geometry import _triangulation_kernels as _kernels
from harness.geometry.triangulation import (
    paper_law,
    range_from_angles,
    sensitivity_to_alpha_2,
    sensitivity_to_baseline,
    triangulate,
)

baselines = st.floats(0.05, 2)
directions = st.floats(0.1, np.pi - 0.1)
disparities = st.floats(0.01, 1.0)


@settings(deadline=None)  # the first call loads the compiled loop
@given(baselines, directions, disparities)
def test_sine_rule_closes_the_triangle(baseline, alpha_1, disparity):
    alpha_2 = alpha_1 + disparity
    if alpha_2 >= np.pi - 0.05:
        return
    d_1, d_2 = triangulate(alpha_1, alpha_2, baseline)
    along = d_1 * np.cos(alpha_1) - baseline - d_2 * np.cos(alpha_2)
    across = d_1 * np.sin(alpha_1) - d_2 * np.sin(alpha_2)
    # Rounding of lengths up to |t|/sin(0.01), 200 m.
    assert abs(along) < 1e-11
    assert abs(across) < 1e-11


@settings(deadline=None)  # the first call loads the compiled loop
@given(baselines, directions, disparities)
def test_derivative_by_alpha_2_is_the_numeric_one_and_the_papers_eq_11(baseline, alpha_1, disparity):
    alpha_2 = alpha_1 + disparity
    if alpha_2 >= np.pi - 0.05:
        return
    h = 1e-4 * disparity
    d = [float(triangulate(alpha_1, alpha_2 + i * h, baseline)[0]) for i in (-2, -1, 1, 2)]
    numeric = (d[0] - 8 * d[1] + 8 * d[2] - d[3]) / (12 * h)
    exact = sensitivity_to_alpha_2(alpha_1, alpha_2, baseline)
    # Five-point differences: truncation (1e-4)^4, rounding 1e-16/1e-4, each times about 10.
    assert numeric == pytest.approx(float(exact), rel=1e-6)
    d_1 = float(triangulate(alpha_1, alpha_2, baseline)[0])
    if abs(np.sin(alpha_2)) > 1e-3:
        s = np.sin(alpha_2)
        eq_11 = d_1 * (np.cos(alpha_2) / s - np.cos(disparity) / np.sin(disparity))
        # The paper's form subtracts two large terms; its digits go with 1/sin(alpha_2).
        assert eq_11 == pytest.approx(float(exact), rel=1e-6)


@settings(deadline=None)  # the first call loads the compiled loop
@given(baselines, directions, disparities)
def test_derivative_by_the_baseline_is_eq_10(baseline, alpha_1, disparity):
    alpha_2 = alpha_1 + disparity
    if alpha_2 >= np.pi - 0.05:
        return
    h = 1e-4 * baseline
    up, down = (float(triangulate(alpha_1, alpha_2, baseline + s * h)[0]) for s in (1, -1))
    d_1 = float(triangulate(alpha_1, alpha_2, baseline)[0])
    # Range is linear in |t|: the difference is exact but for rounding, 1e-16/1e-4.
    assert (up - down) / (2 * h) == pytest.approx(float(sensitivity_to_baseline(d_1, baseline)), rel=1e-6)


def test_ranges_of_arrays_are_the_sine_rule_pixel_by_pixel():
    rng = np.random.default_rng(3)
    alpha_1, alpha_2 = rng.uniform(-0.2, np.pi, (40, 50)), rng.uniform(0, np.pi + 0.2, (40, 50))
    alpha_2[::7] = np.nan
    alpha_2[1, :5] = alpha_1[1, :5]
    d_1, d_2 = triangulate(alpha_1, alpha_2, 0.7)
    meets = (alpha_1 > 0) & (alpha_1 < alpha_2) & (alpha_2 < np.pi)
    assert 100 < meets.sum() < meets.size - 100
    np.testing.assert_array_equal(np.isfinite(d_1), meets)
    np.testing.assert_array_equal(np.isfinite(d_2), meets)
    # By cotangents: from the foot of the point's perpendicular on the baseline. Their difference loses digits with the
    # disparity, of which the smallest here is some 1e-4.
    height = 0.7 / (1 / np.tan(alpha_1[meets]) - 1 / np.tan(alpha_2[meets]))
    np.testing.assert_allclose(d_1[meets], height / np.sin(alpha_1[meets]), rtol=1e-9)
    np.testing.assert_allclose(d_2[meets], height / np.sin(alpha_2[meets]), rtol=1e-9)
    np.testing.assert_array_equal(range_from_angles(alpha_1, alpha_2, 0.7), d_1)


def test_sines_are_numpys_to_the_last_places():
    x = np.concatenate([np.linspace(0, np.pi, 100_001), 10 ** np.random.default_rng(4).uniform(-300, 0, 1000)])
    result = np.empty(x.size)
    _kernels.sines(x, result)
    np.testing.assert_allclose(result, np.sin(x), rtol=4.5e-16, atol=0)  # two units in the last place
    near_pi = np.pi - 10 ** np.linspace(-15, -1, 50)
    result = np.empty(near_pi.size)
    _kernels.sines(near_pi, result)
    np.testing.assert_allclose(result, np.sin(near_pi), rtol=4.5e-16, atol=0)


def test_the_papers_worked_example():
    """0.5 m, 3 m, 1 degree: "about 0.3 m". The exact law at 90, 30 and 15 degrees to the baseline, and d²/|t|."""
    degree = np.radians(1)
    assert float(paper_law(3.0, 0.5)) * degree == pytest.approx(0.314, abs=5e-4)
    for alpha_1, expected in ((90, 0.323), (30, 0.464), (15, 0.857)):
        a = np.radians(alpha_1)
        alpha_2 = np.arctan2(3 * np.sin(a), 3 * np.cos(a) - 0.5)
        # Quoted to three digits.
        assert -float(sensitivity_to_alpha_2(a, alpha_2, 0.5)) * degree == pytest.approx(expected, abs=5e-4)


def test_at_right_angles_the_exact_law_is_d_squared_plus_t_squared_over_t():
    alpha_2 = np.arctan2(3.0, -0.5)
    assert float(sensitivity_to_alpha_2(np.pi / 2, alpha_2, 0.5)) == pytest.approx(-(9 + 0.25) / 0.5, rel=1e-12)


@pytest.mark.parametrize("alpha_2", [0.7, 0.8, 0.8 - 1e-12, np.nan])
def test_rays_that_do_not_meet_have_no_range(alpha_2):
    assert np.isnan(triangulate(0.8, alpha_2, 0.5)[0])
