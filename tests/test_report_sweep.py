"""The report of a sweep, and runs side by side: true to the rows, honest about intervals, usable without a mouse."""

import base64
import csv
import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from browser import chromium, visit
from sweeps import write_small
from test_report import BOTH, SMALL, Document, run_small

from harness.cli import main
from harness.errors import InputError
from harness.evaluation.metric_table import metric
from harness.evaluation.statistics import balanced, mean_over_seeds, median_over_seeds, weighted_median
from harness.report import theme
from harness.report.build import build_report
from harness.report.paired_differences import COMPARED, build_comparison
from harness.report.section import About, Context, Figure
from harness.report.sections import SECTIONS, error_curves, locking, measures, regional_errors
from harness.report.sweep import Axis, sweep_of, value_text
from harness.report.words import symbols
from harness.runs.experiment import Experiment
from harness.runs.run import Result, run_experiment
from harness.simulation.scene import load_scene
from harness.spec import parse

LAW_AXES: dict[str, Any] = {
    "seed": [1, 2, 3],
    "view_2.baseline_m": [0.25, 0.5, 1.0],
    "noise.sigma_grey": [0.0, 4.0],
    **BOTH,
}


def run_law(**changes: Any) -> Result:
    trial = {
        "scene": load_scene("box"),
        **SMALL,
        "placement": {"offset_m": 0.15, "random_yaw": True},
        "matching": {"kind": "column", "window_px": 7},
        **changes,
    }
    return run_experiment(parse(Experiment, {"name": "small-law", "trial": trial, "axes": LAW_AXES}))


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
def paper_page(paper: Result) -> str:
    return build_report(paper)


def downloads(html: str) -> dict[str, list[dict[str, str]]]:
    """The tables to download, by name."""
    prefix = "data:text/csv;charset=utf-8;base64,"
    found = {}
    for link in Document(html).every("a"):
        if link.get("download"):
            assert link["href"].startswith(prefix)
            text = base64.b64decode(link["href"].removeprefix(prefix), validate=True).decode()
            found[link["download"].removesuffix(".csv")] = list(csv.DictReader(io.StringIO(text)))
    return found


# --- What is there ------------------------------------------------------------------------------------------------


def test_a_sweep_that_tests_the_law_has_all_sections(page):
    headings = re.findall(r'<h2 id="[a-z-]+">(\d+)\. ([^<]*)</h2>', page)
    assert [int(number) for number, _ in headings] == list(range(1, len(headings) + 1))
    assert [title for _, title in headings][:8] == [
        "The law of the range error, tested",
        "The law: geometry alone",
        "The law: images",
        "The law: decomposition",
        "Errors over every axis",
        "Pixel locking",
        "Errors by region",
        "All figures",
    ]
    assert len(page.encode()) < 5_000_000
    links = [link["href"].removeprefix("#") for link in Document(page).every("a") if link["href"].startswith("#")]
    places = {attributes.get("id") for _, attributes in Document(page).tags}
    assert set(links) <= places


def test_the_papers_own_experiment_has_regions_figures_and_pixel_locking_but_no_test_of_the_law(paper_page):
    html = paper_page
    for section in ("sweeps", "locking", "regions", "measures"):
        assert f'<section aria-labelledby="{section}">' in html
    for section in ("verdict", "law-geometry", "law-images", "law-decomposition", "failures"):
        assert f'aria-labelledby="{section}"' not in html
    assert {"regions-base-trial", "measures", "pixel-locking", "sweep-range"} <= downloads(html).keys()


def test_every_figure_and_table_is_numbered_once(page):
    for what in ("Figure", "Table"):
        found = [int(number) for number in re.findall(rf"<b>{what} (\d+)\.</b>", page)]
        assert found == list(range(1, len(found) + 1))


def test_every_figure_has_its_numbers(page):
    figures = re.findall(r'<figure id="figure-([a-z0-9-]+)">(.*?)</figure>', page, flags=re.DOTALL)
    assert len(figures) >= 15
    without = [name for name, body in figures if 'class="download"' not in body and "missing" not in body]
    assert without == ["regions"]  # the table below has them


