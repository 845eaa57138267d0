"""Runs side by side: paired differences that are true to the trials, and usable pages."""

import csv
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, visit
from repeats import few
from sweeps import write_small
from test_report import Document

from harness.cli import main
from harness.errors import InputError
from harness.evaluation.metric_table import metric
from harness.report.paired_differences import build_comparison
from harness.report.written_runs import COMPARED

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
        "slanted": ["--set", "matching.kind=slanted", "--axis", "seed=2,3,4"],
        "noises": ["--set", "noise.sigma_grey=4", "--axis", "seed=1,2"],
        "scenes": ["--axis", 'scene="corridor","box"', "--axis", "seed=1", "--axis", "matching.subpixel=none"],
    }
    for name, options in changes.items():
        assert main(["run", str(file), "--out", str(folder / name), "--no-report", *options]) == 0
    return {name: folder / name for name in changes}


def figures_of(folder: Path, name: str) -> dict[tuple[str, str], float]:
    with (folder / "trials.csv").open(encoding="utf-8", newline="") as stream:
        return {(row["seed"], row.get("matching.subpixel", "")): float(row[name]) for row in csv.DictReader(stream)}


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


def test_the_conclusion_names_every_figure_once_by_its_verdict(runs):
    [pairing] = build_comparison(runs["window"], runs["noises"]).pairings
    verdicts = {each.verdict for each in pairing.differences}
    assert len(verdicts) > 1
    assert pairing.conclusion.startswith("noises against window: ")
    for each in pairing.differences:
        name = metric(each.figure).short
        assert (f"“{name}”" in pairing.conclusion) != (f"“{name} ({each.group})”" in pairing.conclusion)
    assert pairing.conclusion.count("“") >= len(COMPARED)


def test_the_same_run_again_is_the_same(runs):
    [pairing] = build_comparison(runs["window"], runs["again"]).pairings
    assert pairing.conclusion == f"again against window: the same in all {len(COMPARED)} figures."
    assert not pairing.differing
    assert {each.verdict for each in pairing.differences} == {"the same"}


def test_trials_without_a_partner_are_left_out(runs):
    [pairing] = build_comparison(runs["window"], runs["noises"]).pairings
    assert list(pairing.differing) == ["noise.sigma_grey"]
    assert (pairing.pairs, pairing.seeds) == (4, 2)


def test_a_scene_by_name_on_an_axis_is_the_one_that_another_run_has_as_a_table(runs):
    [pairing] = build_comparison(runs["window"], runs["scenes"]).pairings
    assert (pairing.pairs, pairing.seeds, pairing.differing) == (1, 1, {})
    assert {each.verdict for each in pairing.differences} == {"the same"}


def test_what_cannot_be_paired_is_said(runs):
    comparison = build_comparison(runs["window"], runs["baselines"])
    [pairing] = comparison.pairings
    assert pairing.pairs == 0
    assert "Nothing can be paired: baseline |t| (m) varies" in pairing.why_none
    assert pairing.why_none in Document(comparison.html).text
    assert not list(comparison.lines())


def test_runs_of_other_matchers_are_paired_by_scene_pose_and_noise(runs):
    """A run of two methods and one of a third: each of the two against the third, under the same seeds."""
    [pairing] = build_comparison(runs["window"], runs["slanted"]).pairings
    assert (pairing.pairs, pairing.seeds, pairing.why_none) == (4, 2, "")
    assert pairing.differing["method"] == ("window (whole pixels), window (sub-pixel)", "slanted")
    groups = {
        f"slanted against window ({step})": key for step, key in (("whole pixels", "none"), ("sub-pixel", "parabola"))
    }
    assert {each.group for each in pairing.differences} == set(groups)
    for each in pairing.differences:
        first, second = (figures_of(runs[name], each.figure) for name in ("window", "slanted"))
        alone = {seed: value for (seed, _), value in second.items()}
        off = [
            alone[seed] - value for (seed, step), value in first.items() if step == groups[each.group] and seed in alone
        ]
        assert len(off) == each.pairs == 2
        assert each.difference == pytest.approx(np.mean(off))
    assert pairing.left_out == [
        "2 of 6 trials of window have no partner (seed: 1)",
        "1 of 3 trials of slanted have no partner (seed: 4)",
    ]


def test_nothing_paired_is_exit_code_1(runs, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    page = str(tmp_path / "page.html")
    assert main(["compare", str(runs["window"]), str(runs["baselines"]), "--out", page]) == 1
    assert "Nothing can be paired" in capsys.readouterr().out
    assert main(["compare", str(runs["window"]), str(runs["slanted"]), "--out", page]) == 0
    said = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in said.splitlines() if str(tmp_path) not in line) <= 80
    assert "not paired: 1 of 3 trials of slanted have no partner (seed: 4)" in said
    assert "1 of 3 trials of slanted have no partner (seed: 4)" in Document(Path(page).read_text(encoding="utf-8")).text


def test_folders_that_hold_no_run_are_named(runs, tmp_path):
    with pytest.raises(InputError, match=r"it has no experiment\.toml"):
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
    assert all(row.rstrip().endswith(("better", "worse", "inconclusive", "the same")) for row in rows)


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", few(1, [390, 1200]))
def test_comparison_in_chromium(runs, tmp_path, width):
    file = tmp_path / "comparison.html"
    file.write_text(build_comparison(runs["window"], runs["column"], runs["baselines"]).html, encoding="utf-8")
    with chromium(tmp_path / "profile") as browser:
        visited = visit(browser, file, width=width)
        assert (visited.requests, visited.complaints) == ([], [])
        assert visited.page.evaluate("document.documentElement.scrollWidth") <= width
        assert visited.page.locator("figure img").count() == 1


def test_a_file_is_no_run(runs, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    assert main(["compare", str(runs["window"]), str(file)]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {file}: holds no run")


@pytest.mark.parametrize("name", ["trials.csv", "run.sqlite", "report.html"])
def test_a_page_is_not_written_over_a_run(runs, name, capsys):
    file = runs["again"] / name
    if name == "report.html":
        file.write_text("of the run")
    before = file.read_bytes()
    assert main(["compare", str(runs["window"]), str(runs["again"]), "--out", str(file)]) == 2
    assert f"{file}: --out: is a file of a run that is compared; give another name\n" in capsys.readouterr().err
    assert file.read_bytes() == before
