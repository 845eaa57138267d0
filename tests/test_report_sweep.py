"""The report of a sweep: true to the rows, honest about intervals, usable without a mouse."""

import base64
import csv
import dataclasses
import io
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from browser import chromium, visit
from markupsafe import Markup
from playwright.sync_api import BrowserContext
from repeats import few
from test_report import BOTH, SMALL, Document, run_small
from undrawn import undrawn

from harness.pipeline.row import row_of
from harness.report import opening, sweep, theme
from harness.report.build import build_report
from harness.report.section import About, Context, Figure, LineKey
from harness.report.sections import SECTIONS, error_curves, locking, measures, regional_errors
from harness.report.sweep import Axis, sweep_of, value_text
from harness.report.theme import Picture
from harness.report.typography import symbols
from harness.runs.experiment import Experiment
from harness.runs.run import Result, result_from, run_experiment
from harness.simulation.scene import load_scene
from harness.spec import parse

LAW_AXES: dict[str, Any] = {
    "seed": [1, 2, 3],
    "view_2.baseline_m": [0.25, 0.5, 1.0],
    "noise.sigma_grey": [0.0, 4.0],
    **BOTH,
}


def test_the_key_of_the_opening_figure_is_that_of_its_own_section():
    key, figure = LineKey(Picture(Markup(), 1, 1, "lines")), Figure("figure-a", (), "")
    other = Figure("figure-b", (), "")
    sections = [SimpleNamespace(blocks=[key, figure]), SimpleNamespace(blocks=[other])]
    assert opening._key_of(figure, sections) is key.picture
    assert opening._key_of(other, sections) is None


def test_no_two_methods_are_drawn_alike():
    """An author's own matchers stand beside those of the program: a dozen in one figure."""
    names = [f"matcher{i}" for i in range(9)]
    pairs = [("window", "none"), ("window", "parabola"), ("column", "v"), *((name, "own") for name in names)]
    trials = pd.DataFrame(pairs, columns=["matcher", "subpixel"])
    drawn = [(each.colour, str(each.stroke), each.marker, each.face) for each in sweep._method_styles(trials, {})]
    assert len(set(drawn)) == len(pairs)


def run_law(**changes: Any) -> Result:
    trial = {
        "scene": load_scene("box"),
        **SMALL,
        "placement": {"offset_m": 0.15, "random_yaw": True},
        "matching": {"kind": "column", "window_px": 7},
        **changes,
    }
    return run_experiment(parse(Experiment, {"name": "small-law", "law": True, "trial": trial, "axes": LAW_AXES}))


@pytest.fixture(scope="module")
def swept() -> Result:
    return run_law()


@pytest.fixture(scope="module")
def page(swept: Result) -> str:
    return build_report(swept)


