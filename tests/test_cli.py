"""The command line: what is planned, what is refused and in which words, and how it exits."""

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest
from sweeps import begin, wait_for, write_small

from harness import shipped
from harness.camera.models import MODELS
from harness.cli import main
from harness.errors import InputError
from harness.matching.registry import BUILT_IN
from harness.runs.load import load_experiment
from harness.runs.written import OF_ALL_ROWS


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2]\n")


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a bad input is answered with."""
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    assert code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err.removeprefix("omnirange: ").strip()


def run_here(*arguments: object) -> None:
    """A run in this process, which has the compiled loops loaded."""
    assert main(["run", *map(str, arguments), "--workers", "1"]) == 0


# --- Which trials --------------------------------------------------------------------------------------------------


def test_the_product_runs_through_the_last_axis_first(tmp_path: Path) -> None:
    path = write_small(tmp_path / "e.toml", '[axes]\nseed = [3, 1]\n"noise.sigma_grey" = [0.0, 2.0]\n')
    planned = load_experiment(str(path)).planned
    assert [tuple(each.coordinates.values()) for each in planned] == [(3, 0.0), (3, 2.0), (1, 0.0), (1, 2.0)]
    assert [(each.trial.seed, each.trial.noise.sigma_grey) for each in planned] == [(3, 0), (3, 2), (1, 0), (1, 2)]


def test_every_kind_of_key_can_be_an_axis(tmp_path: Path) -> None:
    axes = {
        "view_2.baseline_m": [0.25, 0.5],
        "matching.window_px": [5, 7],
        "noise.sigma_grey": [1, 2],
        "scene.scale": [1.0, 2.0],
        "scene.objects.0.size_m": [[6.0, 6.0, 3.0], [8.0, 8.0, 3.0]],
        "matching.subpixel": ["none", "parabola"],
        "matching.pitch_px": [1.0, 0.5],
        "filter.log_sigma_px": [1.0, 1.5],
        "panorama.width_px": [180, 360],
        "render.samples": [4, 16],
        "matching.d_min_m": [0.5, 1.0],
        "view_2.yaw_deg": [0.0, 30.0],
        "view_1.position_m": [[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]],
        "placement.offset_m": [0.0, 0.1],
        "placement.random_yaw": [False, True],
        "sensor.model.a_m": [0.0281, 0.03],
        "seed": [1, 2],
    }
    small = str(write_small(tmp_path / "e.toml"))
    for key, values in axes.items():
        text = ",".join(str(value).lower() for value in values)
        planned = load_experiment(small, axes=[f"{key}={text}"]).planned
        assert [each.coordinates for each in planned] == [{key: value} for value in values]
        assert planned[0].key != planned[1].key


def test_scenes_as_an_axis_with_a_key_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text((shipped.folder("scenes") / "box.toml").read_text().replace("6.0", "7.0"))
    path = write_small(tmp_path / "e.toml", '[axes]\n"scene.scale" = [1.0, 2.0]\nscene = ["box", "./mine.toml"]\n')
    planned = load_experiment(str(path)).planned
    assert len({each.key for each in planned}) == 4
    assert [each.trial.scene.scale for each in planned] == [1, 1, 2, 2]
    assert planned[0].coordinates["scene"] == "box"  # a shipped name stays
    assert planned[1].coordinates["scene"] == str(
        (tmp_path / "mine.toml").resolve()
    )  # so that it is found from anywhere


def test_cases_are_taken_as_they_are_and_multiplied_by_axes(tmp_path: Path) -> None:
    rest = "[axes]\nseed = [1, 2]\n"
    rest += '[[cases]]\nname = "noisy"\n"noise.sigma_grey" = 5\n[[cases]]\nname = "near"\n"view_2.baseline_m" = 0.2\n'
    planned = load_experiment(str(write_small(tmp_path / "e.toml", rest))).planned
    assert [each.coordinates for each in planned] == [
        {"case": name, "seed": seed} for name in ("noisy", "near") for seed in (1, 2)
    ]
    trials = [each.trial for each in planned]
    assert [(each.seed, each.noise.sigma_grey, each.view_2.baseline_m) for each in trials] == [
        (1, 5, 0.5),
        (2, 5, 0.5),
        (1, 0.0, 0.2),
        (2, 0.0, 0.2),
    ]


def test_set_and_axis(small: Path) -> None:
    experiment = load_experiment(
        str(small),
        sets=["matching.subpixel=none", "seed = 9"],
        axes=["matching.window_px=5,9", "matching.cost=sad,ssd"],
    )
    assert list(experiment.axes) == ["matching.window_px", "matching.cost"]  # a setting ends the axis over its key
    assert [(each.trial.matching.window_px, each.trial.matching.cost) for each in experiment.planned] == [
        (5, "sad"),
        (5, "ssd"),
        (9, "sad"),
        (9, "ssd"),
    ]
    assert {(each.trial.seed, each.trial.matching.subpixel) for each in experiment.planned} == {(9, "none")}


def test_dry_run(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", str(small), "--axis", "view_2.baseline_m=0.2,0.3", "--dry-run", "--out", str(tmp_path / "no")]
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("small: 4 trials, 3 distinct renders, about ")
    assert not (tmp_path / "no").exists()


def test_who_had_the_law_tested_unasked_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axes = "[axes]\n'view_2.baseline_m' = [0.2, 0.3, 0.4]\n"
    for key, told in (("", True), ("law = false\n", False), ("law = true\n", False)):
        file = write_small(tmp_path / "e.toml", axes)
        file.write_text(key + file.read_text())
        assert main(["run", str(file), "--dry-run"]) == 0
        assert ("the law is not tested; `law = true`" in capsys.readouterr().err) == told


def test_a_law_that_cannot_be_tested_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_small(tmp_path / "e.toml")
    file.write_text("law = true\n" + file.read_text(encoding="utf-8"), encoding="utf-8")
    for axis, told in (("0.5", True), ("0.25,0.5,1", False)):
        assert main(["run", str(file), "--axis", f"view_2.baseline_m={axis}", "--dry-run"]) == 0
        assert ("law: the law cannot be tested with 1 baseline; it takes 3" in capsys.readouterr().err) == told


def test_dry_run_says_what_would_hardly_be_seen(capsys: pytest.CaptureFixture[str]) -> None:
    """The mirror's focal length gives an equirectangular image 60 degrees of azimuth: a sixth of the panorama."""
    assert main(["run", "paper", "--dry-run", "--set", "sensor.model.kind=equirectangular"]) == 0
    assert "only 7.2% of the panorama is on the image; see trial.sensor.camera.focal_px" in capsys.readouterr().err
    assert main(["run", "paper", "--dry-run", "--set", "sensor.camera.focal_px=1e6"]) == 0
    assert "no pixel of the image falls on the panorama" in capsys.readouterr().err


