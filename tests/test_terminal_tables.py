"""Tables on a terminal of 80 columns: names stay whole, and figures say whether they have an interval."""

import re

import pytest

from harness.cli.results import show
from harness.cli.tables import law_tables
from harness.evaluation.metric_table import METRICS

FIGURES = dict.fromkeys(METRICS, 0.123)


@pytest.fixture(autouse=True)
def _eighty(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.parametrize(
    "name",
    [
        "harness_plugins.some_module:match_by_something",
        "program /opt/matchers/somebody/a_long_name.py",
        "columns that follow the map, with the V fit, and a name that is longer than any line",
    ],
)
def test_a_long_name_ends_its_lines_between_words(name, capsys):
    methods = {name: FIGURES, "slanted": FIGURES}
    show({"experiment": "mine", "comparison": methods, "comparison_wall": methods, "trials": {"total": 2}})
    said = capsys.readouterr().out
    assert "…" not in said
    assert max(map(len, said.splitlines())) <= 80
    for word in re.findall(r"[^\s/:_.-]+", name):
        assert re.search(rf"(?<![^\W_]){word}", said)
    assert "one trial of each method, without an interval" in said


def case(name, ends):
    settings = {"matcher": "slanted", "subpixel": "own", "trials": 4, "seeds": 2 if ends else 1, "settings": {}}
    return settings | {"case": name, "range_median_abs_m_ci95": ends} | FIGURES


def test_cases_have_intervals_or_say_that_they_have_none(capsys):
    summary = {"experiment": "mine", "headline": "So.", "conclusions": ["Thus."], "comparison": {}}
    show(summary | {"cases": [case("one, two", [0.1, 0.2]), case("three", [0.1, 0.15])]})
    said = capsys.readouterr().out
    assert "median mm [95 %]" in said
    assert "123.0 [100.0, 200.0]" in said
    show(summary | {"cases": [case("one, two", None)]})
    assert "without an interval" in capsys.readouterr().out


def test_more_than_three_sentences_are_in_the_report(capsys):
    said = [f"Sentence {number}, of 12 mm." for number in range(6)]
    show({"experiment": "mine", "headline": "So.", "conclusions": said, "comparison": {}})
    printed = capsys.readouterr().out
    assert "Sentence 2, of 12\u00a0mm." in printed
    assert "Sentence 3" not in printed
    assert "- 3 more in the report" in printed


def test_the_best_baseline_of_one_seed_has_no_interval():
    best = {"matcher": "column", "subpixel": "none", "surface": "wall", "range_m": 2.4, "baseline_m": 0.5}
    (of_one,) = law_tables({"best_baseline": [best | {"baseline_m_ci95": None}]})
    assert "one seed, without an interval" in str(of_one.renderables[0])
    (of_more,) = law_tables({"best_baseline": [best | {"baseline_m_ci95": [0.25, 0.5]}]})
    title, table = of_more.renderables
    assert str(title) == "best baseline on walls, m [95 %], of those that were tried"  # one line, wider than the table
    assert list(table.columns[1].cells) == ["0.5 \\[0.25, 0.5]"]
