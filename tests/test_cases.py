"""Named cases: several settings that change together are one line everywhere, under one name."""

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sweeps import write_small

import harness
from harness.cli import main
from harness.errors import InputError, Notice
from harness.report.paired_differences import build_comparison
from harness.report.sections import error_budget
from harness.runs.cases import with_names
from harness.runs.load import load_experiment
from harness.runs.methods import METHOD_KEYS
from harness.runs.run import run_experiment
from harness.spec import dump_toml

FINE = "1280x960, 0.3 m"
LONG = "a rig with a name of sixty letters, which every table shows."
CASES = f"""
[axes]
seed = [1, 2]
"matching.window_px" = [5, 7]

[[cases]]
name = "{FINE}"
"view_2.baseline_m" = 0.3
"noise.sigma_grey" = 2.0

[[cases]]
name = "as it is"

[[cases]]
name = "{LONG}"
"view_2.baseline_m" = 0.4
"noise.sigma_grey" = 4.0
"""
NAMES = [FINE, "as it is", LONG]
METHODS = """
[axes]
seed = [1, 2]
[[cases]]
name = "the paper's windows"
"matching.kind" = "window"
[[cases]]
name = "columns, V fit"
"matching.kind" = "column"
"matching.subpixel" = "v"
"""


def lines_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "trials.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def runs_of(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(["run", *map(str, arguments)]) == 0
    return capsys.readouterr().out


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("cases")
    file = write_small(folder / "e.toml", CASES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMNIRANGE_CACHE", str(folder / "cache"))
        assert main(["run", str(file), "--out", str(folder / "out"), "--workers", "1"]) == 0
        yield folder / "out"


def test_a_case_is_one_coordinate_and_multiplies_with_axes(tmp_path: Path) -> None:
    experiment = load_experiment(str(write_small(tmp_path / "e.toml", CASES)))
    assert [tuple(each.coordinates.items()) for each in experiment.planned] == [
        (("case", name), ("seed", seed), ("matching.window_px", window))
        for name in NAMES
        for seed in (1, 2)
        for window in (5, 7)
    ]
    (tmp_path / "again.toml").write_text(dump_toml(experiment), encoding="utf-8")
    again = load_experiment(tmp_path / "again.toml")
    assert [(e.key, e.coordinates) for e in again.planned] == [(e.key, e.coordinates) for e in experiment.planned]


def test_a_case_names_no_trial_of_its_own(tmp_path: Path) -> None:
    """Trials are known by their settings: another name runs nothing again."""
    first, second = (
        load_experiment(str(write_small(tmp_path / "e.toml", CASES.replace(FINE, name)))) for name in (FINE, "other")
    )
    assert [each.key for each in first.planned] == [each.key for each in second.planned]


def test_a_dry_run_counts_trials_by_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = runs_of(capsys, write_small(tmp_path / "e.toml", CASES), "--dry-run").splitlines()
    assert said[1:] == [f"  case {name}: 4 trials" for name in NAMES]


def test_cases_in_python() -> None:
    rigs = {FINE: {"view_2.baseline_m": np.float64(0.3), "noise.sigma_grey": 2}, "as it is": {}}
    experiment = harness.load_experiment("smoke", axes={"seed": [1], "view_2.yaw_deg": [0.0]}, sets=SETS, cases=rigs)
    assert [each.coordinates["case"] for each in experiment.planned[::4]] == [FINE, "as it is"]
    trial = experiment.planned[0].trial
    assert (trial.view_2.baseline_m, trial.noise.sigma_grey) == (0.3, 2)
    assert harness.load_experiment("budget", cases={"one": {"believed.t_length": 0.01}}).cases == [
        {"name": "one", "believed.t_length": 0.01}
    ]
    assert harness.load_experiment("budget", cases={}).cases == []


SETS = {"view_2.baseline_m": 0.5, "noise.sigma_grey": 0.0}


@pytest.mark.parametrize(
    ("cases", "said"),
    [
        ({"a": {"noise.sigma": 3}}, "cases: a: noise.sigma: unknown key 'sigma'; did you mean 'sigma_grey'?"),
        ({"a": {}, "b": {"noise.sigma_grey": -1}}, "cases: b: noise.sigma_grey: must be at least 0; found -1"),
        ({"a": {"matching.window_px": 9}}, "cases: a: matching.window_px: this key is also an axis; give it only once"),
        ({"": {}}, "cases: name: must have 1 to 60 letters in one line"),
        ({3: {}}, "cases: name: must be text; found 3"),
        ({"a": {}, "b": {}}, "cases: b: two trials are the same"),
        ({"a": {"name": "b"}}, "cases: a: name: unknown key; a case is named by the dictionary around it"),
        ({"a": 3}, "cases: a: must be a dictionary of keys and values; found 3"),
        ([{"name": "a"}], "cases: must be a dictionary"),
        ({"a": {"scene": "bx"}}, "cases: a: scene: 'bx': no such scene"),
    ],
)
def test_bad_cases_in_python(cases: object, said: str) -> None:
    with pytest.raises(InputError) as caught:
        harness.load_experiment("smoke", sets=SETS, cases=cases)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_cases_that_are_methods_name_them(tmp_path: Path) -> None:
    experiment = load_experiment(str(write_small(tmp_path / "e.toml", METHODS)))
    assert experiment.method_labels == {
        ("window", "parabola"): "the paper's windows",
        ("column", "v"): "columns, V fit",
    }
    # More settings of the matcher belong to its case, and the trial shown in detail has them.
    wider = load_experiment(str(write_small(tmp_path / "e.toml", METHODS + '"matching.window_px" = 9\n')))
    assert wider.method_labels == experiment.method_labels
    assert {each.case_keys for each in wider.planned} == {METHOD_KEYS}
    # Two cases of one method differ in something else, and settings beyond the matcher's are no method's.
    same = METHODS.replace('"column"\n"matching.subpixel" = "v"', '"window"\n"matching.window_px" = 9')
    noisy = METHODS + '"noise.sigma_grey" = 2.0\n'
    for rest in (same, noisy):
        assert load_experiment(str(write_small(tmp_path / "e.toml", rest))).method_labels == {}
    # With an axis over the step, a case is no method: it stays a line of its own.
    axis = 'seed = [1, 2]\n"matching.subpixel" = ["none", "parabola"]\n'
    varied = METHODS.replace("seed = [1, 2]\n", axis).replace('"matching.subpixel" = "v"\n', "")
    assert load_experiment(str(write_small(tmp_path / "e.toml", varied))).method_labels == {}


def test_conditions_leave_out_a_case_that_sets_nothing_else(tmp_path: Path) -> None:
    """The law is tested across baselines, so a case that changes the baseline alone must not part them."""
    near = '[[cases]]\nname = "near"\n"view_2.baseline_m" = 0.3\n'
    both = near + '[[cases]]\nname = "far"\n"view_2.baseline_m" = 0.6\n'
    noisy = both + '"noise.sigma_grey" = 4.0\n'
    for rest, conditions in ((both, [{}, {}]), (noisy, [{"case": "near"}, {"case": "far"}])):
        planned = load_experiment(str(write_small(tmp_path / "e.toml", rest))).planned
        assert [each.coordinates_without(lambda key: key == "view_2.baseline_m") for each in planned] == conditions


@pytest.mark.slow
def test_every_file_names_the_case(out: Path) -> None:
    trials = lines_of(out)
    assert list(trials[0])[:4] == ["state", "case", "seed", "matching.window_px"]
    assert list(trials[0])[-1] == "key"  # a hash comes last
    assert [each["case"] for each in trials] == [name for name in NAMES for _ in range(4)]
    assert not {"view_2.baseline_m", "noise.sigma_grey"} & trials[0].keys()
    cases = json.loads((out / "summary.json").read_text())["cases"]
    assert [each["case"] for each in cases] == NAMES
    assert cases[0]["settings"] == {"view_2.baseline_m": 0.3, "noise.sigma_grey": 2.0}
    for each in cases:
        mine = [trial for trial in trials if trial["case"] == each["case"]]
        assert (each["trials"], each["seeds"]) == (4, 2)
        assert each["density"] == pytest.approx(np.mean([float(trial["density"]) for trial in mine]))
        errors = [float(trial["range_median_abs_m"]) for trial in mine]
        assert each["range_median_abs_m"] == pytest.approx(np.exp(np.mean(np.log(errors))))
        low, high = each["range_median_abs_m_ci95"]
        assert min(errors) <= low <= each["range_median_abs_m"] <= high <= max(errors)


@pytest.mark.slow
def test_terminal_and_report_have_a_line_for_each_case(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = runs_of(capsys, out.parent / "e.toml", "--out", out)  # nothing to run: it is resumed, and shown
    assert "all 12 trials are done" in said
    assert "means over the trials of each case" in said
    words = {word for name in NAMES for word in name.split()}
    assert words <= set(said.split())  # wrapped between words, never inside one
    page = (out / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<h2 id="cases"') : page.index('<h2 id="sweeps"')]
    rows = re.findall(r'<tr><th scope="row" class="text">(.*?)</th>', section)
    assert [row.replace("\u00a0", " ") for row in rows] == NAMES
    assert all(f"{name} (whole" in page or f"{name} (sub-pixel)" in page for name in NAMES)  # the figure's words
    assert 'id="figure-sweep-matching-window-px"' in page
    assert 'id="figure-sweep-case"' not in page  # names are no positions on a line
    assert 'id="figure-sweep-view-2-baseline-m"' not in page
    assert "3 cases; window: 5, 7 px" in page


@pytest.mark.slow
def test_a_run_with_other_names_is_resumed(out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = runs_of(capsys, write_small(tmp_path / "e.toml", CASES.replace(FINE, "fine")), "--out", out, "--no-report")
    assert "12 of 12 trials" in said or "trials are done" in said
    assert {each["case"] for each in lines_of(out)} == {"fine", *NAMES[1:]}
    runs_of(capsys, out.parent / "e.toml", "--out", out, "--no-report")
    assert {each["case"] for each in lines_of(out)} == set(NAMES)


@pytest.mark.slow
def test_results_know_trials_by_case(out: Path) -> None:
    result = harness.open_results(out)
    assert list(result.trials["case"].unique()) == NAMES
    outcome = result.outcome({"case": FINE, "seed": 1, "matching.window_px": 5})
    assert outcome.range_m.shape == (50, 180)
    with pytest.raises(InputError, match=r"'view_2\.baseline_m' is not a key that varies; those are: case, seed"):
        result.outcome({"view_2.baseline_m": 0.3})


@pytest.mark.slow
def test_runs_are_compared_case_by_case(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(out.parent / "cache"))
    file = write_small(tmp_path / "e.toml", CASES)
    for name, options in (("cost", ["--set", "matching.cost=ssd"]), ("one", ["--axis", "seed=1"])):
        runs_of(capsys, file, "--out", tmp_path / name, "--no-report", *options)
    [pairing] = build_comparison(out, tmp_path / "cost").pairings
    assert pairing.differing == {"matching.cost": ("sad", "ssd")}
    assert pairing.pairs == 12
    assert list(dict.fromkeys(each.case for each in pairing.differences)) == NAMES
    assert {each.pairs for each in pairing.differences} == {4}
    [pairing] = build_comparison(out, tmp_path / "one").pairings
    assert pairing.pairs == 6
    assert all(each.difference == 0 for each in pairing.differences)

    # Cases of other names that share no setting: what differs is the case, in one line.
    other = '[axes]\nseed = [1, 2]\n[[cases]]\nname = "{}"\n"view_2.baseline_m" = {}\n"noise.sigma_grey" = {}\n'
    for name, baseline, noise in (("wide", 0.6, 1.0), ("small", 0.2, 3.0)):
        runs_of(
            capsys,
            write_small(tmp_path / f"{name}.toml", other.format(f"{name} rig", baseline, noise)),
            "--out",
            tmp_path / name,
            "--no-report",
        )
    comparison = build_comparison(tmp_path / "wide", tmp_path / "small")
    [pairing] = comparison.pairings
    assert pairing.differing == {"case": ("wide rig", "small rig")}
    assert pairing.pairs == 2
    assert {each.case for each in pairing.differences} == {""}


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_methods_go_by_their_cases_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    file = write_small(tmp_path / "e.toml", METHODS + '"matching.window_px" = 9\n')
    said = runs_of(capsys, file, "--out", tmp_path / "out")
    assert "means over the trials of each case" in said
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for name in ("the paper's windows", "columns, V fit"):
        assert all(word in said.split() for word in name.split())
        assert name.replace("'", "&#39;") in page
    assert 'id="cases"' not in page
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["labels"] == {"window parabola": "the paper's windows", "column v": "columns, V fit"}
    assert list(summary["comparison"]) == list(summary["labels"])
    result = run_experiment(load_experiment(tmp_path / "e.toml"), workers=1)
    assert [(each.trial.matching.kind, each.trial.matching.window_px) for each in result.outcomes] == [
        ("window", 11),
        ("column", 9),
    ]
    assert [each["case"] for each in result.coordinates] == list(summary["labels"].values())


def test_cases_of_a_budget_have_looks_of_their_own() -> None:
    """One cause in two sizes, several causes and none; a cause that is there once keeps its look."""
    sizes = {"small": ["rotation"], "large": ["rotation"], "length": ["t length"], "own": []}
    entries = [{"case": name, "causes": causes} for name, causes in sizes.items()]
    looks = error_budget._looks(entries)
    assert list(looks) == list(sizes)
    assert len(set(looks.values())) == len(sizes)
    assert looks["length"] == (error_budget._COLOURS["t length"], error_budget._MARKS["t length"])
    many = [{"case": f"rig {number}", "causes": ["rotation", "t length"]} for number in range(30)]
    assert len(set(error_budget._looks(many).values())) == 30


def test_the_data_of_a_budget_have_a_heading_for_each_column() -> None:
    entry = {"matcher": "slanted", "subpixel": "own", "case": "rig", "condition": "case = rig", "causes": ["rotation"]}
    entry |= {"seeds": 4, "range_m": 2.0, "predicted_m": {"matching": 0.01, "rotation": 0.02}, "total_m": 0.03}
    entry |= {"measured_m": 0.04, "measured_ci95_m": [0.035, 0.045], "over_drawn": 1.1, "over_drawn_ci95": [0.9, 1.2]}
    data = error_budget._table([entry | {"alone_m": None}]).data
    assert data is not None
    (row,) = data.rows
    named = dict(zip(data.headings, row, strict=True))
    assert (named["cause"], named["measured_m"], named["ratio"]) == ("rig", 0.04, pytest.approx(4 / 3))
    assert [named[key] for key in ("over_drawn", "over_drawn_low", "over_drawn_high")] == [1.1, 0.9, 1.2]
    assert (named["from_each_alone_m"], named["seeds"]) == (None, 4)


def test_cases_without_a_name_are_called_by_what_they_change() -> None:
    """For one version, with a notice."""
    cases = [
        {"noise.sigma_grey": 1.0},
        {"noise.sigma_grey": 2.0, "matching.kind": "sgm"},
        {"name": "mine", "seed": 3},
        {"y" * 80: 1},
    ]
    with pytest.warns(Notice, match=r"cases\[0\], cases\[1\], cases\[3\], cases\[4\]: without a name") as caught:
        named = with_names([*cases, cases[0]])
    assert len(caught) == 1
    assert [case["name"] for case in named] == [
        "sigma_grey 1.0",
        "sigma_grey 2.0, kind 'sgm'",
        "mine",
        "case 4",
        "case 5",
    ]
    assert [{key: v for key, v in case.items() if key != "name"} for case in named[:2]] == cases[:2]
