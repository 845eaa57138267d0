"""The report: self-contained, true to the numbers, readable without scripts on a wide and on a narrow screen."""

import itertools
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from browser import chromium, visit
from repeats import few

from harness.evaluation.metric_table import METRICS
from harness.report import theme, typography, words
from harness.report.build import build_report
from harness.report.method_styles import methods_of
from harness.report.sections import error_maps, profiles
from harness.report.sections import matching_curve as curve
from harness.report.sections.law import example
from harness.runs.experiment import Experiment
from harness.runs.run import Result, run_experiment
from harness.simulation.scene import Scene, load_scene
from harness.spec import parse

SMALL: dict[str, Any] = {
    "sensor": {"camera": {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}},
    "panorama": {"width_px": 180, "height_px": 50},
    "render": {"samples": 4},
}
BOTH = {"matching.subpixel": ["none", "parabola"]}
MAX_BYTES = 3_000_000
"""The most that a page has without its explorer."""
MAX_BYTES_IN_ALL = 5_000_000


def run_small(
    scene: str | Scene = "box", axes: dict[str, Any] = BOTH, description: str = "", **settings: Any
) -> Result:
    table = {"scene": load_scene(scene) if isinstance(scene, str) else scene, **SMALL, **settings}
    experiment = {"name": "small", "description": description, "trial": table, "axes": axes}
    return run_experiment(parse(Experiment, experiment))


@pytest.fixture(scope="module")
def small() -> Result:
    return run_small()


@pytest.fixture(scope="module")
def report(paper: Result) -> str:
    return build_report(paper)


@pytest.fixture(scope="module")
def report_file(report: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report, encoding="utf-8")
    return path