@pytest.mark.slow
def test_set_and_axis_are_folded_into_what_is_written(small: Path, tmp_path: Path) -> None:
    changed = ("--set", "noise.sigma_grey=3", "--axis", "matching.window_px=5,9")
    one, two = tmp_path / "one", tmp_path / "two"
    run_here(small, *changed, "--out", one, "--no-report")
    run_here(one / "experiment.toml", "--out", two, "--no-report")
    assert (one / "trials.csv").read_bytes() == (two / "trials.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_no_report_of_other_trials_stands_beside_new_tables(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    run_here(small, "--out", out)
    before = {name: (out / name).read_bytes() for name in OF_ALL_ROWS}
    capsys.readouterr()
    run_here(small, "--out", out, "--no-report")
    assert {name: (out / name).read_bytes() for name in OF_ALL_ROWS} == before  # they are of these trials
    assert "removed" not in capsys.readouterr().out
    (out / "environment.json").write_text("a note")
    run_here(small, "--set", "noise.sigma_grey=3", "--out", out, "--no-report")
    assert capsys.readouterr().out.splitlines()[-2:] == [
        f"removed from {out}: summary.json and report.html of earlier trials",
        f"still in {out} of earlier trials: environment.json",
    ]
    assert sorted(path.name for path in out.iterdir() if path.name in OF_ALL_ROWS) == ["environment.json"]
    assert main(["report", str(out)]) == 0
    assert all((out / name).is_file() for name in OF_ALL_ROWS)


# --- What is refused -----------------------------------------------------------------------------------------------


def test_an_unknown_experiment_is_answered_with_those_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(capsys, "run", "papre")
    start = "papre: no such experiment; did you mean 'paper'? Otherwise give the path of a TOML file or one of"
    assert said.startswith(start)
    assert all(name in said for name in shipped.names("experiments"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "box"], "box: no such experiment; it is a scene: see `omnirange render`"),
        (
            ["render", "paper", "--at", 0, 0, 1, "--out", "x"],
            "paper: no such scene; it is an experiment: `",
        ),
        (["rnu", "paper"], "unknown command 'rnu'; did you mean 'run'?"),
        (["completion", "bsh"], "shell: unknown 'bsh'; did you mean 'bash'?"),
    ],
)
def test_what_was_meant_is_said(arguments: list[object], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):  # the parser's
        main([str(each) for each in arguments])
    assert capsys.readouterr().err.removeprefix("omnirange: ").startswith(expected)


@pytest.mark.parametrize("arguments", [[], ["list"]])
def test_all_that_there_is_has_a_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [*shipped.names("experiments"), *shipped.names("scenes"), *shipped.names("sensors"), *BUILT_IN, *MODELS]
    for name in names:
        line = next(each for each in lines if each.split()[:1] == [name])
        assert len(line.split()) > 2, f"nothing is said of {name}"


