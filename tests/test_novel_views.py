"""Views from other viewpoints in an experiment: from the key to the report."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from sweeps import write_small

import harness
from harness.cli.parser import main
from harness.geometry.pose import Pose
from harness.pipeline.specification import Trial
from harness.runs.novel_views import views_conclusions
from harness.warping.settings import NovelViews


def entry(distance_m, gain_db, ends, method=("sgm", "v")):
    return {
        "matcher": method[0], "subpixel": method[1], "condition": "", "distance_m": distance_m,
        "gain_db": gain_db, "gain_ci95_db": ends,
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_from_the_command_to_the_report(tmp_path, capsys):
    given = write_small(tmp_path / "small.toml", "\n[axes]\nseed = [1, 2]\n")
    out = tmp_path / "out"
    views = "novel_views.distances_m=[0.05, 0.3]"
    assert main(["run", str(given), "--set", views, "--set", "noise.sigma_grey=2", "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Warped views (sub-pixel) are" in said
    entries = json.loads((out / "summary.json").read_text())["novel_views"]
    assert {each["distance_m"] for each in entries} == {0.05, 0.3}
    for each in entries:
        psnr = each["psnr_db"]
        assert psnr["floor"] < psnr["ceiling"]
        assert psnr["warped"] < psnr["ceiling"]
        assert each["seeds"] == 2
    trials = pd.read_csv(out / "trials.csv")
    assert (trials["view_ceiling_psnr_db"] > trials["view_psnr_db"]).all()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Views from other viewpoints" in page
    assert "The view 0.3 m from the first viewpoint" in page


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A folder of two rendered views of the box, 0.3 m apart."""
    folder = tmp_path_factory.mktemp("pair")
    sensor = {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5}}
    for name, x in (("left", 0.0), ("right", 0.3)):
        harness.render("box", sensor=sensor, position_m=(x, 0.0, 1.0), samples=4).write(folder / name)
    return folder


def command(folder, *options):
    left, right = (str(folder / name / "omni.png") for name in ("left", "right"))
    sensor = str(folder / "left" / "sensor.toml")
    return ["warp", left, right, "--sensor", sensor, "--baseline", "0.3", "0", "0", "--matcher", "column", *options]


@pytest.mark.slow
def test_two_images_from_another_viewpoint(pair, tmp_path, capsys):
    """As rendered there, of which it is nearer than either image is."""
    assert main(command(pair, "--to", "0.1", "0.25", "0", "--as", "mirror", "--out", str(tmp_path / "w"))) == 0
    assert "are seen" in capsys.readouterr().out
    view, state = np.array(Image.open(tmp_path / "w" / "view.png"), float), np.load(tmp_path / "w" / "state.npy")
    there = harness.render("box", sensor=pair / "left" / "sensor.toml", position_m=(0.1, 0.25, 1.0), samples=4)
    near = np.array(Image.open(pair / "left" / "omni.png"), float)
    seen = (state == 0) & np.isfinite(there.range_m)
    assert seen.mean() > 0.25  # the mirror fills less than half of the image
    rms = [np.sqrt(np.mean((each - there.image)[seen] ** 2)) for each in (view, near)]
    assert rms[0] < 0.7 * rms[1]
    range_m = np.load(tmp_path / "w" / "range.npy")
    assert np.median(np.abs(range_m / there.range_m - 1)[seen]) < 0.06  # columns, of a small image and baseline