@pytest.mark.slow
def test_same_rows_same_page(swept, page):
    assert build_report(swept) == page


# --- The numbers --------------------------------------------------------------------------------------------------


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


def test_verdict_in_the_page_is_the_summarys(swept, page):
    text = re.sub(r"\s+", " ", Document(page).text)
    for fit in swept.summary["law"]["images"]:
        if fit["law"] == "exact" and fit["slope"] is not None:
            low, high = (f"{end:.2f}".replace("-", "−") for end in fit["slope_ci95"])
            assert f"{fit['slope']:.2f} [{low}, {high}] on the exact law".replace("-", "−") in text


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


def test_regions_of_the_base_trial_per_pixel_and_per_solid_angle_are_the_rows(paper, paper_page):
    rows = downloads(paper_page)["regions-base-trial"]
    found = {(row["method"], row["split"], row["part"]): row for row in rows}
    for outcome, method in zip(paper.rows, ("pixel", "subpixel"), strict=True):
        for region in outcome.payload["regions"]:
            part = region["part"]
            row = found[method, region["split"], part if "inf" not in part else "over 6 m"]
            assert float(row["range_median_abs_m"]) == pytest.approx(region["range_median_abs_m"], rel=1e-4)
        figures = outcome.payload["figures"]
        whole = found[method, "visibility", "visible in both views"]
        for name in ("density", "range_median_abs_m", "disparity_median_abs_px"):
            measured, expected = float(whole[f"{name}_solid_angle"]), figures[f"solid_angle_{name}"]
            assert measured == pytest.approx(expected, rel=1e-3)


def test_pixel_locking_shares_sum_to_one(page):
    shares: dict[tuple[str, str], float] = {}
    for row in downloads(page)["pixel-locking"]:
        assert row["subpixel"] == "parabola"
        shares[row["subpixel"], row["surface"]] = shares.get((row["subpixel"], row["surface"]), 0) + float(row["share"])
    assert list(shares.values()) == pytest.approx([1, 1], abs=1e-3)


# --- Rows alone, however many pixels ------------------------------------------------------------------------------


@pytest.mark.slow
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


def test_the_numbers_to_download_do_not_grow_with_the_pixels(page, paper_page):
    small, large = downloads(page), downloads(paper_page)  # of 9,000 and of 144,000 pixels
    for name in ("panorama-blocks", "range-error-blocks", "error-distributions", "law-example-and-measured"):
        assert len(large[name]) <= max(len(small[name]), 20 * 72), name
    assert len(large["profile"]) == 720
    assert len(large["profiles-other-rows"]) <= 6 * 360


# --- Statistics ---------------------------------------------------------------------------------------------------


def frame(values: list[list[float]], seeds: list[int]) -> pd.DataFrame:
    index = pd.MultiIndex.from_arrays([seeds, range(len(seeds))], names=["seed", "place"])
    return pd.DataFrame(values, index=index, columns=["a", "b"])


def test_means_over_seeds_and_their_intervals():
    curve = mean_over_seeds(frame([[1, 4], [3, np.nan], [5, 8]], [1, 1, 2]))
    np.testing.assert_allclose(curve.mean, [3, 6])
    np.testing.assert_allclose([curve.low, curve.high], [[2, 4], [5, 8]])


def test_one_seed_has_no_interval():
    curve = mean_over_seeds(frame([[1, 4], [3, 4]], [7, 7]), logarithmic=True)
    np.testing.assert_allclose(curve.mean, [np.sqrt(3), 4])
    assert np.isnan([curve.low, curve.high]).all()


def test_intervals_of_means_cover_the_truth_about_as_often_as_they_say():
    generator = np.random.default_rng(5)
    hits = 0
    for _ in range(200):
        values = generator.standard_normal((12, 1)).repeat(2, axis=1)
        curve = mean_over_seeds(frame(values.tolist(), list(range(12))))
        hits += curve.low[0] <= 0 <= curve.high[0]
    assert 0.86 <= hits / 200 <= 0.98  # a percentile bootstrap of 12 covers somewhat less than 95 %