@pytest.fixture(scope="module")
def page_file(page: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("sweep") / "report.html"
    file.write_text(page, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    """For all tests of the page: to start one takes longer than most of what is looked at."""
    with chromium(tmp_path_factory.mktemp("browser") / "profile") as context:
        yield context


@pytest.fixture(scope="module")
def paper_page(paper: Result) -> str:
    """For what it says: `test_report.py` has the page drawn."""
    with undrawn():
        return build_report(paper)


def downloads(html: str) -> dict[str, list[dict[str, str]]]:
    """The tables to download, by name."""
    prefix = "data:text/csv;charset=utf-8;base64,"
    rows = {}
    for link in Document(html).every("a"):
        if link.get("download"):
            assert link["href"].startswith(prefix)
            text = base64.b64decode(link["href"].removeprefix(prefix), validate=True).decode()
            rows[link["download"].removesuffix(".csv")] = list(csv.DictReader(io.StringIO(text)))
    return rows


# --- What is there ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_that_tests_the_law_has_all_sections(page):
    headings = re.findall(r'<h2 id="[a-z-]+">(\d+)\. ([^<]*)</h2>', page)
    assert [int(number) for number, _ in headings] == list(range(1, len(headings) + 1))
    assert [title for _, title in headings][:9] == [
        "The law of the range error, tested",
        "The law: geometry alone",
        "The law: images",
        "The law: decomposition",
        "The best baseline for each range",
        "Errors over every axis",
        "Pixel locking",
        "Errors by region",
        "All figures",
    ]
    assert len(page.encode()) < 5_000_000
    links = [link["href"].removeprefix("#") for link in Document(page).every("a") if link["href"].startswith("#")]
    places = {attributes.get("id") for _, attributes in Document(page).tags}
    assert set(links) <= places


@pytest.mark.slow
def test_the_papers_own_experiment_has_regions_figures_and_pixel_locking_but_no_test_of_the_law(paper_page):
    html = paper_page
    for section in ("sweeps", "locking", "regions", "measures"):
        assert f'<section aria-labelledby="{section}">' in html
    for section in ("verdict", "law-geometry", "law-images", "law-decomposition", "failures"):
        assert f'aria-labelledby="{section}"' not in html
    assert {"regions-base-trial", "measures", "pixel-locking", "sweep-range"} <= downloads(html).keys()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_law_is_tested_only_where_it_is_asked_for(swept):
    """The same rows without the key: no slopes and no sections, in a page that is a sweep's all the same."""
    plain = result_from(swept.experiment.model_copy(update={"law": False}), swept.rows)
    assert "law" not in plain.summary
    assert "law" in swept.summary
    assert plain.summary["headline"].startswith("Best of 6 settings: ")
    page = build_report(plain)
    assert 'aria-labelledby="sweeps"' in page
    for section in ("verdict", "law-geometry", "law-images", "law-decomposition"):
        assert f'aria-labelledby="{section}"' not in page


@pytest.mark.slow
def test_every_figure_and_table_is_numbered_once(page):
    for what in ("Figure", "Table"):
        result = [int(number) for number in re.findall(rf"<b>{what} (\d+)(?: \(paper [^<]*\))?\.</b>", page)]
        assert result == list(range(1, len(result) + 1))


@pytest.mark.slow
def test_every_figure_has_its_numbers(page):
    figures = re.findall(r'<figure id="figure-([a-z0-9-]+)">(.*?)</figure>', page, flags=re.DOTALL)
    assert len(figures) >= 15
    without = [name for name, body in figures if 'class="download"' not in body and "missing" not in body]
    assert without == ["regions"]  # the table below has them


@pytest.mark.long
@pytest.mark.slow
def test_same_rows_same_page(swept, page):
    assert build_report(swept) == page


# --- The numbers --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_slopes_in_the_page_are_the_summarys(swept, page):
    rows = downloads(page)["law-directions"]
    expected = [
        (fit["matcher"], fit["subpixel"], fit["surface"], fit["law"], each["slope"])
        for fit in swept.summary["law"]["images"]
        for each in fit["by_alpha_1"]
    ]
    assert len(rows) == len(expected)
    for row, (*names, slope) in zip(rows, expected, strict=True):
        assert [row[key] for key in ("matcher", "subpixel", "surface", "law")] == names
        assert row["slope"] == "" if slope is None else float(row["slope"]) == pytest.approx(slope, rel=1e-4)


@pytest.mark.slow
def test_verdict_in_the_page_is_the_summarys(swept, page):
    text = re.sub(r"\s+", " ", Document(page).text)
    for fit in swept.summary["law"]["images"]:
        if fit["law"] == "exact" and fit["slope"] is not None:
            low, high = (f"{end:.2f}".replace("-", "−") for end in fit["slope_ci95"])
            assert f"{fit['slope']:.2f} [{low}, {high}] on the exact law".replace("-", "−") in text


@pytest.mark.slow
def test_curves_over_an_axis_are_geometric_means_of_the_rows(swept, page):
    rows = downloads(page)["sweep-view-2-baseline-m"]
    values: dict[tuple[str, str], list[float]] = {}
    for row in swept.rows:
        place = (row.coordinates["matching.subpixel"], value_text(row.coordinates["view_2.baseline_m"]))
        values.setdefault(place, []).append(row.payload["figures"]["wall_range_median_abs_m"])
    chosen = [row for row in rows if (row["surface"], row["error"]) == ("wall", "range_m")]
    assert len(chosen) == len(values) == 6
    for row in chosen:
        expected = np.exp(np.mean(np.log(values[row["subpixel"], row["view_2.baseline_m"]])))
        assert float(row["median_abs"]) == pytest.approx(expected, rel=1e-4)
        assert float(row["ci95_low"]) <= float(row["median_abs"]) <= float(row["ci95_high"])


@pytest.mark.slow
def test_table_of_all_figures_is_the_mean_over_seeds(swept, page):
    rows = downloads(page)["measures"]
    assert len(rows) == 12
    for row in rows:
        same = [
            each.payload["figures"]
            for each in swept.rows
            if each.coordinates["matching.subpixel"] == row["subpixel"]
            and value_text(each.coordinates["view_2.baseline_m"]) == row["view_2.baseline_m"]
            and value_text(each.coordinates["noise.sigma_grey"]) == row["noise.sigma_grey"]
        ]
        assert int(row["seeds"]) == len(same) == 3
        for name in ("density", "bad_1px", "range_rmse_m", "solid_angle_range_median_abs_m"):
            assert float(row[name]) == pytest.approx(np.mean([figures[name] for figures in same]), rel=1e-4)


@pytest.mark.slow
def test_regions_of_the_base_trial_per_pixel_and_per_solid_angle_are_the_rows(paper, paper_page):
    rows = downloads(paper_page)["regions-base-trial"]
    result = {(row["method"], row["split"], row["part"]): row for row in rows}
    for outcome, method in zip(paper.outcomes, ("pixel", "subpixel"), strict=True):
        for region in row_of(outcome)["regions"]:
            part = region["part"]
            row = result[method, region["split"], part if "inf" not in part else "over 6 m"]
            assert float(row["range_median_abs_m"]) == pytest.approx(region["range_median_abs_m"], rel=1e-4)
        figures = row_of(outcome)["figures"]
        whole = result[method, "visibility", "visible in both views"]
        for name in ("density", "range_median_abs_m", "disparity_median_abs_px"):
            measured, expected = float(whole[f"{name}_solid_angle"]), figures[f"solid_angle_{name}"]
            assert measured == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_pixel_locking_shares_sum_to_one(page):
    shares: dict[tuple[str, str], float] = {}
    for row in downloads(page)["pixel-locking"]:
        assert row["subpixel"] == "parabola"
        shares[row["subpixel"], row["surface"]] = shares.get((row["subpixel"], row["surface"]), 0) + float(row["share"])
    assert list(shares.values()) == pytest.approx([1, 1], abs=1e-3)


# --- Rows alone, however many pixels ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_is_said_of_all_trials_needs_no_pixels(swept):
    bare = sweep_of(dataclasses.replace(swept, details=[]))
    context = Context(dataclasses.replace(swept, details=[]), bare, [], [], swept.outcomes[0].trial)
    with theme.style() as missing:
        assert error_curves.swept_figures(bare, 2.0)
        assert locking.histograms(bare)[0]
        assert regional_errors.over_trials(bare)[0]
        assert measures.all_measures(bare).rows
        made = {each.id: each(context) for each in SECTIONS if each.about is About.ALL_TRIALS}
    assert missing == []
    assert made["verdict"].abstract
    drawn = {block.id for section in made.values() if section for block in section.blocks if isinstance(block, Figure)}
    assert {"figure-law-geometry", "figure-law-images", "figure-law-sigma", "figure-locking"} <= drawn


@pytest.mark.slow
def test_rows_of_version_0_2_0_are_read(swept):
    """They say nothing of the lower edges of regions."""
    now = sweep_of(dataclasses.replace(swept, details=[]))
    before = [
        {**each, "regions": [{key: region[key] for key in region if key != "low"} for region in each["regions"]]}
        for each in now.payloads
    ]
    with theme.style():
        expected = regional_errors.over_trials(now)[1]
        assert regional_errors.over_trials(dataclasses.replace(now, payloads=before))[1].rows == expected.rows


@pytest.mark.slow
def test_the_numbers_to_download_do_not_grow_with_the_pixels(page, paper_page):
    small, large = downloads(page), downloads(paper_page)  # of 9,000 and of 144,000 pixels
    for name in ("panorama-blocks", "range-error-blocks", "error-distributions", "law-example-and-measured"):
        assert len(large[name]) <= max(len(small[name]), 20 * 72), name
    assert len(large["profile"]) == 720
    assert len(large["profiles-other-rows"]) <= 6 * 360


@pytest.mark.slow
def test_axes_know_whether_they_are_lines():
    assert Axis("noise.sigma_grey", [0, 1.0, 8]).numeric
    assert not Axis("noise.sigma_grey", [0, 1.0, 8]).logarithmic
    assert Axis("view_2.baseline_m", [0.1, 1.0]).logarithmic
    sizes = Axis("scene.objects.0.size_m", [[4.0, 4.0, 6.0], [8.0, 8.0, 6.0]])
    assert not sizes.numeric
    assert sizes.texts == ["4 × 4 × 6", "8 × 8 × 6"]


# --- What users write, and what fails -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_names_and_messages_show_as_text():
    evil = "<script>alert(1)</script>"
    scene = load_scene("box").model_copy(update={"name": evil})
    axes = {"view_2.baseline_m": [0.5, 5.0], "scene.description": [f"{evil} a", "b"], **BOTH}
    result = run_small(scene, axes=axes)
    html = build_report(result)
    document = Document(html)
    assert list(document.every("script")) == [{}]
    assert evil in document.text
    assert f"{evil} a" in document.text
    assert 'id="failures"' in html
    assert downloads(html)["failures"][0]["message"] in document.text


@pytest.mark.slow
def test_symbols_are_set_as_in_captions_and_nothing_else_becomes_html():
    assert str(symbols("σ(α₂) on |t|/d & d²/|t| <b>")) == (
        "σ(<i>α</i><sub>2</sub>) on |<b>t</b>|/<i>d</i> &amp; <i>d</i>²/|<b>t</b>| &lt;b&gt;"
    )
    assert str(symbols("noise/day, d²")) == "noise/day, d²"


# --- In a browser -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", few(1, [390, 1200]))
def test_sweep_in_chromium(page_file, browser, width):
    for scheme in ("light", "dark"):
        visited = visit(browser, page_file, width=width, scheme=scheme)
        assert visited.requests == []
        assert visited.complaints == []
        assert visited.page.evaluate("document.documentElement.scrollWidth") <= width
        sizes = visited.page.evaluate("[...document.images].map(image => [image.naturalWidth, image.clientWidth])")
        assert len(sizes) >= 35
        assert all(natural > 0 and shown > 100 for natural, shown in sizes)
        background = visited.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (background == "rgb(255, 255, 255)") == (scheme == "light")


@pytest.mark.slow
@pytest.mark.browser
def test_a_sheet_of_paper_holds_all_rows_and_no_column_is_cut(page_file, browser):
    page = visit(browser, page_file, width=1200).page
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 688, "height": 971})  # A4 without the margins of the style sheet
    tables = page.evaluate(
        "[...document.querySelectorAll('.table')].map(box => {"
        " const table = box.querySelector('table'), last = table.rows[table.rows.length - 1];"
        " return [table.scrollWidth, box.clientWidth, last.getBoundingClientRect().bottom,"
        " box.getBoundingClientRect().bottom, getComputedStyle(box).overflowY]; })"
    )
    assert len(tables) > 5
    for width, room, last, bottom, overflow in tables:
        assert width <= room
        assert last <= bottom + 1  # borders are shared between rows
        assert overflow == "visible"
    assert "columns are left out" in page.locator("#table-measures .paper").inner_text()