@pytest.mark.slow
def test_a_pinhole_camera_looks_along_x_of_its_frame(pair):
    estimate = harness.estimate_range(
        pair / "left" / "omni.png", pair / "right" / "omni.png", pair / "left" / "sensor.toml", (0.3, 0, 0), "slanted"
    )
    view = harness.warp_view(estimate, (0.0, 0.4, 0.0), projection="perspective", yaw_deg=90, width_px=64, height_px=48)
    assert view.image.shape == (48, 64)
    wall_m = harness.load_scene("box").objects[0].size_m[1] / 2 - 0.4
    # At the centre the wall's own distance; 20 pixels beside it, of a focal length of 32, that over the cosine.
    assert np.nanmedian(view.range_m[22:26, 30:34]) == pytest.approx(wall_m, rel=0.02)
    aside = wall_m / np.cos(np.arctan(20 / 32))
    assert np.nanmedian(view.range_m[22:26, [11, 12, 51, 52]]) == pytest.approx(aside, rel=0.03)
    assert sum(view.shares().values()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--to", "0", "nan", "0"), "--to: must be a finite number; found nan"),
        (("--to", "0", "0", "0", "--field-deg", "200"), "--field-deg: must be 1 to 179 degrees; found 200"),
        (("--to", "0", "0", "0", "--view-size", "2", "480"), "--view-size: must be 8 to 16384; found 2"),
    ],
)
def test_a_view_that_cannot_be_is_refused_before_anything_is_matched(options, said, pair, tmp_path, capsys):
    assert main(command(pair, *options, "--out", str(tmp_path / "w"))) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "w").exists()


def test_without_them_a_trial_keeps_its_key():
    scene = {"name": "b", "objects": [{"kind": "box", "name": "b", "size_m": [4, 4, 3], "position_m": [0, 0, 1.5],
             "inward": True, "texture": {"kind": "grey", "value": 100}}]}  # fmt: skip
    plain = Trial(scene=scene)
    views = plain.model_copy(update={"novel_views": NovelViews(distances_m=(0.5,))})
    assert plain.key == plain.model_copy(update={"novel_views": NovelViews(azimuth_deg=90.0)}).key
    assert plain.key != views.key


def test_they_stand_on_a_line_through_the_first_viewpoint():
    view_1 = Pose(position_m=(1.0, 2.0, 1.0), yaw_deg=30.0)
    first, second = NovelViews(distances_m=(0.5, 2.0), azimuth_deg=180.0, elevation_deg=30.0).poses(view_1)
    assert first.yaw_deg == 30.0
    assert first.position_m == pytest.approx((1 - 0.5 * 3**0.5 / 2, 2.0, 1.25))
    assert second.position_m == pytest.approx((1 - 3**0.5, 2.0, 2.0))


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        (
            [entry(0.1, 5.0, [4, 6]), entry(0.5, 3.0, [2, 4])],
            "are 3.0 [2.0, 4.0] to 5.0 [4.0, 6.0] dB better than the nearest image at 0.1 and 0.5 m.",
        ),
        (
            [entry(0.5, 1.0, [-1, 3]), entry(0.1, 5.0, [4, 6])],
            "are 5.0 [4.0, 6.0] dB better than the nearest image at 0.1 m; at 0.5 m that is not certain.",
        ),
        ([entry(d, 5.0, [4, 6]) for d in (1, 0.1, 0.5)], "dB better than the nearest image at 0.1 to 1 m."),
        ([entry(0.1, -1.0, [-2, 0.1])], "are not certain to be better than the nearest image at any distance."),
    ],
)
def test_no_more_is_concluded_than_intervals_allow(entries, said):
    (sentence,) = views_conclusions(entries, {("sgm", "v"): "semi-global"})
    assert sentence.startswith("Warped views (semi-global) ")
    assert sentence.endswith(said)


def test_of_one_seed_nothing_is_concluded():
    assert views_conclusions([entry(0.1, 5.0, None)], {}) == []


@pytest.mark.slow
def test_cases_that_are_methods_are_compared(tmp_path):
    """Not conditions of their own: one set of curves, and a sentence for each, by the name of its case."""
    cases = {"square windows": {"matching.kind": "window"}, "columns": {"matching.kind": "column"}}
    result = harness.run(
        write_small(tmp_path / "small.toml"),
        axes={"seed": [1, 2]},
        cases=cases,
        sets={"novel_views.distances_m": [0.1, 0.3], "noise.sigma_grey": 2.0},
    )
    entries = result._result.summary["novel_views"]
    assert len({each["condition"] for each in entries}) == 1
    summary = result._result.summary
    said = [summary["headline"], *(each for each in summary["conclusions"] if each.startswith("Warped views ("))]
    assert {each.removeprefix("Warped views (").split(") are ")[0] for each in said} == {"columns", "square windows"}