def test_medians():
    values = np.array([3.0, 1.0, 2.0, 10.0, 4.0])
    median, low, high = median_over_seeds(values, np.array([1, 2, 3, 4, 5]))
    assert median == 3
    assert 1 <= low <= median <= high <= 10
    assert weighted_median(values, np.ones(5)) == 3
    assert weighted_median(values, np.array([0, 0, 0, 1.0, 0])) == 10


def test_places_without_a_value_somewhere_are_left_out_where_others_remain():
    table = frame([[1, 2], [3, np.nan], [5, 6]], [1, 2, 3])
    assert balanced(table)["a"].tolist() == [1, 5]
    nothing = frame([[1, np.nan], [np.nan, 2]], [1, 2])
    assert balanced(nothing) is nothing


def test_axes_know_whether_they_are_lines():
    assert Axis("noise.sigma_grey", [0, 1.0, 8]).numeric
    assert not Axis("noise.sigma_grey", [0, 1.0, 8]).logarithmic
    assert Axis("view_2.baseline_m", [0.1, 1.0]).logarithmic
    sizes = Axis("scene.objects.0.size_m", [[4.0, 4.0, 6.0], [8.0, 8.0, 6.0]])
    assert not sizes.numeric
    assert sizes.texts == ["4 × 4 × 6", "8 × 8 × 6"]


# --- What users write, and what fails -----------------------------------------------------------------------------


@pytest.mark.slow
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


def test_symbols_are_set_as_in_captions_and_nothing_else_becomes_html():
    assert str(symbols("σ(α₂) on |t|/d & d²/|t| <b>")) == (
        "σ(<i>α</i><sub>2</sub>) on |<b>t</b>|/<i>d</i> &amp; <i>d</i>²/|<b>t</b>| &lt;b&gt;"
    )
    assert str(symbols("noise/day, d²")) == "noise/day, d²"


# --- In a browser -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", [1200, 390])
def test_sweep_in_chromium(page_file, tmp_path, width):
    with chromium(tmp_path / "profile") as browser:
        for scheme in ("light", "dark"):
            seen = visit(browser, page_file, width=width, scheme=scheme)
            assert seen.requests == []
            assert seen.complaints == []
            assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
            sizes = seen.page.evaluate("[...document.images].map(image => [image.naturalWidth, image.clientWidth])")
            assert len(sizes) >= 35
            assert all(natural > 0 and shown > 100 for natural, shown in sizes)
            background = seen.page.evaluate("getComputedStyle(document.body).backgroundColor")
            assert (background == "rgb(255, 255, 255)") == (scheme == "light")


@pytest.mark.browser
def test_a_sheet_of_paper_holds_all_rows_and_no_column_is_cut(page_file, tmp_path):
    with chromium(tmp_path / "profile") as browser:
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
def test_tables_sort_by_keyboard(page_file, tmp_path):
    with chromium(tmp_path / "profile") as browser:
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
        assert table.locator("tbody th").all_inner_texts() == ["whole pixels"] * 6 + ["sub-pixel"] * 6


@pytest.mark.browser
def test_the_first_stop_of_the_keyboard_leads_to_the_results(page_file, tmp_path):
    with chromium(tmp_path / "profile") as browser:
        page = visit(browser, page_file, width=390).page
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.textContent") == "Skip to the results"
        page.keyboard.press("Enter")
        assert page.evaluate("location.hash") == "#main"


# --- Runs side by side --------------------------------------------------------------------------------------------

