"""`import harness`: what it offers, that it costs nothing until it is used, and that its examples are true."""

import ast
import doctest
import importlib
import inspect
import io
import pydoc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sweeps import write_small

import harness
from harness.api import progress as progress_module
from harness.api import results as results_module
from harness.api.progress import Progress
from harness.errors import InputError
from harness.pipeline.maps import maps_file, maps_of
from harness.pipeline.trial import run_trial
from harness.runs.store import Finished

HEAVY = ("numpy", "numba", "pandas", "matplotlib", "trimesh", "scipy", "pydantic", "rich", "jinja2", "PIL", "cv2")
DOCUMENTED = [
    pytest.param("harness", marks=pytest.mark.slow),
    "harness.api.datasets",
    "harness.api.loading",
    pytest.param("harness.api.motion", marks=pytest.mark.slow),
    "harness.api.ranging",
    "harness.api.results",
    "harness.api.running",
]
DOCUMENTED += ["harness.api.settings", "harness.api.views", "harness.api.warping"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rest = '[axes]\nseed = [1, 2]\n"noise.sigma_grey" = [0.0, 4.0]\n'
    return write_small(tmp_path_factory.mktemp("api") / "small.toml", rest)


@pytest.fixture(scope="module")
def result(small: Path, tmp_path_factory: pytest.TempPathFactory) -> "harness.RunResult":
    return harness.run(small, out=tmp_path_factory.mktemp("run"), workers=1, keep_arrays=True)


# --- Names --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", ["import harness", "from harness.cli import main; main(['--help'])"])
def test_nothing_heavy_is_loaded_before_it_is_used(code: str) -> None:
    look = f"{code.replace(chr(10), ';')}"
    script = (
        f"import sys\ntry:\n    {look}\nexcept SystemExit: pass\n"
        f"print(*[each for each in {HEAVY} if each in sys.modules], file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert ran.stderr.strip() == ""


def test_every_public_name_is_there_and_documented() -> None:
    assert dir(harness) == sorted(harness.__all__)
    assert set(harness._HOME) | {"__version__"} == set(harness.__all__)
    for name in harness._HOME:
        offered = getattr(harness, name)
        assert inspect.getdoc(offered), name
        assert getattr(harness, name) is offered
    with pytest.raises(AttributeError, match="module 'harness' has no attribute 'rnu'"):
        harness.rnu  # noqa: B018


def test_tools_that_do_not_run_the_code_see_the_same_names() -> None:
    tree = ast.parse(inspect.getsource(harness))
    imported = {
        f"{node.module}.{each.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("harness.")
        for each in node.names
    }
    assert imported == {f"harness.{home}.{name}" for name, home in harness._HOME.items()} | {
        "harness.version.__version__"
    }


def test_help_is_a_tour() -> None:
    text = pydoc.render_doc(harness, renderer=pydoc.plaintext)
    assert text.index("A tour") < text.index("What there is")
    tour = harness.__doc__ or ""
    assert all(name in tour for name in harness.__all__ if name != "__version__")
    about = pydoc.render_doc(harness.Sensor, renderer=pydoc.plaintext)
    assert "model_" not in about
    assert "__pydantic" not in about


@pytest.mark.slow
@pytest.mark.parametrize("name", DOCUMENTED)
@pytest.mark.usefixtures("undrawn")
def test_examples_are_true(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


def test_functions_say_what_they_take_give_and_raise() -> None:
    functions = [getattr(harness, name) for name in harness._HOME if inspect.isfunction(getattr(harness, name))]
    own = [each for each in functions if each.__module__.startswith("harness.api")]
    assert len(own) == 21
    for each in own:
        doc = inspect.getdoc(each)
        for section in ("Parameters", "Returns", "Raises", "Examples"):
            assert f"{section}\n{'-' * len(section)}\n" in doc, each.__name__
        for parameter in inspect.signature(each).parameters:
            assert parameter in doc, (each.__name__, parameter)


# --- Experiments ----------------------------------------------------------------------------------------------------


def test_an_experiment_comes_from_a_name_a_path_a_table_or_an_object(small: Path) -> None:
    one = harness.load_experiment(small)
    table = {"name": "small", "trial": one.trial.model_dump(mode="json"), "axes": one.axes}
    keys = [each.key for each in one.planned]
    for source in (str(small), table, one):
        assert [each.key for each in harness.load_experiment(source).planned] == keys
    changed = harness.load_experiment(one, axes={"seed": np.arange(3)}, sets={"noise.sigma_grey": np.float64(2.5)})
    assert one.model_copy(update={"axes": {"seed": [7]}}).planned[0].trial.seed == 7  # not what `one` had planned
    assert [each.trial.seed for each in changed.planned] == [0, 1, 2]
    assert {each.trial.noise.sigma_grey for each in changed.planned} == {2.5}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"axes": {"seed": 3}}, "axes: seed: must be a list of values; found 3"),
        ({"axes": {"seed": "12"}}, "axes: seed: must be a list of values; found '12'"),
        ({"axes": {"sed": [3]}}, "axes: sed: unknown key 'sed'; did you mean 'seed'?"),
        ({"axes": {"matching.window_px": [4]}}, "axes: matching.window_px: window_px must be odd"),
        (
            {"sets": {"matching.plane_px": 3}},
            "sets: matching.plane_px: unknown key 'plane_px'; it is a key of kind 'sgm'",
        ),
        ({"sets": {"trial.seed": 3}}, "sets: trial.seed: begins at the trial; write 'seed'"),
        ({"axes": {"law": [True]}}, "axes: law: is a key of the experiment, not of its trials; write it at the top of"),
        ({"sets": {"matching.windw_px": 3}}, "sets: matching.windw_px: unknown key 'windw_px'; did you mean"),
    ],
)
def test_what_is_wrong_with_an_argument_is_said_in_a_line(small: Path, arguments: dict, said: str) -> None:
    with pytest.raises(InputError) as error:
        harness.load_experiment(small, **arguments)
    assert str(error.value).startswith(said)