@pytest.mark.parametrize(
    ("rest", "said"),
    [
        (
            "[trial.matching]\nwindw_px = 7\n",
            "trial.matching.windw_px: unknown key 'windw_px'; did you mean 'window_px'?",
        ),
        (
            '[axes]\n"matching.windw_px" = [7]\n',
            "axes.matching.windw_px: unknown key 'windw_px'; did you mean 'window_px'?",
        ),
        (
            '[axes]\n"matchin.window_px" = [7]\n',
            "axes.matchin.window_px: unknown key 'matchin'; did you mean 'matching'?",
        ),
        ('[axes]\n"matching.window_px" = [7, "x"]\n', "axes.matching.window_px: must be a whole number; found 'x'"),
        (
            '[axes]\n"matching.window_px" = []\n',
            'axes."matching.window_px": must be a list of at least 1; found a list of 0',
        ),
        ('[axes]\n"matching.window_px" = 7\n', 'axes."matching.window_px": must be a list; found 7'),
        ('[axes]\n"view_2.baseline_m" = [0]\n', "axes.view_2.baseline_m: must be above 0; found 0"),
        (
            '[axes]\n"scene.objects.4.size_m" = [[1, 1, 1]]\n',
            "axes.scene.objects.4.size_m: '4' is no item of a list of 1",
        ),
        ('[axes]\n"seed.a" = [1]\n', "axes.seed.a: there is no key 'a' in 1, which is a plain value"),
        (
            '[axes]\nscene = ["bx"]\n',
            "axes.scene: 'bx': no such scene; did you mean 'box'? Otherwise give the path of a TOML file or one of",
        ),
        ("[axes]\nseed = [1, 2, 1]\n", "axes.seed: has the value 1 twice; leave one out"),
        (
            '[[cases]]\nname = "a"\n"noise.sigma" = 3\n',
            "cases[0].noise.sigma: unknown key 'sigma'; did you mean 'sigma_grey'?",
        ),
        (
            '[[cases]]\nname = "a"\nseed = 2\n[[cases]]\nname = "b"\nseed = -1\n',
            "cases[1].seed: must be at least 0; found -1",
        ),
        (
            '[[cases]]\nname = "a, 1"\nseed = 2\n[[cases]]\nname = "b"\nseed = 2\n',
            'cases[1]: two trials are the same: case = "a, 1", and case = b; remove one',
        ),
        (
            '[axes]\nseed = [1]\n[[cases]]\nname = "a"\nseed = 2\n',
            "cases[0].seed: this key is also an axis; give it only once",
        ),
        ("[[cases]]\n", 'cases[0].name: is missing; give the case a name, such as name = "1280x960, 0.3 m"'),
        ("[[cases]]\nname = 3\n", "cases[0].name: must be text; found 3"),
        ('[[cases]]\nname = " "\n', "cases[0].name: must have 1 to 60 letters in one line, without space at its ends"),
        (f'[[cases]]\nname = "{61 * "x"}"\n', "cases[0].name: must have 1 to 60 letters in one line, without space"),
        ('[[cases]]\nname = "a\\nb"\n', "cases[0].name: must have 1 to 60 letters in one line"),
        (
            '[[cases]]\nname = "a"\nseed = 2\n[[cases]]\nname = "a"\nseed = 3\n',
            "cases[1].name: 'a' is the name of cases[0] too; give each its own",
        ),
    ],
)
def test_a_bad_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str], rest: str, said: str) -> None:
    path = write_small(tmp_path / "bad.toml", rest)
    assert refusal(capsys, "run", path, "--out", tmp_path / "out").startswith(f"{path}: {said}")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["--set", "matching.windw_px=7"],
            "--set: matching.windw_px: unknown key 'windw_px'; did you mean 'window_px'?",
        ),
        (["--set", "matching.window_px=8"], "--set: matching: window_px must be odd"),
        (["--set", "view_2.baseline_m=0"], "--set: view_2.baseline_m: must be above 0; found 0"),
        (["--set", "seed"], "--set: must be written key=value; found 'seed'"),
        (["--set", "seed=x"], "--set: seed: must be a whole number; found 'x'"),
        (["--set", "scene=bx"], "--set: scene: 'bx': no such scene"),
        (["--axis", "matching.windw_px=7,9"], "--axis: matching.windw_px: unknown key 'windw_px'; did you mean"),
        (
            ["--axis", "matching.subpixel=none,parabla"],
            "--axis: matching.subpixel: 'parabla' is not valid; did you mean",
        ),
        (["--axis", "noise.sigma_grey=a,b"], "--axis: noise.sigma_grey: must be a number; found 'a'"),
        (["--axis", "noise.sigma_grey="], "--axis: noise.sigma_grey: give at least one value"),
        (["--dask", "nowhere"], "--dask: no scheduler responds at 'nowhere'; give its address, such as tcp://"),
    ],
)
def test_a_bad_option(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert refusal(capsys, "run", small, "--out", tmp_path / "out", *arguments).startswith(said)


def test_a_case_cannot_be_overruled(tmp_path: Path) -> None:
    path = str(write_small(tmp_path / "e.toml", '[[cases]]\nname = "two"\nseed = 2\n'))
    with pytest.raises(InputError, match=r"--set: seed: cases\[0\] \('two'\) gives this key"):
        load_experiment(path, sets=["seed=3"])
    with pytest.raises(InputError, match=r"--axis: seed: cases\[0\] \('two'\) gives this key"):
        load_experiment(path, axes=["seed=3"])


@pytest.mark.parametrize("workers", ["0", "-1", "two"])
def test_a_bad_number_of_workers(small: Path, capsys: pytest.CaptureFixture[str], workers: str) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(small), "--workers", workers])
    assert exit_.value.code == 2
    assert f"--workers: must be a whole number of at least 1; found '{workers}'" in capsys.readouterr().err