REST = """
[trial.placement]
offset_m = 0.15
random_yaw = true

[axes]
"seed" = [1, 2, 3]
"matching.subpixel" = ["none", "parabola"]
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    file = write_small(folder / "small.toml", REST)
    changes = {
        "window": [],
        "again": [],
        "column": ["--set", "matching.kind=column"],
        "baselines": ["--axis", "view_2.baseline_m=0.3,0.4"],
        "noises": ["--set", "noise.sigma_grey=4", "--axis", "seed=1,2"],
    }
    for name, options in changes.items():
        assert main(["run", str(file), "--out", str(folder / name), "--no-report", *options]) == 0
    return {name: folder / name for name in changes}


def figures_of(folder: Path, name: str) -> dict[tuple[str, str], float]:
    with (folder / "trials.csv").open(encoding="utf-8", newline="") as stream:
        return {(row["seed"], row["matching.subpixel"]): float(row[name]) for row in csv.DictReader(stream)}


def test_paired_differences_are_those_of_the_trials(runs):
    comparison = build_comparison(runs["window"], runs["column"])
    [pairing] = comparison.pairings
    assert pairing.differing == {"matching.kind": ("window", "column")}
    assert (pairing.pairs, pairing.seeds, pairing.why_none) == (6, 3, "")
    assert len(pairing.differences) == 2 * len(COMPARED)
    for each in pairing.differences:
        first, second = (figures_of(runs[name], each.figure) for name in ("window", "column"))
        off = [second[place] - first[place] for place in first if place[1] == each.step]
        assert each.difference == pytest.approx(np.mean(off))
        low, high = each.between
        assert min(off) - 1e-12 <= low <= each.difference <= high <= max(off) + 1e-12


def test_the_same_run_again_is_the_same(runs):
    [pairing] = build_comparison(runs["window"], runs["again"]).pairings
    assert not pairing.differing
    assert {each.verdict for each in pairing.differences} == {"the same"}


def test_trials_without_a_partner_are_left_out(runs):
    [pairing] = build_comparison(runs["window"], runs["noises"]).pairings
    assert list(pairing.differing) == ["noise.sigma_grey"]
    assert (pairing.pairs, pairing.seeds) == (4, 2)


def test_what_cannot_be_paired_is_said(runs):
    comparison = build_comparison(runs["window"], runs["baselines"])
    [pairing] = comparison.pairings
    assert pairing.pairs == 0
    assert "Nothing can be paired: baseline |t| (m) varies" in pairing.why_none
    assert pairing.why_none in Document(comparison.html).text
    assert not list(comparison.lines())


def test_folders_that_hold_no_run_are_named(runs, tmp_path):
    with pytest.raises(InputError, match=r"there is no experiment\.toml"):
        build_comparison(runs["window"], tmp_path)
    with pytest.raises(InputError, match="given twice"):
        build_comparison(runs["window"], runs["window"])
    with pytest.raises(InputError, match="at least two"):
        build_comparison(runs["window"])


def test_compare_on_the_command_line(runs, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["compare", str(runs["window"]), str(runs["column"]), str(runs["baselines"]), "--out", str(page)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "column against window: 6 pairs, 3 seeds; matching.kind: window -> column" in said
    assert "Nothing can be paired" in said
    assert "<!DOCTYPE html>" in page.read_text(encoding="utf-8")
    assert main(["compare", str(runs["window"])]) == 2


def test_compare_fits_a_terminal_of_80_columns(runs, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["compare", str(runs["window"]), str(runs["column"]), "--out", str(tmp_path / "page.html")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line.rstrip()) for line in lines if str(tmp_path) not in line) <= 80
    names = [metric(name).short.replace("\u00a0", " ") for name in COMPARED]
    rows = [line for line in lines if line.strip().startswith(tuple(names))]
    assert len(rows) == 2 * len(names)  # at whole pixels and with the sub-pixel step
    assert all(row.rstrip().endswith(("better", "worse", "not told apart", "the same")) for row in rows)


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", [1200, 390])
def test_comparison_in_chromium(runs, tmp_path, width):
    file = tmp_path / "comparison.html"
    file.write_text(build_comparison(runs["window"], runs["column"], runs["baselines"]).html, encoding="utf-8")
    with chromium(tmp_path / "profile") as browser:
        seen = visit(browser, file, width=width)
        assert (seen.requests, seen.complaints) == ([], [])
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
        assert seen.page.locator("figure img").count() == 1
