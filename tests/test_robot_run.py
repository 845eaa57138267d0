"""A robot's keys in one experiment: range profile, map and localisation, from the command to the report."""

import json

import pandas as pd
import pytest
from sweeps import write_small

from harness.cli.parser import main
from harness.mapping.map_files import read_map
from harness.mapping.occupancy import Cell

pytestmark = pytest.mark.slow

CHANGES = (
    "scene=room", "matching.kind=sgm", "noise.sigma_grey=2", "view_2.baseline_m=0.3", "scan.bearings=90",
    "scan.support_px=2", "map.path_m=[[-0.4, 0.0], [0.6, 0.0]]", "map.every_m=1.0", "map.cell_m=0.1",
    "localisation.images=[4]", "localisation.queries=6", "localisation.synthesised=1", "localisation.width_px=90",
    "localisation.area_m=[[-2.0, -2.0], [2.0, 2.0]]",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The run's folder, and its summary."""
    folder = tmp_path_factory.mktemp("robot")
    given = write_small(folder / "small.toml", "\n[axes]\nseed = [1, 2]\n")
    sets = [each for change in CHANGES for each in ("--set", change)]
    assert main(["run", str(given), *sets, "--out", str(folder / "out"), "--workers", "1"]) == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    return folder / "out", summary


def test_range_profiles(run):
    out, summary = run
    (entry,) = summary["scans"]
    assert entry["seeds"] == 2
    assert 0.5 < entry["density"] <= 1
    assert {"pillar on the left", "pillar behind"} <= {each["name"] for each in entry["obstacles"]}
    assert pd.read_csv(out / "trials.csv")["scan_missed"].mean() == pytest.approx(entry["missed"])


def test_maps(run):
    out, summary = run
    (entry,) = summary["maps"]
    assert entry["seeds"] == 2
    assert entry["ceiling"]["iou_free"] > 0.85  # two places do not see behind the pillars
    assert 0.4 < entry["iou_free"] < entry["ceiling"]["iou_free"]
    assert pd.read_csv(out / "trials.csv")["map_iou_free"].mean() == pytest.approx(entry["iou_free"])
    files = sorted(each.name for each in (out / "occupancy").iterdir())
    assert [each.rpartition(".")[2] for each in files] == ["png", "yaml"] * 2
    state, frame = read_map(out / "occupancy" / files[1])
    assert 15 < (state == Cell.FREE).sum() * frame.cell_m**2 < 42  # of the room's 42 m2


def test_localisation(run):
    _, summary = run
    entries = summary["localisation"]
    assert [each["appearance"] for each in entries] == ["pca", "vlad"]
    for entry in entries:
        assert {(each["way"], each["images"]) for each in entry["errors"]} == {
            ("pairs", 4), ("synthesised", 4), ("true ranges", 4), ("singles", 4), ("singles", 8),
        }  # fmt: skip
        assert all(0 < each["median_m"] < 5.7 for each in entry["errors"])  # the area's diagonal
        (gain,) = entry["gains"]
        assert 4 <= gain["worth"] <= 8


def test_the_report_has_a_section_on_each(run):
    out, summary = run
    page = (out / "report.html").read_text(encoding="utf-8")
    for said in ("Range profiles of a robot", "obstacles found", "Maps of a robot", "map of the true ranges",
                 "Localisation by appearance", "VLAD of dense descriptors"):  # fmt: skip
        assert said in page
    assert "could not be drawn" not in page
    starts = (
        "Range profiles (sgm) look through",
        "Maps (sgm) agree",
        "PCA of panoramas, ranges of sgm: ",
    )
    for start in starts:
        assert any(each.startswith(start) for each in (summary["headline"], *summary["conclusions"]))
