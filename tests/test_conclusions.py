"""Sentences about a sweep: they name what differs, by how much, and nothing that the seeds do not show."""

import numpy as np
import pytest
from made_up_rows import luck, rows

from harness.runs.conclusions import conclusions


def test_an_axis_that_matters_is_named_with_its_ratio():
    """Twice the error at every seed, whatever the seed's own luck: pairs tell it exactly."""
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (2 if s["noise.sigma_grey"] else 1))
    (sentence,) = conclusions(done, None)
    assert sentence.startswith("noise.sigma_grey: the median range error (column (parabola), on walls) is ")
    assert "at 0, and 2 [2, 2] times that" in sentence
    assert sentence.endswith("at 4.")


def test_an_axis_that_does_not_matter_is_said_not_to():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed, int(s["noise.sigma_grey"])))
    (sentence,) = conclusions(done, None)
    assert sentence.startswith(
        "noise.sigma_grey makes no difference that these seeds show (column (parabola), on walls"
    )


def test_methods_are_compared_on_alike_trials():
    factors = {"column": 1.5, "slanted": 1.0, "sgm": 1.2}
    methods = (("column", "none"), ("slanted", "own"), ("sgm", "own"))
    done = rows(lambda m, _s, seed: 0.01 * luck(seed) * factors[m[0]], methods=methods)
    first, *_ = conclusions(done, None)
    assert first.startswith("slanted has the smallest median range error, ")
    assert "0.833 [0.833, 0.833] times that of sgm, the next." in first
    alike = rows(lambda m, _s, seed: 0.01 * luck(seed, len(m[0])), methods=methods[1:])
    assert "have the smallest median range errors" in conclusions(alike, None)[0]


def test_settings_that_change_together_are_no_axes():
    done = rows(
        lambda _m, s, seed: 0.01 * luck(seed) * (1 + s["noise.sigma_grey"]), axes={"noise.sigma_grey": [0.0, 4.0]}
    )
    for row in done:
        row.coordinates["chip.bits"] = 8 if row.coordinates["noise.sigma_grey"] else 12
    assert conclusions(done, None) == []


METHODS = (("column", "own"), ("slanted", "own"))


@pytest.mark.parametrize("error_m", [None, np.nan, 0.0])
def test_without_any_error_nothing_is_concluded(error_m):
    """A matcher that matches nothing, or a perfect one: a sweep ends with its table all the same."""
    assert conclusions(rows(lambda *_: error_m, methods=METHODS), None) == []


def test_methods_that_never_had_the_same_settings_are_not_compared():
    done = rows(lambda _m, _s, seed: 0.01 * luck(seed), methods=METHODS)
    apart = [r for r in done if (r.planned.method[0] == "column") == (r.coordinates["noise.sigma_grey"] == 0)]
    assert conclusions(apart, None) == ["No setting has a range error from every method: they are not compared."]


def test_long_errors_are_in_metres():
    done = rows(lambda _m, s, _seed: 0.8 if s["noise.sigma_grey"] else 1.6)
    (sentence,) = conclusions(done, None)
    assert "is 800 mm at 4, and 2 [2, 2] times that, 1.6 m at 0." in sentence


def test_a_ratio_of_one_seed_is_no_conclusion():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (1 + s["noise.sigma_grey"]))
    assert (
        conclusions([r for r in done if r.coordinates["noise.sigma_grey"] == 0 or r.planned.trial.seed == 3], None)
        == []
    )


def test_a_small_difference_that_is_sure_is_called_small():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (1.015 if s["noise.sigma_grey"] else 1))
    (sentence,) = conclusions(done, None)
    assert sentence.startswith("noise.sigma_grey changes the median range error by less than 2 % (column (parabola), ")


def test_few_seeds_are_said():
    done = rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1, 2, 3])
    assert conclusions(done, None)[-1] == "Intervals are over 3 seeds, and come out too short."


def test_nothing_varies_nothing_is_said():
    assert conclusions(rows(lambda *_: 0.01, axes={"noise.sigma_grey": [0.0]}), None) == []
    assert conclusions([], None) == []


def test_from_one_seed_nothing_is_concluded():
    assert conclusions(rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1]), None) == []


@pytest.mark.parametrize(
    ("r2", "said"),
    [
        (0.9, "the error grows as its power 0.94 [0.92, 0.96], R² 0.90; 1 is the law."),
        (0.02, "none to be seen (slope 0.94 [0.92, 0.96], R² 0.02)."),
    ],
)
def test_a_slope_without_a_fit_is_no_law(r2, said):
    fit = {"law": "exact", "surface": "wall", "slope": 0.94, "slope_ci95": [0.92, 0.96], "r2": r2}
    law = {"images": [fit | {"matcher": "column", "subpixel": "none"}, fit | {"surface": "floor"}]}
    done = rows(lambda *_: 0.01)
    assert conclusions(done, law)[-1] == f"The law, column (whole pixels) on walls: {said}"
