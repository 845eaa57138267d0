"""The sentence that a sweep opens with."""

import io
import sys

import pytest
from made_up_rows import luck, rows

from harness.cli import heartbeat
from harness.evaluation.law import NO_LAW, slope_verdict
from harness.runs.headline import headline

METHODS = (("column", "none"), ("column", "parabola"))


def test_the_best_setting_is_named_beside_the_middle():
    def error_m(method, settings, seed):
        return 0.02 * luck(seed) * (2 if method[1] == "none" else 1) * (1.5 if settings["noise.sigma_grey"] else 1)

    said = headline(rows(error_m, methods=METHODS), None)
    assert said.startswith(
        "Best of 4 settings: column (parabola) with noise.sigma_grey = 0, at a median range error of "
    )
    low, high = (float(each) for each in said.partition("[")[2].partition("]")[0].split(", "))
    assert low < 20 < high  # mm; the mean of the seeds' luck is within its interval
    assert " mm on walls; half of the settings have more than " in said


def test_of_one_seed_it_says_that_there_is_no_interval():
    said = headline(rows(lambda _m, s, _seed: 0.01 * (1 + s["noise.sigma_grey"]), seeds=[1]), None)
    assert "10 mm (one seed, no interval) on walls" in said


def test_where_nothing_varies_there_is_none():
    assert headline(rows(lambda *_: 0.01, axes={"noise.sigma_grey": [0.0]}), None) is None
    assert headline([], None) is None
    assert headline(rows(lambda *_: None), None) is None


def fit(slope, ends, r2, step="none"):
    return {
        "law": "exact", "surface": "wall", "matcher": "column", "subpixel": step, "slope": slope, "slope_ci95": ends,
        "r2": r2,
    }  # fmt: skip


def test_of_a_test_of_the_law_it_is_about_the_law():
    law = {"images": [fit(0.94, [0.92, 0.96], 0.79), fit(-0.21, [-0.22, -0.2], 0.02, "parabola")]}
    assert headline(rows(lambda *_: 0.01), law) == (
        "On walls the range error grows as this power of the law, which says 1: 0.94 [0.92, 0.96] with column (whole "
        "pixels); no law to be seen with column (parabola)."
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
