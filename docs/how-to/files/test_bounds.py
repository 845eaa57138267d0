"""Error bounds of a matcher, held by a test suite."""

from harness import load_experiment, run_trial
from harness.testing.assertions import assert_density, assert_median_error, assert_within_law


def test_bounds() -> None:
    outcome = run_trial(load_experiment("small.toml").planned[0].trial)
    assert_density(outcome, at_least=0.7, reason="the window leaves the panorama on three rows at each edge")
    assert_median_error(outcome, at_most_px=0.3, surface="wall", reason="walls are nearly at one disparity in a window")
    assert_within_law(outcome, half_steps=2, share=0.9, surface="wall", reason="a match is right to the next sample")
