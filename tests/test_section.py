"""Sections of the report: one is added from outside, one fails, and each page has its order, numbers and contents."""

import re

import pytest
from test_report import Document, run_small
from test_report_faults import toml

from harness import interrupts
from harness.cli.parser import main
from harness.report import build, theme
from harness.report.build import build_report
from harness.report.data import Data, Heading, Table, count, words
from harness.report.markup import html
from harness.report.section import (
    About,
    Context,
    Figure,
    FixedTable,
    InAbstract,
    Paragraph,
    Section,
    TableBlock,
    section_of,
)
from harness.report.sections import SECTIONS, failures, measures, trial_settings
from harness.runs.run import Result

RUN = (measures.section, trial_settings.section)
"""Two of the sections that come along: quick to make."""


@pytest.fixture(scope="module")
def swept() -> Result:
    return run_small(axes={"seed": [1, 2]})


def headings(page: str) -> list[str]:
    return [f"{number} {title}" for number, title in re.findall(r'<h2 id="[a-z-]+">(\d+)\. ([^<]*)</h2>', page)]


@theme.panel
def dot(size: float):
    fig = theme.figure(100, 100)
    theme.axes(fig, 10, 10, 80, 80).plot([1 / size], [0.0], "o")
    return theme.picture(fig, "One dot.", "a dot")


@section_of(About.ALL_TRIALS, "places", lambda context: f"Places of {len(context.result.rows)} trials")
def places(context):
    keys = [row.planned.key for row in context.result.rows]
    yield InAbstract(html("<p>There are places.</p>"))
    yield Paragraph(html("<p>Said of {{ what }}.</p>", what="<trials>"))
    yield Figure("figure-places", [dot(1.0)], html("Dots of {{ alpha(2) }}."), data=Data("places", ["key"], [keys]))
    yield TableBlock("table-places", Table([Heading("Trial", text=True), Heading("Number")],
                     [[words(key), count(i)] for i, key in enumerate(keys)]), html("Keys."))  # fmt: skip
    yield FixedTable(html("<tbody><tr><td>fixed</td></tr></tbody>"), html("Nothing to sort."))


def test_a_section_from_outside_is_in_the_page(swept):
    missing: list[str] = []
    page = build_report(swept, missing, (*RUN, places))
    assert missing == []
    # About all trials, so it comes before what is about the run.
    assert headings(page) == ["1 All figures", "2 Places of 2 trials", "3 Settings"]
    assert '<li><a href="#places">Places of 2 trials</a></li>' in page
    body = re.search(r'<section aria-labelledby="places">(.*?)</section>', page, re.DOTALL)[1]
    text = " ".join(Document(body).text.split())
    assert "Said of <trials>." in text
    assert "Figure 1. Dots of α2. Data as CSV: places" in text
    assert "Table 2. Keys." in text
    assert "Table 3. Nothing to sort. fixed" in text
    assert all(row.planned.key in text for row in swept.rows)
    assert "There are places." not in text
    abstract = re.search(r'<section class="abstract"(.*?)</section>', page, re.DOTALL)[1]
    assert "<p>There are places.</p>" in abstract


def test_a_section_that_fails_says_so_in_its_place_and_costs_no_other(swept):
    @section_of(About.ALL_TRIALS, "broken", "A broken one")
    def broken(_):
        yield Paragraph(html("<p>Begun.</p>"))
        raise ZeroDivisionError("the <b>rows</b> have\nno middle")

    @section_of(About.THE_RUN, "wrong", "Wrong blocks")
    def wrong(_):
        yield "words"

    missing: list[str] = []
    page = build_report(swept, missing, (*RUN, broken, wrong))
    reason = "ZeroDivisionError: the <b>rows</b> have no middle"
    assert missing[0] == f"a section of the report could not be made: broken: {reason}"
    assert missing[1].startswith("a section of the report could not be made: wrong: TypeError: ")
    assert headings(page) == ["1 All figures", "2 A broken one", "3 Settings", "4 Wrong blocks"]
    text = Document(page).text
    assert f"This section could not be made: {reason}" in text
    assert "Begun." not in text
    assert "table-measures" in page


def test_a_panel_that_fails_leaves_its_section(swept):
    @section_of(About.THE_RUN, "half", "Half of it")
    def half(_):
        yield Figure("figure-half", [dot(0.0), dot(1.0)], html("Two panels."))

    missing: list[str] = []
    page = build_report(swept, missing, [half])
    reason = "ZeroDivisionError: float division by zero"
    assert missing == [f"a figure of the report could not be drawn: test_section.dot: {reason}"]
    assert "Two panels." in page
    assert len(list(Document(page).every("img"))) == 1


def test_a_section_of_the_program_that_fails_is_said_on_the_terminal(monkeypatch, tmp_path, capsys):
    def broken(*_):
        raise RuntimeError("no table")

    monkeypatch.setattr(measures, "all_measures", broken)
    monkeypatch.setattr(build, "SECTIONS", RUN)
    assert main(["run", str(toml(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert "omnirange: a section of the report could not be made: measures: RuntimeError: no table" in said
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "This section could not be made: RuntimeError: no table" in page
    assert 'id="settings"' in page


def test_ctrl_c_is_no_failure_of_a_section(swept, monkeypatch):
    @section_of(About.THE_RUN, "stopped", "Stopped")
    def stopped(_):
        raise KeyboardInterrupt
        yield

    with pytest.raises(KeyboardInterrupt):
        build_report(swept, sections=[stopped])

    @section_of(About.THE_RUN, "wrapped", "Stopped, told otherwise")
    def wrapped(_):
        raise RuntimeError("wrapped")
        yield

    def pending():
        raise KeyboardInterrupt

    monkeypatch.setattr(interrupts, "check", pending)
    with pytest.raises(KeyboardInterrupt):
        build_report(swept, sections=[wrapped])


def test_one_without_blocks_is_left_out_and_one_without_pixels_says_so(swept):
    context = Context.of(swept)
    assert failures.section(context) is None
    without = Context(swept, context.sweep, [], [], context.trial)
    for each in SECTIONS:
        if each.needs_pixels:
            made = each(without)
            assert isinstance(made, Section)
            assert "Not shown: this section needs the pixels" in made.blocks[0].html


def test_names_of_sections_are_their_own():
    names = [each.id for each in SECTIONS]
    assert len(set(names)) == len(names) > 20
