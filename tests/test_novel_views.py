"""Views from other viewpoints in an experiment: from the key to the report."""

import json

import pandas as pd
import pytest
from sweeps import write_small

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
def test_from_the_command_to_the_report(tmp_path, capsys):
    given = write_small(tmp_path / "small.toml", "\n[axes]\nseed = [1, 2]\n")
    out = tmp_path / "out"
    views = "novel_views.distances_m=[0.05, 0.3]"
    assert main(["run", str(given), "--set", views, "--set", "noise.sigma_grey=2", "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Views warped with window (parabola) are" in said
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
        ([entry(0.1, 5.0, [4, 6]), entry(0.5, 3.0, [2, 4])], "at 0.1 and 0.5 m, by 3.0 to 5.0 dB."),
        ([entry(0.5, 1.0, [-1, 3]), entry(0.1, 5.0, [4, 6])], "at 0.1 m, by 5.0 dB; at 0.5 m that is not certain."),
        ([entry(0.1, -1.0, [-2, 0.1])], "are not certain to be better than the nearest image at any distance."),
    ],
)
def test_no_more_is_concluded_than_intervals_allow(entries, said):
    (sentence,) = views_conclusions(entries, {("sgm", "v"): "semi-global"})
    assert sentence.startswith("Views warped with semi-global ")
    assert sentence.endswith(said)


def test_of_one_seed_nothing_is_concluded():
    assert views_conclusions([entry(0.1, 5.0, None)], {}) == []
