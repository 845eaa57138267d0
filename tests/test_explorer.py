"""The explorer: what the page shows of a pixel is what the arrays hold, by pointer, by keys, and without scripts."""

import json
import re
import zlib
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, visit
from hypothesis import given, settings
from hypothesis import strategies as st
from playwright.sync_api import sync_playwright
from test_report import run_small

from harness.camera.plane_images import plane_conic
from harness.camera.sensor import Sensor, pixel_directions, project
from harness.geometry.panorama import directions
from harness.matching.interface import Reason
from harness.matching.window.match import costs_along_curve, whole_pixels
from harness.pipeline.maps import maps_of
from harness.report import build
from harness.report.build import build_report
from harness.report.explorer import contents
from harness.report.explorer.arrays import in_steps, on_scale, pack
from harness.report.explorer.contents import contents_of, cost_matcher, own_cost, range_step, step_of_method
from harness.report.explorer.projection import projection_table
from harness.report.method_styles import methods_of
from harness.report.section import Context
from harness.report.sections import comparison, error_maps, explorer, measures
from harness.spec import parse

# --- Packed maps --------------------------------------------------------------------------------------------------


def read(packed):
    """What is in a packed map: another way than the page's, with whole arrays and 64 bits."""
    data = np.frombuffer(zlib.decompress(b64decode(packed.text)), np.uint8)
    planes = data.reshape(packed.planes, packed.rows, packed.columns).astype(np.int64)
    counted = sum(plane << (8 * i) for i, plane in enumerate(planes))
    steps = np.where(counted % 2, -(counted + 1) // 2, counted // 2)
    return (np.cumsum(np.cumsum(steps, axis=1), axis=0) + 2**31) % 2**32 - 2**31


@given(st.integers(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_packed_maps_are_read_back(bits, seed):
    values = np.random.default_rng(seed).integers(-(2**bits), 2**bits, (3, 7), endpoint=True)
    packed = pack(values)
    assert (read(packed) == values).all()
    assert packed.planes <= (bits + 3) // 8 + 1  # a difference of differences is four times as large, with its sign


def test_ranges_beyond_the_numbers_are_cut_off():
    assert read(pack([[1e12, -1e12]])).tolist() == [[2**30, -(2**30)]]


def test_steps_round_and_what_is_missing_takes_no_space():
    values = np.array([[np.nan, 1.26, np.nan, np.inf, 1.24]])
    assert in_steps(values, 0.1).tolist() == [[0, 13, 13, 13, 12]]
    assert on_scale(np.array([1e-6, 2e-6, 1e-9, np.nan]), 1e-6, 32).tolist() == [1, 33, 1, 0]


@pytest.mark.parametrize(("usual", "step"), [(3.0, 1e-5), (30.0, 1e-4), (0.99, 1e-6)])
def test_ranges_are_rounded_to_a_hundred_thousandth_of_the_usual_one_or_less(usual, step):
    assert range_step(np.array([usual, np.nan])) == pytest.approx(step)


# --- Projection tables --------------------------------------------------------------------------------------------

_SMALL = {"width_px": 160, "height_px": 120, "cx_px": 79.5, "cy_px": 59.5}
SENSORS = {
    "mirror": {"camera": _SMALL | {"focal_px": 153.53}},
    "tilted mirror": {"camera": _SMALL | {"focal_px": 153.53}, "mount": {"pitch_deg": 10, "yaw_deg": 30}},
    "lens": {"model": {"kind": "unified", "xi": 1.2}, "lens": {"k1": -0.05}, "camera": _SMALL | {"focal_px": 60}},
    "fisheye": {"model": {"kind": "kannala_brandt", "k1": 0.01}, "camera": _SMALL | {"focal_px": 38}},
    "panorama": {
        "model": {"kind": "equirectangular"},
        "camera": {"width_px": 160, "height_px": 80, "focal_px": 25.4647909, "cx_px": 79.5, "cy_px": 39.5},
        "mount": {"pitch_deg": 20, "roll_deg": 10},
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SENSORS)
def test_interpolated_pixels_are_those_of_the_sensor(name):
    sensor = parse(Sensor, SENSORS[name])
    rays, valid = pixel_directions(sensor)
    expected = project(sensor, rays[valid])[0]
    error = np.linalg.norm(projection_table(sensor).project(rays[valid]) - expected, axis=-1)
    assert error.max() < 0.05  # what the table promises


# --- In a browser: the numbers ------------------------------------------------------------------------------------

RUNS = {
    "squares, two methods": {},
    "columns, turned": {
        "axes": {},
        "matching": {"kind": "column", "cost": "zncc"},
        "view_2": {"yaw_deg": 30.0, "azimuth_deg": 40.0, "elevation_deg": 10.0},
    },
    "in alpha, another camera for view 2": {
        "axes": {},
        "matching": {"sampling": "alpha", "cost": "ssd"},
        "sensor_2": SENSORS["lens"] | {"mount": {"looks": "down"}},
    },
}


COARSE = "columns, turned"
"""A run that is shown as if there were little room: every second pixel of the panorama."""


@pytest.fixture(scope="module")
def driver():
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(driver, tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("explorer") / "profile", driver=driver) as opened:
        yield opened


class Shown:
    """A run, its explorer in a page, and what the page says of pixels."""

    def __init__(self, result, browser, file: Path) -> None:
        self.methods = methods_of(result.outcomes, result.experiment.planned)
        file.write_text(build_report(result, None, [comparison.section, explorer.section]), encoding="utf-8")
        self.file = file
        self.visited = visit(browser, file, width=1200)
        self.page = self.visited.page
        self.page.evaluate("document.getElementById('explorer-app').scrollIntoView()")
        self.page.wait_for_selector(".explorer.ready")
        self.explorer = self.page.evaluate_handle("document.getElementById('explorer-app').explorer")
        self.every = self.explorer.evaluate("(explorer) => explorer.facts.every")
        self.part = 0.001 if self.every == 1 else 0.01  # the step of a method's ranges in parts of its usual error

    def at(self, pixels):
        """What the page knows of some pixels; None where there is no number."""
        text = "([pixels, explorer]) => JSON.stringify(pixels.map((each) => explorer.at(...each)))"
        return json.loads(self.page.evaluate(text, [pixels, self.explorer]))

    def text(self, part):
        return self.page.locator(f"[data-part={part}]").inner_text()

    def pixel(self):
        return [int(each) for each in re.findall(r"\d+", self.text("pixel"))]

    def place(self, picture, x, y):
        """Window coordinates of a place in a picture, given in its own pixels from the upper left corner."""
        svg = self.page.locator(f"[data-picture={picture}] svg")
        svg.scroll_into_view_if_needed()
        box, (_, _, width, height) = svg.bounding_box(), svg.get_attribute("viewBox").split()
        return box["x"] + x / float(width) * box["width"], box["y"] + y / float(height) * box["height"]


@pytest.fixture(scope="module", params=RUNS)
def shown(request, browser, tmp_path_factory):
    result = run_small(**RUNS[request.param])
    with pytest.MonkeyPatch.context() as patch:
        if request.param == COARSE:
            patch.setattr(contents, "_QUALITIES", contents._QUALITIES[-1:])
        return Shown(result, browser, tmp_path_factory.mktemp("report") / "report.html")


def some_pixels(outcome, count=60):
    """Pixels of every kind: with a match, with none for each reason, occluded."""
    chance = np.random.default_rng(1)
    kinds = [outcome.reason == reason for reason in Reason] + [
        np.isfinite(outcome.truth.range_m) & ~outcome.truth.visible
    ]
    found = [np.argwhere(kind) for kind in kinds if kind.any()]
    return np.concatenate([chance.permutation(each)[:count] for each in found]).tolist()


def multiples(where, every):
    """Pixels of a mask in every so many rows and columns."""
    return (every * np.argwhere(where[::every, ::every])).tolist()


def number(value):
    return np.nan if value is None else value


@pytest.mark.slow
@pytest.mark.browser
def test_numbers_of_a_pixel_are_those_of_the_arrays(shown):
    outcome = shown.methods[0].outcome
    arrays = [(maps_of(method.outcome), method.outcome.errors) for method in shown.methods]
    pixels = np.unique(np.array(some_pixels(outcome)) // shown.every * shown.every, axis=0).tolist()
    step = range_step(outcome.truth.range_m)
    for (row, column), said in zip(pixels, shown.at(pixels), strict=True):
        assert [said["row"], said["column"]] == [row, column]
        true_m = outcome.truth.range_m[row, column]
        assert number(said["trueRange"]) == pytest.approx(true_m, abs=0.501 * step, nan_ok=True)
        for (maps, errors), its in zip(arrays, said["methods"], strict=True):
            assert its["reason"] == maps.reason[row, column]
            own = step_of_method(maps, step, shown.part)
            assert own <= max(step, shown.part * np.nanmedian(np.abs(maps.range_error_m)))
            assert number(its["range"]) == pytest.approx(maps.range_m[row, column], abs=0.501 * own, nan_ok=True)
            # Half a step each of estimate and truth.
            apart = 0.501 * (own + step)
            assert number(its["error"]) == pytest.approx(maps.range_error_m[row, column], abs=apart, nan_ok=True)
            # Half a step of a scale of 16 in a factor of two is 2.19 %.
            assert number(its["sigma"]) == pytest.approx(maps.sigma_range_m[row, column], rel=0.022, nan_ok=True)
            if its["range"] is not None:
                # To first order; ranges here are some thousand steps.
                alike = apart * per_metre(said, min(its["range"], number(true_m))) / maps.grid.phi_pitch
                expected = errors.disparity_px[row, column]
                assert number(its["disparity"]) == pytest.approx(expected, abs=1.01 * alike, nan_ok=True)


def per_metre(said, range_m, baseline_m=0.5):
    """How much alpha_2 changes with the range, radians per metre: |t| sin(alpha_1)/d_2²."""
    c, s = np.cos(said["alpha1"]), np.sin(said["alpha1"])
    return baseline_m * s / (range_m**2 + baseline_m**2 - 2 * range_m * baseline_m * c)


@pytest.mark.slow
@pytest.mark.browser
def test_costs_along_a_curve_are_the_matchers(shown):
    outcome = shown.methods[0].outcome
    matcher = cost_matcher(shown.methods)
    assert own_cost(matcher, shown.methods) == list(range(len(shown.methods)))
    whole, compared = whole_pixels(outcome.pair, matcher), 0
    pixels = multiples(whole.reason == Reason.MATCHED, shown.every)[::37]
    for (row, column), said in zip(pixels, shown.at(pixels), strict=True):
        ks, costs = costs_along_curve(*outcome.filtered, whole, matcher, row, column)
        assert said["first"] == ks[0]
        page = np.array([number(cost) for cost in said["costs"]])
        # Columns are compared in the same whole numbers; 2^-24 is their unit of 1 - ZNCC. Squares are of grey levels
        # rounded to 1/8: 121 differences that are off by 1/20 (RMS), independently, make 0.6 of some hundred.
        exact = matcher.kind == "column"
        tolerance = 1e-7 if exact else 0.005 * np.nanmax(costs)
        np.testing.assert_allclose(page, costs, atol=tolerance, rtol=0)
        compared += ks.size
    assert compared > 200


@pytest.mark.slow
@pytest.mark.browser
def test_pixels_in_the_images_are_where_the_sensors_see_the_point(shown):
    outcome = shown.methods[0].outcome
    motion = outcome.trial.true_motion
    pixels = multiples(outcome.truth.visible, shown.every)[::37]
    for (row, column), said in zip(pixels, shown.at(pixels), strict=True):
        ray = directions(outcome.trial.panorama)[row, column]
        point = motion.R_v2_from_v1 @ (outcome.truth.range_m[row, column] * ray - motion.t_v1)
        for direction, sensor, pixel in zip((ray, point), outcome.pair.sensors, said["pixels"], strict=True):
            expected, visible = project(sensor, direction)
            if visible:
                assert pixel == pytest.approx(expected, abs=0.05)  # of the table


@pytest.mark.slow
@pytest.mark.browser
def test_the_curve_that_is_drawn_is_the_conic(shown):
    outcome = shown.methods[0].outcome
    row, column = multiples(outcome.reference.domain, shown.every)[500]
    chosen = [row // shown.every, column // shown.every]
    shown.explorer.evaluate("(explorer, pixel) => explorer.choose(...pixel)", chosen)
    assert shown.pixel() == [row, column]
    motion = outcome.pair.motion
    normal = np.cross(motion.t_v1, directions(outcome.trial.panorama)[row, column])
    conics = [
        plane_conic(sensor, R @ normal)
        for sensor, R in zip(outcome.pair.sensors, (np.eye(3), motion.R_v2_from_v1), strict=True)
    ]
    for view, conic in enumerate(conics):
        path = shown.page.locator(f"[data-picture=image{view}] path.curve:not(.casing)").get_attribute("d")
        drawn = np.array([[float(each) for each in pair.split(",")] for pair in re.split("[ML]", path)[1:]]) - 0.5
        assert len(drawn) > 50
        if conic is not None:
            assert conic.distance(drawn[::7]).max() < 0.06  # of the table, and half a hundredth of the path
    if all(conic is not None for conic in conics):
        assert shown.text("conic") == conics[0].kind


# --- In a browser: what a reader does -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    return Shown(run_small(), browser, tmp_path_factory.mktemp("report") / "report.html")


@pytest.mark.slow
@pytest.mark.browser
def test_pointing_at_a_pixel_shows_its_numbers(page):
    outcome = page.methods[1].outcome
    maps = maps_of(outcome)
    row, column = np.argwhere(outcome.reference.domain & maps.valid & (maps.true_range_m > 2))[77].tolist()
    page.page.mouse.move(*page.place("panorama0", maps.grid.width_px - 0.5 - column, row + 0.5))
    assert page.pixel() == [row, column]
    assert float(page.text("true-range")) == pytest.approx(maps.true_range_m[row, column], abs=0.51e-5)
    assert float(page.text("range-1")) == pytest.approx(
        maps.range_m[row, column], abs=0.51 * step_of_method(maps, 1e-5, 0.001)
    )
    step_mm = 1000 * step_of_method(maps, 1e-5, 0.001)
    error_mm = float(page.text("error-1").replace("−", "-"))
    assert error_mm == pytest.approx(1000 * maps.range_error_m[row, column], abs=1.01 * step_mm + 0.01)
    assert float(page.text("sigma-1")) == pytest.approx(1000 * maps.sigma_range_m[row, column], rel=0.07)  # two digits
    assert page.text("reason-1") == "matched"

    # The same point in the image of either view leads back to the pixel.
    places = page.at([[row, column]])[0]["pixels"]
    for view, (u, v) in enumerate(places):
        page.page.mouse.move(*page.place("panorama0", 5, 5))
        assert page.pixel() != [row, column]
        page.page.mouse.move(*page.place(f"image{view}", u + 0.5, v + 0.5))
        assert np.abs(np.subtract(page.pixel(), [row, column])).max() <= 1
    assert page.visited.complaints == []


@pytest.mark.slow
@pytest.mark.browser
def test_a_click_holds_the_pixel_and_escape_lets_go(page):
    page.page.mouse.click(*page.place("panorama0", 60.5, 20.5))
    held = page.pixel()
    assert held == [20, 119]
    page.page.mouse.move(*page.place("panorama0", 90.5, 30.5))
    assert page.pixel() == held
    assert page.page.locator("[data-part=hold]").get_attribute("aria-pressed") == "true"
    page.page.locator("[data-picture=panorama0]").focus()
    page.page.keyboard.press("Escape")
    page.page.mouse.move(*page.place("panorama0", 91.5, 30.5))
    assert page.pixel() == [30, 88]


@pytest.mark.slow
@pytest.mark.browser
def test_keys_move_the_pixel_and_focus_can_be_seen(page):
    page.explorer.evaluate("(explorer) => explorer.choose(20, 0)")
    picture = page.page.locator("[data-picture=panorama0]")
    page.page.locator("input[name=explorer-layer]").last.focus()
    page.page.keyboard.press("Tab")
    assert picture.evaluate("element => document.activeElement === element")
    assert picture.evaluate("element => getComputedStyle(element).outlineStyle") == "solid"
    page.page.keyboard.press("ArrowDown")
    assert page.pixel() == [21, 0]
    page.page.keyboard.press("ArrowRight")  # azimuth descends to the right, and the panorama goes round
    assert page.pixel() == [21, 179]
    page.page.keyboard.press("Shift+ArrowLeft")
    assert page.pixel() == [21, 9]
    page.page.locator("[data-picture=image0]").focus()
    page.page.keyboard.press("ArrowLeft")
    assert page.pixel() != [21, 9]
    spoken = page.page.locator("[data-part=spoken]")
    page.page.wait_for_function("part => part.textContent.includes('range')", arg=spoken.element_handle())
    assert spoken.inner_text().startswith("Row ")
    unnamed = "[...document.querySelectorAll('#explorer-app [tabindex]')].filter((each) => !each.ariaLabel).length"
    assert page.page.evaluate(unnamed) == 0


@pytest.mark.slow
@pytest.mark.browser
def test_a_finger_chooses_a_pixel(page):
    x, y = page.place("panorama0", 100.5, 25.5)
    touch = {"clientX": x, "clientY": y, "pointerType": "touch", "bubbles": True, "pointerId": 7}
    for name in ("pointerdown", "pointerup"):
        page.page.dispatch_event("[data-picture=panorama0]", name, touch)
    assert page.pixel() == [25, 79]


_COLOURS = """
() => {
  const canvas = document.querySelector("[data-picture=panorama0] canvas");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return btoa(Array.from(data, (each) => String.fromCharCode(each)).join(""));
}
"""


@pytest.mark.slow
@pytest.mark.browser
def test_layers_and_methods_change_what_is_drawn(page):
    def colours():
        data = b64decode(page.page.evaluate(_COLOURS))
        return np.frombuffer(data, np.uint8).reshape(50, 180, 4)[:, ::-1, :3]

    seen = {}
    for layer in explorer._LAYERS:
        page.page.locator(f"input[name=explorer-layer][value={layer}]").check(force=True)
        seen[layer] = colours()
        assert page.text("legend").strip()
    assert len({each.tobytes() for each in seen.values()}) == len(seen)
    outcome = page.methods[0].outcome
    hidden = np.isfinite(outcome.truth.range_m) & outcome.truth.in_field_2 & ~outcome.truth.unoccluded
    assert ((seen["occlusion"] == [0xD5, 0x5E, 0x00]).all(axis=-1) == hidden).all()
    unmatched = (seen["range"] == 0xC9).all(axis=-1)
    assert (unmatched == ~outcome.valid).all()
    page.page.locator("input[name=explorer-layer][value=error]").check(force=True)
    page.page.locator("input[name=explorer-method][value='1']").check(force=True)
    assert (colours() != seen["error"]).any()


_A_POINT_THAT_IS_DRAWN = """
({ cloud }) => {
  const at = cloud.owners.findIndex((owner, i) => owner >= 0 && i > cloud.owners.length / 2);
  return [at % cloud.canvas.width, Math.floor(at / cloud.canvas.width), cloud.owners[at], cloud.canvas.width];
}
"""


@pytest.mark.slow
@pytest.mark.browser
def test_the_cloud_turns_and_leads_back_to_a_pixel(page):
    canvas = page.page.locator("canvas.explorer-cloud")
    canvas.focus()
    page.page.wait_for_timeout(100)
    before = canvas.screenshot()
    page.page.keyboard.press("ArrowLeft")
    page.page.wait_for_timeout(100)
    assert canvas.screenshot() != before
    x, y, pixel, width = page.explorer.evaluate(_A_POINT_THAT_IS_DRAWN)
    box = canvas.bounding_box()
    page.page.mouse.click(box["x"] + (x + 0.5) * box["width"] / width, box["y"] + (y + 0.5) * box["width"] / width)
    assert page.pixel() == [pixel // 180, pixel % 180]


@pytest.mark.slow
@pytest.mark.browser
def test_on_paper_and_without_scripts_the_page_says_what_is_missing(page, driver, tmp_path):
    assert not page.page.get_by_text("The explorer works on a screen, with JavaScript").is_visible()
    page.page.emulate_media(media="print")
    assert page.page.get_by_text("The explorer works on a screen, with JavaScript").is_visible()
    assert not page.page.locator("#explorer-app").is_visible()
    page.page.emulate_media(media="screen")
    with chromium(tmp_path / "profile", scripts=False, driver=driver) as browser:
        read = visit(browser, page.file, width=390).page
        assert read.get_by_text("The explorer works on a screen, with JavaScript").is_visible()
        assert not read.locator("#explorer-app").is_visible()
        assert read.get_by_text("Errors against exact truth").is_visible()


# --- What fits ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_does_not_fit_is_left_out_and_said(monkeypatch):
    result = run_small()
    methods = Context.of(result).methods
    monkeypatch.setattr(contents, "_QUALITIES", contents._QUALITIES[:1])
    whole = contents_of(methods, 100.0, None, 10**7)
    assert [method.label for method in whole.shown] == ["whole pixels", "sub-pixel"]
    its = [sum(len(whole.arrays[f"{name}{i}"].text) for name in ("reason", "range", "sigma")) for i in (0, 1)]
    room = sum(len(each.text) for each in whole.arrays.values()) - its[0]
    one = contents_of(methods, 100.0, None, room)
    assert [method.label for method in one.shown] == ["sub-pixel"]  # the better one
    assert one.facts["cost"]["own"] == [0]
    monkeypatch.setattr(build, "MOST_BYTES", room + explorer._OWN_BYTES)
    assert "There is no room for whole pixels; the other sections have it." in page_of(result)
    assert contents_of(methods, 100.0, None, room - its[1]) is None
    monkeypatch.setattr(build, "MOST_BYTES", explorer._OWN_BYTES)
    html = page_of(result)
    assert "would make this page too large" in html
    assert 'id="explorer-app"' not in html


def page_of(result):
    return " ".join(build_report(result, None, [explorer.section]).split())


@pytest.mark.slow
def test_sections_say_about_how_large_they_are():
    result = run_small()
    others = [comparison.section, error_maps.section, measures.section]
    frame = len(build_report(result, None, []).encode())
    said = sum(section.size for section in build.sections_of(Context.of(result), None, others))
    assert len(build_report(result, None, others).encode()) - frame == pytest.approx(said, abs=20_000)


def test_every_script_of_the_folder_is_in_the_page():
    files = {path.stem for path in explorer._SCRIPTS.glob("*.js")}
    assert files == set(explorer._ORDER)
    assert "</" not in explorer.scripts().replace("</span>", "").replace(
        "</text>", ""
    )  # nothing ends the page's script