def test_a_file_as_the_output_folder(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("here first")
    assert "cannot be used as the output folder" in refusal(capsys, "run", small, "--out", tmp_path / "out")


@pytest.mark.slow
def test_a_folder_with_another_experiments_run(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    run_here(small, "--out", out, "--no-report")
    capsys.readouterr()
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    other = write_small(tmp_path / "other.toml", name="other")
    said = refusal(capsys, "run", other, "--out", out)
    assert said == f"{out}: holds a run of the experiment 'small', not of 'other'; give another folder with --out"
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_damaged_run(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "run.sqlite").write_text("not a database, but longer than the header of one would be" * 10)
    assert "is not a run of omnirange, or is damaged" in refusal(capsys, "run", small, "--out", out)
    assert "is not a run of omnirange, or is damaged" in refusal(capsys, "report", out)


def test_a_report_of_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(capsys, "report", tmp_path) == f"{tmp_path}: holds no run: there is no run.sqlite in it"


@pytest.mark.slow
def test_two_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = write_small(tmp_path / "long.toml", f"[axes]\nseed = {list(range(200))}\n", name="long")
    out = tmp_path / "out"
    first = begin(tmp_path, "run", small, "--out", out, "--workers", 1, "--no-report")
    wait_for(out)
    assert "another omnirange is using this folder" in refusal(capsys, "run", small, "--out", out)
    first.kill()
    first.communicate()


def test_help_load_nothing_heavy() -> None:
    """Each of these libraries takes longer to load than the answer may take."""
    program = """
import sys
from harness.cli import main
try:
    main(["run", "--help"])
except SystemExit:
    pass
print(sorted({"numpy", "pandas", "matplotlib", "pydantic", "rich", "numba"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "papre", "--debug"]) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (
            "[trial.view_1]\nposition_m = [0, 0, 9]",
            "trial.view_1.position_m: scene box: the view at (0, 0, 9) m is outside",
        ),
        ("[trial.view_2]\nbaseline_m = 4", "trial.view_2: scene box: the view at (4, 0, 1) m is outside"),
    ],
)
def test_views_that_see_nothing_are_the_users_to_mend(tmp_path, settings, says):
    """No trial could be carried out, for one reason: that is bad input, not a sweep with failures."""
    (tmp_path / "own.toml").write_text(f'name = "own"\n[trial]\nscene = "box"\n{settings}\n')
    done = subprocess.run(
        [sys.executable, "-m", "harness", "run", "own.toml", "--out", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"omnirange: own.toml: {says}")
    assert done.stderr.count("\n") == 1


def test_an_axis_over_matchers_drops_axes_that_one_of_them_does_not_know():
    planned = load_experiment("paper", axes=["matching.kind=window,slanted"]).planned
    assert [each.coordinates["matching.kind"] for each in planned] == ["window", "slanted"] * 12
    assert all("matching.subpixel" not in each.coordinates for each in planned)
    both = load_experiment("paper", axes=["matching.kind=window,column"]).planned
    assert len(both) == 4 * 12  # both know the axis over sub-pixel steps


def test_details_keep_to_what_a_matcher_takes():
    """The base trial's window settings are for `window`; `column` does not take all of them."""
    from harness.runs.details import with_method

    base = load_experiment("paper", sets=["matching.sampling=alpha", "matching.pitch_px=0.7"]).planned[0].trial
    other = load_experiment("paper", sets=["matching.kind=column"]).planned[0].trial
    assert with_method(base, other).matching == other.matching
    finer = load_experiment("paper", sets=["matching.window_px=7"]).planned[0].trial
    assert with_method(finer, other).matching == other.matching.model_copy(update={"window_px": 7})
