"""The sentence that a sweep opens with."""

import io
import sys

import pytest
from made_up_rows import luck, rows

from harness.cli import heartbeat
from harness.evaluation.law import NO_LAW, slope_verdict
from harness.report.method_styles import looks
from harness.runs.headline import Findings, headline
from harness.runs.methods import names_for_people

METHODS = (("column", "none"), ("column", "parabola"))


WINDOWS = {"matching.window_px": [7, 11], "noise.sigma_grey": [0.0, 4.0]}


def error_of(method, settings, seed):
    """Half as large with the parabola, 1.5 times as large with the small window, twice as large in noise."""
    return (
        0.02
        * luck(seed)
        * (2 if method[1] == "none" else 1)
        * (1.5 if settings["matching.window_px"] == 7 else 1)
        * (2 if settings["noise.sigma_grey"] else 1)
    )


def test_the_best_choice_is_named_beside_the_middle_over_all_conditions():
    said = headline(rows(error_of, methods=METHODS, axes=WINDOWS))
    assert said.startswith(
        "Best of 4 settings: column (parabola) with window = 11 px. Its median range error on walls, "
        "averaged over noise σ, is "
    )
    low, high = (float(each) for each in said.partition("[")[2].partition("]")[0].split(", "))
    assert low < 20 * 2**0.5 < high  # mm; the mean of the seeds' luck is within its interval
    assert " mm; the median over the settings is " in said


def test_a_condition_that_comes_first_is_what_a_sweep_is_about():
    axes = dict(reversed(WINDOWS.items()))
    said = headline(rows(error_of, methods=METHODS, axes=axes))
    assert said.startswith("noise σ: the median range error (column (parabola), on walls) is ")
    assert "at 0 grey levels, and with every seed 2 times that, " in said
    alike = headline(rows(lambda _m, s, seed: 0.01 * luck(seed, int(s["noise.sigma_grey"]))))
    assert alike.startswith("noise σ makes no difference that these seeds show (")
    # Where cases name the methods, these are what it is about, whatever the conditions.
    labels = {("column", "none"): "plain", ("column", "parabola"): "fine"}
    assert headline(rows(error_of, methods=METHODS, axes=axes), names=labels, named_by_cases=True).startswith(
        "Best of 4 settings: fine "
    )


def test_a_name_with_a_comma_is_in_quotes():
    names = {"case": ["8 bits, JPEG", "8 bits"]}
    said = headline(rows(lambda _m, s, seed: 0.01 * luck(seed) * len(s["case"]), axes=names))
    assert said.startswith("Best of 2 settings: 8 bits. ")
    said = headline(rows(lambda _m, s, seed: 0.1 * luck(seed) / len(s["case"]), axes=names))
    assert said.startswith("Best of 2 settings: “8 bits, JPEG”. ")


def test_of_one_seed_it_says_that_there_is_no_interval():
    said = headline(rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1]))
    assert "on walls is 10 mm (one seed, no interval); the median" in said


def test_where_the_seed_changes_nothing_there_is_no_interval():
    said = headline(rows(lambda _m, s, _seed: 0.001 * s["matching.window_px"], axes={"matching.window_px": [7, 11]}))
    assert "is 7 mm (the same with every seed); the median" in said


def test_the_best_baseline_is_named_for_each_range_where_that_alone_varies():
    best = [
        {"matcher": "column", "subpixel": "parabola", "surface": "wall", "range_m": range_m, "baseline_m": baseline_m,
         "baseline_m_ci95": ends}
        for range_m, baseline_m, ends in ((1.2, 0.25, [0.25, 0.5]), (1.7, 0.25, [0.125, 0.25]), (3.4, 0.5, [0.5, 0.5]))
    ]  # fmt: skip
    axes = {"view_2.baseline_m": [0.125, 0.25, 0.5, 1.0]}
    done = rows(lambda _m, s, seed: 0.01 * luck(seed) * s["view_2.baseline_m"], axes=axes)
    assert headline(done, Findings(best_baseline=best)) == (
        "The best baseline on walls (column (parabola)): 0.25 [0.125, 0.5] m at ranges of 1.2 to 1.7 m; "
        "0.5 [0.5, 0.5] m at a range of 3.4 m."
    )
    of_one = Findings(best_baseline=[best[0] | {"baseline_m_ci95": None}])
    assert "0.25 m (one seed, no interval) at a range" in headline(done, of_one)


def test_spread_against_the_bound_is_of_the_method_that_comes_nearest():
    def entry(matcher, noise_grey, ratio):
        return {
            "matcher": matcher, "subpixel": "own", "condition": "the base trial", "seeds": 16, "noise_grey": noise_grey,
            "std_over_bound": ratio, "std_over_bound_quartiles": None if ratio is None else [ratio - 0.1, ratio + 0.1],
        }  # fmt: skip

    limit = [entry("slanted", 0, None), entry("slanted", 2.5, 1.0), entry("slanted", 20, 1.03), entry("sgm", 20, 6.0)]
    assert headline(rows(lambda *_: 0.01), Findings(limit=limit)) == (
        "Over 16 draws of the noise, errors of slanted spread 1.00 to 1.03 times as far as the Cramér-Rao bound of its "
        "window, at noise of 2.5 to 20 grey levels (medians over pixels; their quartiles are within 0.90 to 1.13)."
    )