def test_a_table_names_its_own_keys() -> None:
    with pytest.raises(InputError, match=r"^trial\.seeds: unknown key 'seeds'; did you mean 'seed'\?$"):
        harness.load_experiment({"name": "x", "trial": {"scene": "box", "seeds": 1}})


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"keep_arrays": True}, "keep_arrays: needs a folder; give out as well"),
        ({"workers": 0}, "workers: must be at least 1; found 0"),
    ],
)
def test_a_run_refuses_what_cannot_be(small: Path, arguments: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        harness.run(small, **arguments)


def test_a_failing_experiment_raises_its_message(small: Path) -> None:
    with pytest.raises(InputError, match="position_m"):
        harness.run(small, sets={"view_1.position_m": [9.0, 0.0, 1.0]})


# --- Results ------------------------------------------------------------------------------------------------------


def test_trials_are_the_table_that_is_written(result: "harness.RunResult") -> None:
    import pandas as pd

    written = pd.read_csv(result.folder / "trials.csv", index_col="key")
    assert list(result.trials.columns) == list(written.columns)
    assert list(result.trials.index) == list(written.index) == [each.key for each in result.experiment.planned]
    assert result.trials["density"].tolist() == written["density"].tolist()
    assert result.trials["noise.sigma_grey"].tolist() == [0.0, 4.0, 0.0, 4.0]
    assert (result.timings["match"] > 0).all()
    assert result.failures.empty


def test_summary_and_settings(result: "harness.RunResult") -> None:
    figures = result._result.summary["comparison"]
    (method,) = figures
    assert result.summary.loc["all", method]["density"] == figures[method]["density"]
    assert result.settings.loc["panorama.width_px"].tolist() == [180, "px"]
    assert result.settings.loc["scene.objects.0.size_m", "unit"] == "m"
    assert result.law is None
    assert result.limit.empty


def test_outcome_is_read_where_it_was_kept_and_computed_where_not(
    result: "harness.RunResult", monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = result.experiment.planned[1].trial
    anew = maps_of(run_trial(trial))
    for asked in (1, trial.key, {"seed": 1, "noise.sigma_grey": 4.0}, -3):
        assert result.outcome(asked).key == trial.key
    with monkeypatch.context() as patch:
        patch.setattr(results_module, "run_here", lambda _: pytest.fail("computed again"))
        assert np.array_equal(result.outcome(1).range_m, anew.range_m, equal_nan=True)
    maps_file(result.folder / "maps", trial.key).unlink()
    assert np.array_equal(result.outcome(1).range_m, anew.range_m, equal_nan=True)
    assert result.outcome().key == result.experiment.planned[0].key


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("0" * 16, "no trial matches"),
        (4, "there is no trial 4: there are 4, the first is 0"),
        ({"seed": 1}, "2 trials match; give more keys"),
        ({"sed": 1}, "'sed' is not a key that varies; those are: seed, noise.sigma_grey"),
    ],
)
def test_an_outcome_that_is_not_one_trial_is_refused(result: "harness.RunResult", asked: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        result.outcome(asked)


def test_results_are_opened_again(result: "harness.RunResult", tmp_path: Path) -> None:
    again = harness.open_results(result.folder)
    assert again.trials.equals(result.trials)
    assert repr(again) == f"RunResult('small', 4 of 4 trials done, in {result.folder})"
    with pytest.raises(InputError, match=r"holds no run: there is no run\.sqlite in it"):
        harness.open_results(tmp_path)
    more = harness.run(result.experiment, axes={"seed": [1, 2, 3]}, out=result.folder, workers=1)
    assert len(more.trials) == 6
    assert list(more.trials.index[:4]) == list(result.trials.index)


def test_a_result_shows_itself_as_a_table(result: "harness.RunResult") -> None:
    shown = result._repr_html_()
    assert shown.count("<tr") == 6  # two of the heading, four trials
    assert "disparity_median_abs_px" in shown


@pytest.mark.long
@pytest.mark.slow
def test_a_report_is_the_one_of_the_command_line(small: Path, tmp_path: Path) -> None:
    from harness.cli import main

    result = harness.run(small, out=tmp_path / "one", workers=1)
    assert result.report() == tmp_path / "one" / "report.html"
    assert main(["run", str(small), "--out", str(tmp_path / "two"), "--workers", "1"]) == 0
    for name in ("summary.json", "trials.csv", "experiment.toml"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    page = harness.run(small).report(tmp_path / "three.html")
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_a_run_in_memory_has_to_be_told_where_to_report(small: Path) -> None:
    with pytest.raises(InputError, match="the run is in memory: give a path for the report"):
        harness.run(small, sets={"seed": 1, "noise.sigma_grey": 0.0}).report()


# --- Progress -----------------------------------------------------------------------------------------------------


def test_progress_is_shown_when_asked_for(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harness.run(small, workers=1)
    assert capsys.readouterr().out == ""  # nobody watches
    harness.run(small, workers=1, progress=True)
    assert capsys.readouterr().out.startswith("small: 4 of 4 trials run, in ")


def test_progress_in_a_notebook_is_one_line_that_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    from rich.console import Console

    monkeypatch.setattr(Console, "is_jupyter", True, raising=False)
    monkeypatch.setattr(progress_module, "_NOTEBOOK_EVERY_S", -1.0)
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stdout", screen)
    real = Console.__init__

    def in_notebook(self: Console, *arguments: object, **options: object) -> None:
        real(self, *arguments, **options)
        self.is_jupyter = True

    monkeypatch.setattr(Console, "__init__", in_notebook)
    assert progress_module.someone_watches()
    with Progress("x", total=2, done=0) as progress:
        progress.update([Finished("a", "s", "done")])
        progress.update([Finished("b", "s", "failed")])
        progress.finish()
    lines = screen.getvalue()
    assert lines.startswith("\rx: 1 of 2 trials, ")
    assert "\rx: 2 of 2 trials, 1 failed" in lines
    assert lines.split("\r")[-1].startswith("x: 2 of 2 trials run, 1 of them failed, in ")
    assert lines.count("\n") == 1


# --- Views and ranging ----------------------------------------------------------------------------------------------

SENSOR = {"camera": {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}}
GRID = harness.Grid(width_px=180, height_px=50)


@pytest.fixture(scope="module")
def views() -> "list[harness.RenderedView]":
    return [harness.render("box", sensor=SENSOR, position_m=(x, 0, 1), samples=4, grid=GRID) for x in (0.0, 0.5)]


def test_a_view_has_the_range_of_the_walls(views: "list[harness.RenderedView]") -> None:
    """Walls at x, y = ±3 m: a ray of azimuth phi meets them at 3/max(|cos phi|, |sin phi|) m, measured level."""
    (view, _) = views
    x, y = np.cos(GRID.phi), np.sin(GRID.phi)
    level = 3 / np.maximum(np.abs(x), np.abs(y))
    row = int(np.argmin(np.abs(GRID.z)))
    exact = level * np.hypot(1, GRID.z[row])
    # Sums and quotients of numbers of size 1 in double precision, and a ray-plane intersection: some 1e-14.
    assert np.allclose(view.panorama_range_m[row], exact, rtol=1e-12)
    assert np.isnan(view.range_m[0, 0])
    assert view.image[0, 0] == 0
    assert repr(view).startswith("RenderedView(image=float32[120, 160], range_m=float64[120, 160]")
    assert view._repr_html_().count("data:image/png") == 2


@pytest.mark.slow
def test_range_from_arrays_and_from_files(views: "list[harness.RenderedView]", tmp_path: Path) -> None:
    from PIL import Image

    eight = [np.rint(view.image).astype(np.uint8) for view in views]
    for name, image in zip(("left.png", "right.png"), eight, strict=True):
        Image.fromarray(image).save(tmp_path / name)
    arguments = (views[0].sensor, (0.5, 0.0, 0.0), {"kind": "column", "window_px": 7})
    one = harness.estimate_range(*eight, *arguments, grid=GRID)
    other = harness.estimate_range(tmp_path / "left.png", str(tmp_path / "right.png"), *arguments, grid=GRID)
    coloured = harness.estimate_range(*(np.repeat(each[..., None], 3, -1) for each in eight), *arguments, grid=GRID)
    sixteen = harness.estimate_range(*(each.astype(np.uint16) * 257 for each in eight), *arguments, grid=GRID)
    assert np.array_equal(one.range_m, other.range_m, equal_nan=True)
    assert np.array_equal(one.range_m, sixteen.range_m, equal_nan=True)
    twelve = harness.estimate_range(*(each.astype(np.uint16) * 16 for each in eight), *arguments, grid=GRID, bits=12)
    # 255 x 16 of 4095 is 0.4 % darker, which sums of absolute differences do not mind but for a match here and there.
    assert np.mean(np.isclose(one.range_m, twelve.range_m, rtol=0.05, equal_nan=True)) > 0.95
    # The weights of red, green and blue add up to 1 but for a rounding of 1e-16, which may shift a grey by an ulp.
    assert np.mean(np.isclose(one.range_m, coloured.range_m, rtol=1e-6, equal_nan=True)) > 0.999
    error_m = np.abs(one.range_m - views[0].panorama_range_m)
    assert np.nanmedian(error_m) < 0.35  # at 180 columns a pixel of disparity is 2 degrees: 0.32 m at 2 m
    assert one._repr_html_().count("data:image/png") == 2


def test_a_motion_may_be_given_in_three_ways(views: "list[harness.RenderedView]") -> None:
    pose = harness.Pose(position_m=(0.5, 0.0, 0.0))
    motions = ((0.5, 0, 0), np.array([0.5, 0, 0]), pose, harness.relative_motion(harness.Pose(), pose))
    images = [view.image for view in views]
    ranges = [harness.estimate_range(*images, SENSOR, each, "column", grid=GRID).range_m for each in motions]
    assert all(np.array_equal(ranges[0], each, equal_nan=True) for each in ranges[1:])


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_estimate_is_written_as_the_command_line_writes_it(
    views: "list[harness.RenderedView]", tmp_path: Path
) -> None:
    images = [view.image for view in views]
    harness.estimate_range(*images, SENSOR, (0.5, 0, 0), "column", grid=GRID).write(tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"range.npy", "sigma_m.npy", "points.ply", "range.html"} <= names


GOOD = np.full((120, 160), 100, dtype=np.uint8)


@pytest.mark.parametrize(
    ("left", "motion", "said"),
    [
        (GOOD[:-1], (0.5, 0, 0), r"left: must have the sensor's shape, \(120, 160\) or \(120, 160, 3\); found \(119"),
        (GOOD.astype(np.int64), (0.5, 0, 0), "left, right: must be of one type; found int64 and uint8"),
        (GOOD.astype(float) + 200, (0.5, 0, 0), "left, right: must be of one type"),
        (GOOD.tolist(), (0.5, 0, 0), "left: must be a path or an array; found list"),
        (GOOD, (0, 0, 0), "motion: the baseline must not be zero"),
        (GOOD, (0.5, 0), "motion: must be a Motion, a Pose or three finite numbers, metres; found"),
        (GOOD, (0.5, 0, np.nan), "motion: must be a Motion, a Pose or three finite numbers"),
        (GOOD, "east", "motion: must be a Motion, a Pose or three finite numbers, metres; found 'east'"),
    ],
)
def test_what_cannot_be_ranged_is_refused_in_a_line(left: object, motion: object, said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        harness.estimate_range(left, GOOD, SENSOR, motion)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (GOOD.astype(np.int64), "must be of type uint8, uint16, or floats of grey levels 0 .. 255; found int64"),
        (GOOD.astype(bool), "found bool"),
        (GOOD / 255.0, "none is above 1; multiply by 255"),
        (GOOD + 200.0, "grey levels must be finite and lie within 0 .. 255"),
        (np.full((120, 160), np.nan), "grey levels must be finite"),
    ],
)
def test_grey_levels_are_never_guessed(image: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        harness.estimate_range(image, image, SENSOR, (0.5, 0, 0))


def test_an_unknown_matcher_is_refused(views: "list[harness.RenderedView]") -> None:
    with pytest.raises(InputError, match="did you mean 'slanted'"):
        harness.estimate_range(*(view.image for view in views), SENSOR, (0.5, 0, 0), "slantd")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"samples": 5}, "samples must be a square number"),
        ({"position_m": (0, 0)}, "position_m: must be a list of 3"),
        ({"position_m": "here"}, "position_m: must be three numbers, metres; found 'here'"),
        ({"yaw_deg": float("nan")}, "yaw_deg: must be a finite number"),
        ({"position_m": (9, 0, 1)}, "outside"),
        ({"sensor": {"camer": {}}}, "sensor: camer: unknown key 'camer'; did you mean 'camera'?"),
    ],
)
def test_a_view_that_cannot_be_is_refused(arguments: dict, said: str) -> None:
    with pytest.raises(InputError) as error:
        harness.render("box", **arguments)
    assert said in str(error.value)
