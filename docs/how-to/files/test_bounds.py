"""Error bounds of a matcher, held by a test suite."""

from harness import load_experiment, run_trial
from harness.testing.assertions import assert_density, assert_median_error, assert_within_law

OUTCOME = run_trial(load_experiment("small.toml").planned[0].trial)


def test_density() -> None:
    reason = "windows and curves that leave the panorama are not matched"
    assert_density(OUTCOME, at_least=0.7, reason=reason)


def test_median_error_on_walls() -> None:
    reason = "a window on a wall is nearly at one disparity"
    assert_median_error(OUTCOME, at_most_px=0.3, surface="wall", reason=reason)


def test_law_on_walls() -> None:
    reason = "a match is right to the next sample"
    assert_within_law(OUTCOME, half_steps=2, share=0.9, surface="wall", reason=reason)