def test_a_budget_says_how_much_all_causes_make_and_which_most():
    def entry(causes, range_m, predicted, ends, seeds=4):
        return {
            "matcher": "slanted", "subpixel": "own", "condition": " ".join(causes), "causes": causes,
            "range_m": range_m, "predicted_m": predicted, "measured_m": 0.02 * range_m, "measured_ci95_m": ends,
            "seeds": seeds,
        }  # fmt: skip

    both = ["rotation", "alignment"]
    budget = [
        entry(["rotation"], 1.0, {"matching": 0.001, "rotation": 0.01}, [0.01, 0.03]),
        entry(both, 4.0, {"matching": 0.001, "rotation": 0.09, "alignment": 0.02}, None),
        entry(both, 1.0, {"matching": 0.001, "rotation": 0.01, "alignment": 0.02}, [0.01, 0.03]),
        entry(both, 8.0, {"matching": 0.1, "rotation": 0.01, "alignment": 0.02}, [0.01, 0.03], seeds=2),
    ]
    assert headline(rows(lambda *_: 0.01), Findings(budget=budget)) == (
        "With all causes together, 68 % of the errors of slanted are within 20 [10, 30] mm at 1.0 m, "
        "most of it by alignment; 80 mm (one seed, no interval) at 4.0 m, most of it by rotation."
    )


def test_a_further_score_comes_first_of_the_method_whose_ranges_are_best():
    further = ["Maps (column (whole pixels)) agree.", "Maps (column (parabola)) agree."]
    done = rows(error_of, methods=METHODS, axes=WINDOWS)
    assert headline(done, Findings(further=further)) == further[1]


def test_where_nothing_varies_there_is_none():
    assert headline(rows(lambda *_: 0.01, axes={"noise.sigma_grey": [0.0]})) is None
    assert headline([]) is None
    assert headline(rows(lambda *_: None)) is None


def fit(slope, ends, r2, step="none"):
    return {
        "law": "exact", "surface": "wall", "matcher": "column", "subpixel": step, "slope": slope, "slope_ci95": ends,
        "r2": r2,
    }  # fmt: skip


def test_of_a_test_of_the_law_it_is_about_the_law():
    law = {"images": [fit(0.94, [0.92, 0.96], 0.79), fit(-0.21, [-0.22, -0.2], 0.02, "parabola")]}
    assert headline(rows(lambda *_: 0.01), Findings(law), names_for_people(METHODS)) == (
        "On walls the range error grows as this power of the law, which says 1: 0.94 [0.92, 0.96] (whole pixels); "
        "no law to be seen (sub-pixel)."
    )


@pytest.mark.parametrize(
    ("slope", "ends", "r2", "verdict"),
    [
        (-0.21, [-0.22, -0.2], 0.02, NO_LAW),
        (0.94, [0.92, 0.96], 0.79, "grows more slowly than the law"),
        (1.22, [1.2, 1.24], 0.79, "grows faster than the law"),
        (1.0, [0.98, 1.02], 0.79, "compatible with the law"),
        (1.0, [0.5, 1.5], 0.02, "too wide to tell"),
        (1.0, None, 0.79, "one seed: nothing can be concluded"),
    ],
)
def test_a_verdict_says_what_its_interval_and_its_fit_allow(slope, ends, r2, verdict):
    assert slope_verdict(fit(slope, ends, r2)) == verdict


# --- The sign of life ---------------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_silent_terminal_is_told_that_work_goes_on(monkeypatch):
    stream = Terminal()
    now = [0.0]
    monkeypatch.setattr(heartbeat.time, "monotonic", lambda: now[0])
    pulse = heartbeat.Pulse(stream)
    out = heartbeat.Heard(stream, pulse)
    now[0] = 1.0
    pulse.beat()
    assert stream.getvalue() == ""  # not yet
    now[0] = 2.0
    pulse.beat()
    assert stream.getvalue() == "\rworking, 2 s"
    out.write("done\n")
    assert stream.getvalue() == "\rworking, 2 s\r            \rdone\n"  # the sign is gone, its line is used again


def test_a_pipe_gets_no_sign_of_life(capsys):
    with heartbeat.heartbeat():
        sys.stdout.write("said\n")
    assert capsys.readouterr().out == "said\n"


@pytest.mark.parametrize(
    ("methods", "names"),
    [
        (METHODS, ["whole pixels", "sub-pixel"]),
        ((*METHODS, ("column", "v")), ["whole pixels", "parabola", "v"]),  # two steps: which one has to be said
        ((*METHODS, ("sgm", "v")), ["column, whole pixels", "column, sub-pixel", "sgm"]),
        ((("sgm", "v"), ("sgm", "none")), ["v", "whole pixels"]),
        ((("slanted", "own"), ("window", "parabola")), ["slanted", "fine windows"]),
    ],
)
def test_a_method_has_one_name_in_sentences_and_legends(methods, names):
    cases = {("window", "parabola"): "fine windows"}
    assert list(names_for_people(methods, cases).values()) == names
    assert [each.label for each in looks(list(methods), cases).values()] == names