@pytest.mark.slow
@pytest.mark.browser
def test_tables_sort_by_keyboard(page_file, browser):
    page = visit(browser, page_file, width=1200).page
    table = page.locator("#table-measures table")
    heading = table.get_by_role("columnheader", name="Range, RMSE mm", exact=True).first
    column = heading.evaluate("cell => cell.cellIndex")

    def values() -> list[float]:
        return table.evaluate(f"table => [...table.tBodies[0].rows].map(row => +row.cells[{column}].dataset.sort)")

    before = values()
    heading.locator("button").focus()
    page.keyboard.press("Enter")
    assert heading.get_attribute("aria-sort") == "ascending"
    assert values() == sorted(before)
    page.keyboard.press("Space")
    assert heading.get_attribute("aria-sort") == "descending"
    assert values() == sorted(before, reverse=True)
    words = table.get_by_role("columnheader", name="Method", exact=True)
    words.locator("button").focus()
    page.keyboard.press("Enter")
    assert heading.get_attribute("aria-sort") is None
    assert table.locator("tbody th").all_inner_texts() == ["sub-pixel"] * 6 + ["whole pixels"] * 6


@pytest.mark.slow
@pytest.mark.browser
def test_the_first_stop_of_the_keyboard_leads_to_the_results(page_file, browser):
    page = visit(browser, page_file, width=390).page
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the results"
    page.keyboard.press("Enter")
    assert page.evaluate("location.hash") == "#main"
