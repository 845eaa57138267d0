"""Triangulation and the law of sensitivity, against numeric derivatives and the paper's own forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.stereo.ranging import paper_law, sensitivity_to_alpha_2, sensitivity_to_baseline, triangulate

baselines = st.floats(0.05, 2)
directions = st.floats(0.1, np.pi - 0.1)
disparities = st.floats(0.01, 1.0)


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
