"""Spread against the bound: what known draws must give."""

import numpy as np
import pandas as pd
import pytest

from harness.evaluation.efficiency import efficiency, within_without_bias
from harness.report import theme
from harness.report.sections import noise_limit as drawn
from harness.report.sections import steps
from harness.report.sweep import Axis, MethodStyle, Sweep


def draws(count, pixels, std, bias=0.0, seed=0):
    return bias + std * np.random.default_rng(seed).standard_normal((count, pixels))


@pytest.mark.parametrize("count", [3, 8, 30])
def test_an_efficient_matcher_has_the_ratio_one_whatever_the_number_of_draws(count):
    bound = np.geomspace(0.01, 0.1, 20_000)
    result = efficiency(draws(count, bound.size, bound), bound)
    # The median of 20,000 spreads, each uncertain by 1/sqrt(2 (n - 1)), is known to 1.25/sqrt(2 (n - 1) 20,000).
    assert result.std_over_bound == pytest.approx(1, abs=4 * 1.25 / np.sqrt(2 * (count - 1) * bound.size))
    assert result.gross == 0
    assert result.density == 1


def test_bias_is_no_spread():
    bound = np.full(20_000, 0.05)
    result = efficiency(draws(20, bound.size, bound, bias=0.2), bound)
    assert result.std_over_bound == pytest.approx(1, abs=0.01)
    assert result.bias_px == pytest.approx(0.2, abs=0.002)
    assert result.rms_over_bound == pytest.approx(np.hypot(0.2, 0.05) / 0.05, rel=0.01)


def test_gross_errors_and_missing_estimates_are_counted_apart():
    errors = draws(20, 5_000, 0.05)
    errors[:, ::10] = np.where(np.arange(20)[:, None] < 5, 50.0, errors[:, ::10])
    errors[:8, 1::10] = np.nan
    result = efficiency(errors, np.full(5_000, 0.05))
    assert result.gross == pytest.approx(0.1 * 5 / 20 / result.density)
    assert result.density == pytest.approx(1 - 0.1 * 8 / 20)
    assert result.std_over_bound == pytest.approx(1, abs=0.02)
    assert result.pixels == 5_000


def test_pixels_without_a_bound_or_with_few_draws_do_not_count():
    errors = draws(10, 100, 0.05)
    errors[:6, :10] = np.nan
    bound = np.full(100, 0.05)
    bound[50:] = np.nan
    assert efficiency(errors, bound).pixels == 40
    assert efficiency(errors, None).std_over_bound is None
    assert efficiency(errors[:2], bound) is None
    assert efficiency(np.full((10, 100), np.nan), bound) is None


def test_a_share_within_sigma_is_freed_of_each_pixels_bias():
    rng = np.random.default_rng(4)
    bias = 0.05 * rng.standard_normal(5_000)
    errors = draws(8, bias.size, 0.05) + bias
    errors[:3, ::7] = np.nan
    one, two, three = within_without_bias(errors, np.full(errors.shape, 0.05))
    # 40,000 errors: standard errors of 0.25, 0.1 and 0.03 %. What is left of a draw after its mean is normal again.
    assert (one, two, three) == (
        pytest.approx(0.6827, abs=0.01),
        pytest.approx(0.9545, abs=0.004),
        pytest.approx(0.9973, abs=0.0015),
    )
    left_in = np.mean(np.abs(errors[np.isfinite(errors)]) <= 0.05)
    assert left_in < 0.55  # with the bias: sigma is too small by sqrt 2
    assert within_without_bias(errors[:2], errors[:2]) is None
    assert within_without_bias(np.full((5, 9), np.nan), np.ones((5, 9))) is None


# The report's figures of it -------------------------------------------------------------------------------------------


def method(step="own"):
    return MethodStyle("slanted" if step == "own" else "window", step, step, step, "#000000", "solid", "o", filled=True)


def entry(sigma_grey, seeds, std):
    names = ("density", "median_abs_px", "bad_1px", "bad_3px", "bias_px", "rms_over_bound")
    return dict.fromkeys(names, 0.1) | {
        "matcher": "slanted", "subpixel": "own", "condition": "the base trial", "sigma_grey": sigma_grey,
        "noise_grey": sigma_grey,
        "seeds": seeds, "bound_px": 0.01 * sigma_grey, "std_px": std, "std_over_bound": std and 1.0,
        "std_over_bound_quartiles": std and (0.9, 1.1), "within_sigma": None,
        "within_sigma_without_bias": None,
    }  # fmt: skip


@pytest.mark.slow
def test_a_noise_with_too_few_seeds_leaves_a_gap_in_the_figure():
    sweep = Sweep([method()], [], [1, 2, 3], pd.DataFrame(), [], pd.DataFrame())
    with theme.style():
        made = drawn.limit(sweep, [entry(2.0, 1, None), entry(5.0, 3, 0.05), entry(10.0, 1, None)])
    assert len(made.pictures) == 2
    assert len(made.table.rows) == 3


def test_a_setting_without_any_estimate_has_no_best_step():
    methods = [method("none"), method("parabola")]
    trials = pd.DataFrame(
        {
            "matcher": "window",
            "subpixel": ["none", "parabola"] * 2,
            "matching.window_px": [0, 0, 1, 1],
            "wall_disparity_median_abs_px": [0.2, 0.1, np.nan, np.nan],
            "floor_disparity_median_abs_px": np.nan,
        }
    )
    sweep = Sweep(methods, [Axis("matching.window_px", [5, 47])], [1], trials, [], pd.DataFrame())
    result = steps.steps(sweep)
    assert result.findings == [
        "Walls, parabola: smaller median error than whole pixels in 1 of 1 settings. It is the best of all in 1."
    ]