class Document(HTMLParser):
    """Tags with their attributes, and the text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.style = ""
        self._inside = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag

    def handle_endtag(self, _: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.style += data
        else:
            self.text += data

    def every(self, name: str) -> Iterator[dict[str, str | None]]:
        return (attributes for tag, attributes in self.tags if tag == name)


# --- The file -----------------------------------------------------------------------------------------------------


def test_report_is_one_file_under_five_megabytes_three_without_its_explorer(report):
    assert len(report.encode()) < MAX_BYTES_IN_ALL
    rest, count = re.subn(r'<section aria-labelledby="explorer">.*?</section>', "", report, flags=re.DOTALL)
    assert count == 1
    assert len(rest.encode()) < MAX_BYTES


def test_nothing_is_loaded_from_elsewhere(report):
    document = Document(report)
    for tag, attributes in document.tags:
        for name in ("src", "href", "srcset", "poster", "data", "action", "xlink:href"):
            address = attributes.get(name)
            assert address is None or address.startswith(("#", "data:")), (tag, name, address[:80])
    assert "url(" not in document.style
    assert "@import" not in document.style


def test_figures_load_nothing_either(report):
    for image in Document(report).every("img"):
        for address in re.findall(r"(?:href|src)='([^']{0,60})|url\(([^)]{0,60})", image["src"]):
            assert "".join(address).startswith(("%23", "data:")), address


def test_the_one_script_is_inside_and_is_the_programs_own(report):
    document = Document(report)
    assert list(document.every("script")) == [{}]
    assert not [name for _, attributes in document.tags for name in attributes if name.startswith("on")]


def test_every_figure_has_a_text_for_those_who_do_not_see_it(report):
    images = list(Document(report).every("img"))
    assert len(images) >= 20
    texts = [image["alt"] for image in images]
    assert all(text and len(text) > 40 for text in texts)
    assert len(set(texts)) == len(texts)


def test_headings_are_in_order(report):
    levels = [int(tag[1]) for tag, _ in Document(report).tags if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


def test_contents_lead_somewhere(report):
    document = Document(report)
    places = {attributes.get("id") for _, attributes in document.tags}
    links = [link["href"] for link in document.every("a") if "download" not in link]
    assert len(links) >= 8
    assert all(link.removeprefix("#") in places for link in links)


def test_the_page_says_its_language_and_fits_small_screens(report):
    document = Document(report)
    assert next(document.every("html"))["lang"] == "en"
    assert any(meta.get("name") == "viewport" for meta in document.every("meta"))


@pytest.mark.long
@pytest.mark.slow
def test_same_result_same_report(small):
    page = build_report(small)
    assert build_report(small) == page
    assert build_report(small, may_copy=True) == page


@pytest.mark.slow
def test_drawing_leaves_matplotlib_settings_alone(small):
    before = dict(mpl.rcParams)
    build_report(small)
    assert dict(mpl.rcParams) == before


# --- The numbers --------------------------------------------------------------------------------------------------


def test_comparison_tables_are_the_summary(paper, report):
    cells = re.findall(r'<td data-measure="([a-z0-9_.]+)">([^<]*)</td>', report)
    columns = {name: METRICS[name] for name in words.COMPARED}
    expected = [
        (key, measures[key])
        for group in ("comparison_wall", "comparison")
        for measures in paper.summary[group].values()
        for key in columns
    ]
    assert [key for key, _ in cells] == [key for key, _ in expected]
    for (key, text), (_, value) in zip(cells, expected, strict=True):
        column = columns[key]
        half_a_digit = 0.5 * 10.0 ** -int(column.form[-2])
        assert float(text.replace("−", "-")) == pytest.approx(column.scale * value, abs=1.001 * half_a_digit)


def test_abstract_says_what_the_summary_says(paper, report):
    walls = paper.summary["comparison_wall"]
    before, after = (1000 * walls[method]["range_median_abs_m"] for method in ("pixel", "subpixel"))
    density = 100 * walls["pixel"]["density"]
    change = f"lowers the median range error from {before:.0f}\u00a0mm to {after:.0f}\u00a0mm"
    assert f"On wall pixels the sub-pixel step {change}" in report
    assert f"at a density of {density:.1f}\u00a0%" in report


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        (0.061, 0.034, "lowers the error from 61\u00a0mm to 34\u00a0mm"),
        (0.034, 0.061, "raises the error from 34\u00a0mm to 61\u00a0mm"),
        (0.0341, 0.0339, "leaves the error at 34\u00a0mm"),
    ],
)
def test_abstract_follows_the_numbers(before, after, expected):
    assert words._changes({"m": before}, {"m": after}, "m", 1000, ".0f", "the error", "mm") == expected


def test_a_number_that_rounds_to_zero_has_no_sign():
    assert typography.figure(-0.04, "+.1f") == "0.0"
    assert typography.figure(-0.06, "+.1f") == "−0.1"
    assert typography.figure(0.06, "+.1f") == "+0.1"


def test_worked_example_of_the_law():
    result = [(each.alpha_1_deg, round(each.exact_m, 3), round(each.short_m, 3)) for each in example.worked_example()]
    assert result == [(90, 0.323, 0.314), (30, 0.464, 0.314), (15, 0.857, 0.314)]


def test_pixel_level_errors_lie_within_what_the_law_allows_for_whole_steps(paper):
    within = example.within_steps(methods_of(paper.outcomes)[0].outcome, "whole pixels")
    assert within.shares[0] > 0.85
    assert within.shares[-1] > 0.99


def test_cost_curve_is_the_matchers(paper):
    methods = methods_of(paper.outcomes)
    row, column = curve.typical_pixel(methods)
    result = curve.curve_at(methods[0].outcome, row, column)
    best = np.nanargmin(result.costs)
    assert result.angle_deg[best] == pytest.approx(result.best_deg)
    assert result.near.sum() == 7
    from harness.matching.window.match import whole_pixels

    # The parabola is the one that the sub-pixel step used: its minimum is the estimate.
    refined = methods[1].outcome
    assert refined.matches.refined[row, column]
    offset = (result.minimum_deg - result.best_deg) / result.step_deg
    whole = whole_pixels(refined.pair, refined.trial.matching)
    assert refined.matches.k[row, column] - whole.k[row, column] == pytest.approx(offset, abs=1e-9)
    assert -result.fit[1] / (2 * result.fit[0]) == pytest.approx(offset, abs=1e-6)


def test_pixel_level_estimates_lie_on_the_levels_that_are_drawn(paper):
    outcome = methods_of(paper.outcomes)[0].outcome
    row = profiles.main_row(methods_of(paper.outcomes))
    phi, levels = profiles._levels(outcome, row, (0.0, 20.0))
    at = np.degrees(outcome.trial.panorama.phi)
    checked = 0
    for column in range(0, at.size, 2):
        if outcome.reference.domain[row, column] and outcome.valid[row, column]:
            here = levels[phi == at[column]]
            assert np.nanmin(np.abs(here - outcome.range_m[row, column])) < 1e-9
            checked += 1
    assert checked > 100


def test_other_rows_show_walls_and_floor(paper):
    methods = methods_of(paper.outcomes)
    surfaces = [profiles.row_at(methods, row).surface for row in profiles.other_rows(methods)]
    assert surfaces == ["wall"] * 3 + ["floor or ceiling"] * 3


def test_every_reason_has_words_and_a_colour_of_its_own():
    from harness.matching.window.match import Reason

    assert set(error_maps.REASONS) == set(Reason)
    assert len({colour for _, colour in error_maps.REASONS.values()}) == len(Reason)


# --- Other experiments than the paper's ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_users_write_shows_as_text():
    evil = '<script>alert(1)</script> & "quotes" {{ 7 * 7 }}'
    scene = load_scene("box").model_copy(update={"name": evil, "description": evil})
    html = build_report(run_small(scene, description=evil))
    document = Document(html)
    assert list(document.every("script")) == [{}]
    assert document.text.count(evil) >= 3
    assert any(evil in image["alt"] for image in document.every("img"))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("one method, without axes", {"axes": {}}),
        ("only whole pixels", {"axes": {}, "matching": {"subpixel": "none"}}),
        ("several baselines", {"axes": {"view_2.baseline_m": [0.3, 0.5], **BOTH}}),
        ("several widths", {"axes": {**BOTH, "panorama.width_px": [180, 240]}}),
        ("a view outside the scene", {"axes": {"view_2.baseline_m": [0.5, 5.0], **BOTH}}),
        ("sampled in alpha", {"matching": {"sampling": "alpha"}}),
        ("corridor", {"scene": "corridor"}),
        ("room", {"scene": "room"}),
        ("straight up", {"view_2": {"elevation_deg": 90.0}, "matching": {"sampling": "alpha"}}),
        ("turned and noisy", {"view_2": {"yaw_deg": 30.0, "azimuth_deg": 40.0}, "noise": {"sigma_grey": 2.0}}),
        ("nothing matched", {"matching": {"window_px": 99}}),
        ("unfiltered single pixels", {"filter": {"log_sigma_px": 0.0}, "matching": {"window_px": 1, "cost": "ssd"}}),
    ],
)
def test_any_experiment_has_a_report(name, settings):
    html = build_report(run_small(**settings))
    assert len(html.encode()) < MAX_BYTES
    assert "nan" not in re.findall(r"[a-z]+", Document(html).text)
    if name == "nothing matched":
        assert "nothing was matched." in html
        assert 'class="missing"' in html
    if name == "a view outside the scene":
        assert 'id="failures"' in html
        assert "2 of 4 trials are missing, 2 of them failed" in html


def test_panels_without_data_say_so():
    methods = methods_of(run_small(matching={"window_px": 99}).outcomes)
    assert curve.typical_pixel(methods) is None
    with theme.style():
        assert "no estimate" in example.measured_chart(methods).alt


# --- In a browser -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", few(1, [390, 1200]))
def test_report_in_chromium(report_file, tmp_path, width):
    with chromium(tmp_path / "profile") as browser:
        visited = visit(browser, report_file, width=width)
        page = visited.page
        assert visited.requests == []
        assert visited.complaints == []
        assert page.evaluate("document.documentElement.scrollWidth") <= page.evaluate("window.innerWidth")
        sizes = page.evaluate("[...document.images].map(image => [image.naturalWidth, image.clientWidth])")
        assert len(sizes) >= 20
        assert all(natural > 0 and shown > 100 for natural, shown in sizes)


@pytest.mark.slow
@pytest.mark.browser
def test_report_without_scripts(report_file, tmp_path):
    with chromium(tmp_path / "profile", scripts=False) as browser:
        visited = visit(browser, report_file, width=1200)
        assert visited.complaints == []
        assert visited.page.locator("figure img").count() >= 20
        assert visited.page.locator("figure img").last.is_visible()
        assert visited.page.get_by_text("Comparison of methods").last.is_visible()


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.usefixtures("undrawn")
def test_text_that_users_write_runs_nowhere(tmp_path):
    file = tmp_path / "report.html"
    file.write_text(build_report(run_small(description="<img src=x onerror=alert(1)><b>bold</b>")), encoding="utf-8")
    with chromium(tmp_path / "profile") as browser:
        visited = visit(browser, file, width=390)
        assert visited.requests == []
        assert visited.complaints == []
        assert visited.page.locator("header .lead").inner_text().endswith("<img src=x onerror=alert(1)><b>bold</b>")
        assert visited.page.evaluate("document.documentElement.scrollWidth") <= 390
