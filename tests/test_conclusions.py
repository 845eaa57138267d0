"""Sentences about a sweep: they name what differs, by how much, and nothing that the seeds do not show."""

import numpy as np
import pytest
from made_up_rows import luck, rows

from harness.runs.conclusions import conclusions, leading


def test_an_axis_that_matters_is_named_with_its_ratio():
    """Twice the error at every seed, whatever the seed's own luck: pairs tell it exactly."""
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (2 if s["noise.sigma_grey"] else 1))
    (sentence,) = conclusions(done)
    assert sentence.startswith("noise σ: the median range error (column (parabola), on walls) is ")
    assert "at 0 grey levels, and with every seed 2 times that" in sentence
    assert sentence.endswith("at 4 grey levels.")


def test_an_axis_that_does_not_matter_is_said_not_to():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed, int(s["noise.sigma_grey"])))
    (sentence,) = conclusions(done)
    assert sentence.startswith("noise σ makes no difference that these seeds show (column (parabola), on walls")


def test_methods_are_compared_on_alike_trials():
    factors = {"column": 1.5, "slanted": 1.0, "sgm": 1.2}
    methods = (("column", "none"), ("slanted", "own"), ("sgm", "own"))
    done = rows(lambda m, _s, seed: 0.01 * luck(seed) * factors[m[0]], methods=methods)
    first, *_ = conclusions(done)
    assert first.startswith("slanted has the smallest median range error, ")
    assert "with every seed 0.833 times that of sgm, the next." in first
    alike = rows(lambda m, _s, seed: 0.01 * luck(seed, len(m[0])), methods=methods[1:])
    assert "have the smallest median range errors" in conclusions(alike)[0]


def test_settings_that_change_together_are_no_axes():
    done = rows(
        lambda _m, s, seed: 0.01 * luck(seed) * (1 + s["noise.sigma_grey"]), axes={"noise.sigma_grey": [0.0, 4.0]}
    )
    for row in done:
        row.coordinates["chip.bits"] = 8 if row.coordinates["noise.sigma_grey"] else 12
    assert conclusions(done) == []


METHODS = (("column", "own"), ("slanted", "own"))


@pytest.mark.parametrize("error_m", [None, np.nan, 0.0])
def test_without_any_error_nothing_is_concluded(error_m):
    """A matcher that matches nothing, or a perfect one: a sweep ends with its table all the same."""
    assert conclusions(rows(lambda *_: error_m, methods=METHODS)) == []


def test_methods_that_never_had_the_same_settings_are_not_compared():
    done = rows(lambda _m, _s, seed: 0.01 * luck(seed), methods=METHODS)
    apart = [r for r in done if (r.planned.method[0] == "column") == (r.coordinates["noise.sigma_grey"] == 0)]
    assert conclusions(apart) == ["No setting has a range error from every method: they are not compared."]


def test_long_errors_are_in_metres():
    done = rows(lambda _m, s, _seed: 0.8 if s["noise.sigma_grey"] else 1.6)
    (sentence,) = conclusions(done)
    assert "is 800 mm at 4 grey levels, and with every seed 2 times that, 1.6 m at 0 grey levels." in sentence


def test_a_ratio_of_one_seed_is_no_conclusion():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (1 + s["noise.sigma_grey"]))
    assert conclusions([r for r in done if r.coordinates["noise.sigma_grey"] == 0 or r.planned.trial.seed == 3]) == []


def test_a_small_difference_that_is_sure_is_called_small():
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * (1.015 if s["noise.sigma_grey"] else 1))
    (sentence,) = conclusions(done)
    assert sentence.startswith("noise σ changes the median range error by less than 2 % (column (parabola), ")


def test_few_seeds_are_said():
    done = rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1, 2, 3])
    assert conclusions(done)[-1] == "Intervals are over 3 seeds, and come out too short."


def test_nothing_varies_nothing_is_said():
    assert conclusions(rows(lambda *_: 0.01, axes={"noise.sigma_grey": [0.0]})) == []
    assert conclusions([]) == []


def test_from_one_seed_nothing_is_concluded():
    assert conclusions(rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1])) == []


def test_axes_come_in_the_order_of_what_they_do_and_those_that_do_nothing_together():
    axes = {
        "chip.bits": [8, 12],
        "matching.window_px": [7, 11],
        "noise.sigma_grey": [0.0, 4.0],
        "view_2.roll_deg": [0, 1],
    }
    done = rows(
        lambda _m, s, seed: (
            0.01
            * luck(seed, s["chip.bits"], s["view_2.roll_deg"])
            * (1.2 if s["matching.window_px"] == 7 else 1)
            * (2 if s["noise.sigma_grey"] else 1)
        ),
        axes=axes,
    )
    first, second, third = conclusions(done)
    assert first.startswith("noise σ: ")
    assert second.startswith("window: ")
    assert third.startswith("chip.bits and view_2.roll_deg make no difference that these seeds show (")


def test_sizes_are_products():
    sizes = {"scene.objects.0.size_m": [[4.0, 4.0, 6.0], [8.0, 8.0, 6.0]]}
    (sentence,) = conclusions(rows(lambda _m, s, seed: 0.01 * luck(seed) * s["scene.objects.0.size_m"][0], axes=sizes))
    assert " at 4 × 4 × 6 m, and with every seed 2 times that, " in sentence


def test_a_first_screen_has_three_sentences_and_the_warning():
    said = [f"{number}." for number in range(6)] + ["Intervals are over 3 seeds, and come out too short."]
    assert leading(said) == (["0.", "1.", "2.", said[-1]], ["3.", "4.", "5."])
    assert leading(said[:2]) == (said[:2], [])
