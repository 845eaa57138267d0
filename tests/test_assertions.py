"""The assertion helpers fail where they should, and say what one needs to know."""

import dataclasses

import numpy as np
import pytest

from harness.testing.assertions import (
    assert_density,
    assert_improves,
    assert_median_error,
    assert_unbiased,
    assert_within_law,
)

WHY = "it was measured so"


@pytest.fixture
def pixel(paper):
    return paper.outcomes[0]


@pytest.fixture
def subpixel(paper):
    return paper.outcomes[1]


def test_what_holds_passes(pixel, subpixel):
    assert_within_law(pixel, half_steps=1, share=0.8, surface="wall", reason=WHY)
    assert_density(pixel, at_least=0.7, reason=WHY)
    assert_unbiased(pixel, at_most_px=0.05, surface="wall", reason=WHY)
    assert_median_error(subpixel, at_most_px=0.2, surface="wall", reason=WHY)
    assert_improves(subpixel, pixel, ratio=0.85, surface="wall", reason=WHY)


@pytest.mark.parametrize(
    ("assertion", "says"),
    [
        (lambda a, _: assert_within_law(a, half_steps=0.1, share=0.99, surface="wall", reason=WHY), "0.1 half steps"),
        (lambda a, _: assert_density(a, at_least=0.99, reason=WHY), "density on all pixels is 0.8"),
        (lambda a, _: assert_unbiased(a, at_most_px=0.0, reason=WHY), "median signed error at phi"),
        (lambda a, _: assert_median_error(a, at_most_px=0.01, surface="wall", reason=WHY), "median disparity error"),
        (lambda a, b: assert_improves(a, b, ratio=1.0, surface="wall", reason=WHY), "times trial "),
    ],
)
def test_what_does_not_hold_says_by_how_much_where_and_for_which_trial(pixel, subpixel, assertion, says):
    with pytest.raises(AssertionError) as caught:
        assertion(pixel, subpixel)
    message = str(caught.value)
    for part in (says, "missed by", "alpha_1", "range", pixel.trial.key, "scene box", "baseline 0.5 m", WHY):
        assert part in message, part
    assert "\n" not in message


def test_the_worst_place_is_named(pixel):
    """A fault planted in one cell is found there."""
    cell = max((c for c in pixel.cells if c.surface == "wall"), key=lambda c: c.pixels.size)
    spoiled = pixel.errors.range_m.copy()
    spoiled.ravel()[cell.pixels] = 100.0
    broken = dataclasses.replace(pixel, errors=dataclasses.replace(pixel.errors, range_m=spoiled))
    with pytest.raises(AssertionError) as caught:
        assert_within_law(broken, half_steps=1, share=0.95, surface="wall", reason=WHY)
    from harness.evaluation.regions import ALPHA_1_EDGES_DEG

    assert f"worst on the wall at alpha_1 {ALPHA_1_EDGES_DEG[cell.alpha_bin]:g} to" in str(caught.value)
    assert "1.00 of" in str(caught.value)


def test_an_empty_result_fails_rather_than_passes(pixel):
    """Medians of nothing are NaN, and NaN is within no bound."""
    nothing = dataclasses.replace(pixel, range_m=np.full_like(pixel.range_m, np.nan))
    for assertion in (
        lambda: assert_within_law(nothing, half_steps=9, share=0.0, reason=WHY),
        lambda: assert_median_error(nothing, at_most_px=99, reason=WHY),
        lambda: assert_unbiased(nothing, at_most_px=99, reason=WHY),
        lambda: assert_improves(nothing, pixel, ratio=99, reason=WHY),
        lambda: assert_density(nothing, at_least=0.01, reason=WHY),
    ):
        with pytest.raises(AssertionError):
            assertion()


def test_a_reason_is_not_optional(pixel):
    with pytest.raises(TypeError, match="reason"):
        assert_density(pixel, at_least=0.5)


def test_an_unknown_surface_is_refused(pixel):
    with pytest.raises(ValueError, match="wall"):
        assert_density(pixel, at_least=0.5, surface="walls", reason=WHY)
