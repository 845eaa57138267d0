"""Matchers from elsewhere: how they are found and refused, what they get, may answer, and what a run keeps."""

import csv
import importlib
import itertools
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sweeps import omnirange, rows, write_small

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching import plugins, registry
from harness.matching.interface import Matches, Reason, as_matches, faults
from harness.matching.pair import Pair
from harness.matching.registry import Plugin
from harness.runs.load import load_experiment, load_matcher
from harness.runs.worker import run_here

FAR = """
import numpy as np

def match(pair, limits, *, window=5, share=1.0):
    return pair.alpha_1 + share * window * 0.01 * np.sin(pair.alpha_1)
"""
"""A matcher that always answers, with what its parameters say."""

Write = Callable[[str], str]
names = (f"mine_{number}" for number in itertools.count())


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes a module that can be imported, and gives its name: a new one each time, as modules are loaded once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def write(source: str) -> str:
        name = next(names)
        (tmp_path / f"{name}.py").write_text(source, encoding="utf-8")
        return name

    return write


@pytest.fixture
def pair() -> Pair:
    sensor = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    draws = np.random.default_rng(1)
    images = [draws.uniform(0, 255, (120, 160)).astype(np.float32) for _ in (1, 2)]
    motion = relative_motion(Pose(), Pose(position_m=(0.3, 0.1, 0.05), yaw_deg=20))
    return Pair((images[0], images[1]), (sensor, sensor), motion, Grid(width_px=60, height_px=16))


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    assert (code, said.out, said.err.count("\n")) == (2, "", 1)
    return said.err.removeprefix("omnirange: ").strip()


# --- Found, or refused before anything is run ---------------------------------------------------------------------


def test_chosen_in_any_experiment_with_parameters_as_axes(module: Write) -> None:
    """The paper's axes over window settings go: another matcher has none."""
    name = module(FAR)
    experiment = load_experiment(
        "paper", sets=[f"matching.kind={name}:match"], axes=["matching.parameters.window=5,7", "seed=1,2"]
    )
    assert [each.coordinates for each in experiment.planned] == [
        {"matching.parameters.window": window, "seed": seed} for window in (5, 7) for seed in (1, 2)
    ]
    matcher = experiment.planned[-1].trial.matching
    assert isinstance(matcher, Plugin)
    assert (matcher.kind, matcher.parameters, matcher.d_max_m) == (f"{name}:match", {"window": 7}, 10.0)


def test_what_the_next_matcher_knows_is_carried_over(module: Write) -> None:
    one = module(FAR)
    other = module("def match(pair, limits, *, share): ...")
    table = {"kind": f"{one}:match", "d_min_m": 2.0, "parameters": {"window": 3, "share": 0.5}}
    assert registry.carried_over(table, f"{other}:match") == {
        "kind": f"{other}:match",
        "d_min_m": 2.0,
        "parameters": {"share": 0.5},
    }
    assert registry.carried_over(table, "window") == {"kind": "window", "d_min_m": 2.0}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            ["matching.kind=windw"],
            "--set: matching.kind: 'windw' is neither a matcher nor written package.module:functi",
        ),
        (["matching.kind=no_such:f"], "--set: matching.kind: no_such:f: there is no module no_such, neither installed"),
        (["matching.kind={name}:mach"], "--set: matching.kind: {name}:mach: the module {name} ("),
        (["matching.kind={name}:np"], "--set: matching.kind: {name}:np: is a module, not a function"),
        (
            ["matching.kind={name}:match", "matching.parameters.windw=3"],
            "--set: matching.parameters.windw: {name}:match takes no parameter 'windw'; did you mean 'window'?",
        ),
        (
            ["matching.kind={name}:one_argument"],
            "--set: matching.kind: {name}:one_argument must take (pair, limits, **par",
        ),
        (
            ["matching.kind={name}:demanding"],
            "{small}: trial.matching.parameters: {name}:demanding needs the parameter 'a",
        ),
        (
            ["matching.kind={name}:demanding", "matching.parameters.a_file=none.bin"],
            "--set: matching.parameters.a_file: no such file: ",
        ),
    ],
)
def test_refused_before_a_run(
    settings: list[str], said: str, module: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = module(FAR + "def one_argument(pair): ...\ndef demanding(pair, limits, a_file): ...\n")
    small = write_small(tmp_path / "small.toml")
    arguments = [part for each in settings for part in ("--set", each.format(name=name))]
    line = refusal(capsys, "run", small, "--out", tmp_path / "out", *arguments)
    assert line.startswith(said.format(name=name, small=small))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("rest", "where"),
    [
        ('[trial.matching]\nkind = "absent:f"', "{file}: trial.matching.kind: absent:f: there is no module absent"),
        (
            '[axes]\n"matching.kind" = ["window", "absent:f"]',
            "{file}: axes.matching.kind: absent:f: there is no module",
        ),
        (
            '[[cases]]\n"matching.kind" = "absent:f"',
            "{file}: cases[0].matching.kind: absent:f: there is no module abse",
        ),
    ],
)
def test_the_place_in_the_file_is_named(
    rest: str, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_small(tmp_path / "small.toml", rest)
    assert refusal(capsys, "run", file, "--out", tmp_path / "out").startswith(where.format(file=file))


def test_an_axis_is_named(module: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, file = module(FAR), write_small(tmp_path / "small.toml")
    chosen = ["--set", f"matching.kind={name}:match", "--axis", "matching.parameters.windw=3,5"]
    line = refusal(capsys, "run", file, "--out", tmp_path / "out", *chosen)
    assert line.startswith(f"--axis: matching.parameters.windw: {name}:match takes no parameter 'windw'")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("import not_there_at_all", "needs not_there_at_all, which is not installed"),
        ("1 / 0", "fails: ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", "fails: SystemExit: 3"),
        ("def f(:", "fails: SyntaxError: invalid syntax"),
    ],
)
def test_a_module_that_cannot_be_loaded(source: str, said: str, module: Write) -> None:
    name = module(source)
    with pytest.raises(InputError) as caught:
        plugins.find(f"{name}:f")
    assert said in str(caught.value)


def test_the_running_script_is_no_module() -> None:
    with pytest.raises(InputError, match="must lie in a module of its own"):
        plugins.find("__main__:f")


def test_functions_that_do_not_say_what_they_take(module: Write) -> None:
    name = module(
        "def anything(*given, **more): ...\nclass Caller:\n    def __call__(self, pair, limits, a=1): ...\nc = Caller()"
    )
    plugins.check(f"{name}:anything", {"whatever": 1})
    plugins.check(f"{name}:c", {"a": 1})
    with pytest.raises(InputError, match="takes no parameter 'b'"):
        plugins.check(f"{name}:c", {"b": 1})


def test_settings_are_told_apart_by_their_parameters() -> None:
    one = Plugin(kind="a:f", parameters={"x": 1, "y": [1, {"z": "w"}]})
    same = Plugin(kind="a:f", parameters={"y": [1, {"z": "w"}], "x": 1})
    assert one == same
    assert hash(one) == hash(same)
    assert one != Plugin(kind="a:f", parameters={"x": 2})


def test_entry_points_of_installed_packages(module: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint

    name = module(FAR)
    offered = {"sweep": EntryPoint("sweep", f"{name}:match", plugins.ENTRY_POINTS)}
    monkeypatch.setattr(plugins, "entry_points", lambda: offered)
    assert load_matcher("sweep", parameters={"window": 3}) == Plugin(kind="sweep", parameters={"window": 3})
    assert plugins.digest("sweep", {}) == plugins.digest(f"{name}:match", {})
    with pytest.raises(InputError, match="did you mean 'sweep'"):
        load_matcher("sweeb")


# --- What an author gets ------------------------------------------------------------------------------------------


def test_nothing_that_a_matcher_is_given_can_be_written_to(pair: Pair) -> None:
    given = [*pair.images, pair.motion.R_v2_from_v1, pair.t_v1, pair.directions]
    for panorama in (*pair.panoramas(), *pair.filtered()):
        given += [panorama.values, panorama.valid]
    for array in given:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_the_arrays_of_whoever_made_the_pair_stay_theirs(pair: Pair) -> None:
    image, t = np.zeros((120, 160), np.float32), np.array([0.3, 0.0, 0.0])
    made = replace(pair, images=(image, image), motion=Motion(np.eye(3), t))
    image[0, 0] = t[0] = 7
    assert made.images[0][0, 0] == 0
    assert made.t_v1[0] == 0.3


def test_panoramas_are_made_when_asked_for_and_once(pair: Pair) -> None:
    asked: list[str] = []
    share = pair.share

    def counting(stage, key, make):
        return share(stage, key, lambda: asked.append(stage) or make())

    counted = replace(pair, share=counting)
    assert asked == []
    assert counted.filtered()[0] is counted.filtered()[0]
    assert counted.panoramas()[1] is counted.panoramas()[1]
    assert asked == ["unwrap", "unwrap", "filter", "filter"]
    counted.filtered(2.0)
    assert asked[4:] == ["filter", "filter"]


def test_pixel_directions_and_angles(pair: Pair) -> None:
    """phi and z by hand for one pixel: column 14 of 60 is centred at -93°, row 3 of 16 at 3.5 pitches."""
    phi, z = np.radians(-180 + 14.5 * 6), 0.34 - 3.5 * (0.34 + 1.4053) / 16
    x = np.array([np.cos(phi), np.sin(phi), z]) / np.sqrt(1 + z**2)
    np.testing.assert_allclose(pair.directions[3, 14], x, atol=1e-15)  # a few roundings of numbers below 1
    cosine = x @ pair.t_v1 / np.linalg.norm(pair.t_v1)
    np.testing.assert_allclose(pair.alpha_1[3, 14], np.arccos(cosine), atol=1e-14)  # far from 0, where arccos is good


def test_two_matchers_with_the_same_words_share_nothing(pair: Pair) -> None:
    mine, yours = replace(pair, owner="mine:f"), replace(pair, owner="yours:f")
    assert mine.shared("costs", (5,), lambda: "mine") == "mine"
    assert yours.shared("costs", (5,), lambda: "yours") == "yours"
    assert mine.shared("costs", (5,), lambda: "again") == "mine"


def test_parameters_are_the_matchers_to_change(module: Write, pair: Pair) -> None:
    name = module("def f(pair, limits, some):\n    some.append(4)\n    return pair.alpha_1 + 0.001 * len(some)\n")
    matcher = Plugin(kind=f"{name}:f", parameters={"some": [1]})
    first, second = (matcher.match(pair).alpha_2 for _ in (1, 2))
    np.testing.assert_array_equal(first, second)
    assert matcher.parameters == {"some": [1]}


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise ValueError('what now')", "fails: ValueError: what now ("),
        ("raise SystemExit", "fails: SystemExit"),
        ("pair.images[0][0] = 1", "a pair's arrays are everybody's: change a copy"),
        ("return 3", "must return alpha_2 as an array, a pair (alpha_2, confidence) or Matches; it returned int"),
    ],
)
def test_a_matcher_that_fails(body: str, said: str, module: Write, pair: Pair) -> None:
    name = module(f"def f(pair, limits):\n    {body}\n")
    with pytest.raises(InputError) as caught:
        Plugin(kind=f"{name}:f").match(pair)
    assert str(caught.value).startswith(f"{name}:f: ")
    assert said in str(caught.value)
    if "what now" in said:
        assert f"{name}.py, line 2)" in str(caught.value)


# --- What may be answered -----------------------------------------------------------------------------------------

GRID = Grid(width_px=16, height_px=4)
GOOD = np.full(GRID.shape, 1.5)
HALF = np.where(np.arange(16) < 8, GOOD, np.nan)
CODES = np.where(np.isnan(HALF), 6, 0)


def with_one(value: float, base: np.ndarray = GOOD) -> np.ndarray:
    changed = base.copy()
    changed[1, 3] = value
    return changed


@pytest.mark.parametrize(
    "answer",
    [
        GOOD,
        GOOD.astype(np.float32),
        HALF,
        (HALF, HALF),
        Matches(HALF, confidence=-HALF, sigma_alpha_2=HALF / 100),
        Matches(HALF, reason=CODES, refined=CODES == 0, k=HALF),
        Matches(HALF, (HALF * 10) // 1, reason=CODES.astype(np.uint8)),
    ],
)
def test_good_answers_are_copied(answer: object) -> None:
    assert not list(faults(answer, GRID))
    matches = as_matches(answer, GRID, "mine")
    given = answer[0] if isinstance(answer, tuple) else getattr(answer, "alpha_2", answer)
    np.testing.assert_array_equal(matches.alpha_2, given)
    assert matches.alpha_2.dtype == np.float64
    assert not np.shares_memory(matches.alpha_2, given)
    assert not matches.alpha_2.flags.writeable
    np.testing.assert_array_equal(matches.reasons == Reason.MATCHED, ~np.isnan(given))


@pytest.mark.parametrize(
    ("answer", "rule", "said"),
    [
        (
            None,
            "form",
            "must return alpha_2 as an array, a pair (alpha_2, confidence) or Matches; it returned NoneType",
        ),
        ([GOOD, GOOD], "form", "it returned list"),
        ((GOOD, GOOD, GOOD), "form", "it returned tuple"),
        (Matches(None), "form", "alpha_2 is missing"),
        (Matches(GOOD.tolist()), "form", "alpha_2 must be a NumPy array; it is list"),
        (np.ma.masked_array(GOOD), "form", "alpha_2 must be a plain array with NaN where there is no match"),
        (GOOD[:3], "shape", "alpha_2 must have the panorama's shape (4, 16); it has (3, 16)"),
        ((GOOD, GOOD.T), "shape", "confidence must have the panorama's shape (4, 16); it has (16, 4)"),
        (GOOD > 0, "dtype", "alpha_2 must be an array of real numbers; its dtype is bool"),
        (GOOD + 0j, "dtype", "its dtype is complex128"),
        (GOOD.astype(object), "dtype", "its dtype is object"),
        (
            with_one(np.inf),
            "angles",
            "alpha_2 must lie within 0 .. pi radians, or be NaN for no match; it is inf at [1, 3]",
        ),
        (with_one(-0.1), "angles", "it is -0.1 at [1, 3]"),
        (np.degrees(GOOD), "angles", "it is 85.9437 at [0, 0], and wrong at 64 pixels in all"),
        ((GOOD, with_one(np.nan)), "missing", "confidence must be finite where there is a match; it is nan at [1, 3]"),
        ((GOOD, with_one(np.inf)), "missing", "confidence must be finite where there is a match; it is inf at [1, 3]"),
        (
            (HALF, GOOD),
            "missing",
            "confidence must be NaN where there is no match; it is 1.5 at [0, 8], and wrong at 32",
        ),
        (Matches(HALF, sigma_alpha_2=GOOD), "missing", "sigma_alpha_2 must be NaN where there is no match"),
        (Matches(GOOD, sigma_alpha_2=with_one(0)), "angles", "sigma_alpha_2 must be above zero; it is 0 at [1, 3]"),
        (Matches(HALF, k=GOOD), "missing", "k must be NaN where there is no match"),
        (Matches(HALF, reason=CODES + 3), "missing", "reason must be one of 0 .. "),
        (
            Matches(GOOD, reason=CODES),
            "missing",
            "reason must be 0 (matched) exactly where alpha_2 is not NaN; it is 6 at",
        ),
        (Matches(HALF, reason=HALF), "dtype", "reason must be an array of whole numbers; its dtype is float64"),
        (
            Matches(HALF, refined=GOOD > 0),
            "missing",
            "refined must be false where there is no match; it is True at [0, 8]",
        ),
        (Matches(HALF, refined=CODES), "dtype", "refined must be an array of booleans"),
    ],
)
def test_bad_answers_are_refused_in_words(answer: object, rule: str, said: str) -> None:
    found = list(faults(answer, GRID))
    assert said in found[0].text
    assert found[0].rule == rule
    with pytest.raises(InputError) as caught:
        as_matches(answer, GRID, "mine:f")
    assert str(caught.value) == f"mine:f: {found[0].text}"


# --- Known again by its source ------------------------------------------------------------------------------------


def digest(kind: str, folder: Path) -> str:
    """In a process of its own, as each run is; and without a module of the matcher being loaded."""
    program = (
        "import sys; from harness.matching import plugins; before = set(sys.modules); "
        f"print(plugins.digest({kind!r}, {{}})); "
        "sys.exit([each for each in set(sys.modules) - before if each.startswith(('top', 'beside', 'pack.'))])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)
    assert done.stderr.strip() in {"", "[]"}
    return done.stdout.strip()


@pytest.mark.slow
def test_a_change_of_source_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "top.py").write_text("def f(pair, limits):\n    import beside\n    return beside.g(pair)\n")
    (tmp_path / "beside.py").write_text("import scipy.optimize\nfrom pack.inner import h as g\n")
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").touch()
    (tmp_path / "pack" / "inner.py").write_text("from . import other\n")
    (tmp_path / "pack" / "other.py").write_text("x = 1\n")
    (tmp_path / "stranger.py").write_text("x = 1\n")
    before = digest("top:f", tmp_path)
    (tmp_path / "stranger.py").write_text("x = 2\n")
    assert digest("top:f", tmp_path) == before
    for changed in ("top.py", "beside.py", "pack/inner.py", "pack/other.py"):
        with (tmp_path / changed).open("a") as file:
            file.write("# changed\n")
        after = digest("top:f", tmp_path)
        assert after != before, changed
        before = after


def test_files_in_parameters_count_by_their_contents(module: Write, tmp_path: Path) -> None:
    kind = f"{module('def f(pair, limits, weights_file, name): ...')}:f"
    (tmp_path / "weights.bin").write_bytes(b"one")
    (tmp_path / "copy.bin").write_bytes(b"one")

    def told(file: str) -> str:
        return plugins.digest(kind, {"weights_file": str(tmp_path / file), "name": file})

    one = told("weights.bin")
    assert told("copy.bin") == one
    (tmp_path / "weights.bin").write_bytes(b"other")
    assert told("weights.bin") != one


def test_files_in_parameters_lie_beside_the_experiment(module: Write, tmp_path: Path) -> None:
    kind = f"{module('def f(pair, limits, weights_file, name): ...')}:f"
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "w.bin").touch()
    matching = f'[trial.matching]\nkind = "{kind}"\nparameters = {{ weights_file = "w.bin", name = "w.bin" }}\n'
    trial = load_experiment(str(write_small(tmp_path / "deep" / "e.toml", matching))).trial
    assert trial.matching.parameters == {"weights_file": str(tmp_path / "deep" / "w.bin"), "name": "w.bin"}


def test_a_matcher_of_this_program_has_no_fingerprint() -> None:
    assert load_matcher("window").identity() == ""


# --- Whole runs ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_edited_matcher_is_another_one(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FAR)
    write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2]\n")
    run = ("run", "small.toml", "--set", "matching.kind=mine:match", "--out", "out", "--no-report")
    first = omnirange(tmp_path, *run, "--workers", 2)  # which have to find the module too
    assert first.returncode == 0, first.stderr
    assert "2 of 2 trials run" in first.stdout
    before = (tmp_path / "out" / "trials.csv").read_text()
    (tmp_path / "mine.py").write_text(FAR.replace("0.01", "0.02"))
    second = omnirange(tmp_path, *run)
    assert second.returncode == 0, second.stderr
    assert "2 trials in this folder were made with other settings: they are set aside" in second.stdout
    after = (tmp_path / "out" / "trials.csv").read_text()
    assert after != before
    (tmp_path / "mine.py").write_text(FAR)
    assert omnirange(tmp_path, *run).returncode == 0
    assert len(rows(tmp_path / "out")) == 4  # those of the first are found again
    assert (tmp_path / "out" / "trials.csv").read_text() == before


@pytest.mark.slow
def test_a_failure_is_one_trials_alone(tmp_path: Path) -> None:
    source = FAR.replace("    return", "    if window == 7:\n        raise ValueError('seven')\n    return")
    (tmp_path / "mine.py").write_text(source)
    write_small(tmp_path / "small.toml", '[axes]\n"matching.parameters.window" = [5, 7, 9]\n')
    done = omnirange(tmp_path, "run", "small.toml", "--set", "matching.kind=mine:match", "--out", "out", "--no-report")
    assert done.returncode == 1
    assert "1 of 3 trials failed" in done.stderr
    with (tmp_path / "out" / "failures.csv").open() as file:
        (failure,) = csv.DictReader(file)
    assert failure["matching.parameters.window"] == "7"
    assert failure["message"].startswith("mine:match: fails: ValueError: seven (")
    assert "mine.py, line 6)" in failure["message"]
    assert "raise ValueError('seven')" in failure["traceback"]


@pytest.mark.slow
def test_on_a_cluster_whose_worker_has_it_in_its_folder(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    from test_dask import end, free_port, start, wait_for_workers

    (tmp_path / "mine.py").write_text(FAR)
    write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2]\n")
    run = ("run", "small.toml", "--set", "matching.kind=mine:match", "--no-report", "--out")
    address = f"tcp://127.0.0.1:{free_port()}"
    scheduler = ("--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard")
    options = ("--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1", "--no-nanny")
    with ExitStack() as ends:
        ends.callback(end, start(tmp_path, "scheduler", "scheduler", *scheduler))
        ends.callback(end, start(tmp_path, "worker", "worker", address, *options))
        shutil.copy(tmp_path / "mine.py", tmp_path / "worker" / "mine.py")
        wait_for_workers(address, 1)
        there = omnirange(tmp_path, *run, "there", "--dask", address)
    assert there.returncode == 0, there.stderr
    assert omnirange(tmp_path, *run, "here").returncode == 0
    assert (tmp_path / "there" / "trials.csv").read_bytes() == (tmp_path / "here" / "trials.csv").read_bytes()


@pytest.mark.slow
def test_beside_a_matcher_of_this_program(module: Write) -> None:
    kind = f"{module(FAR)}:match"
    experiment = load_experiment("smoke", sets=[f"matching.kind={kind}"], axes=[f"matching.kind=column,{kind}"])
    first = {each.trial.matching.kind: each.trial for each in reversed(experiment.planned)}
    column, mine = (run_here(first[each]) for each in ("column", kind))
    np.testing.assert_array_equal(column.pair.images[0], mine.pair.images[0])
    np.testing.assert_array_equal(mine.matches.alpha_2, mine.pair.alpha_1 + 0.05 * np.sin(mine.pair.alpha_1))
    assert not np.array_equal(column.matches.alpha_2, mine.matches.alpha_2)


def _module(folder: Path, monkeypatch: pytest.MonkeyPatch, content: str) -> str:
    """A new module in the current folder."""
    name = f"edited_{abs(hash(folder)):x}"
    (folder / f"{name}.py").write_text(content)
    monkeypatch.chdir(folder)
    return name


def test_a_module_edited_after_it_was_loaded_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = _module(tmp_path, monkeypatch, "def f(pair, limits): return 1\n")
    matcher = load_matcher(f"{name}:f")
    before = matcher.identity()
    assert matcher.identity() == before
    (tmp_path / f"{name}.py").write_text("def f(pair, limits): return 2\n")  # of the same size, within the same second
    with pytest.raises(InputError, match="has been changed since it was loaded; start the session again"):
        matcher.identity()
    importlib.invalidate_caches()
    sys.dont_write_bytecode, kept = True, sys.dont_write_bytecode
    importlib.reload(sys.modules[name])
    sys.dont_write_bytecode = kept
    assert matcher.identity() != before


def test_a_helper_edited_after_it_was_loaded_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / f"helper_{abs(hash(tmp_path)):x}.py").write_text("a = 1\n")
    name = _module(tmp_path, monkeypatch, f"import helper_{abs(hash(tmp_path)):x}\ndef f(pair, limits): ...\n")
    matcher = load_matcher(f"{name}:f")
    (tmp_path / f"helper_{abs(hash(tmp_path)):x}.py").write_text("a = 2\n")
    with pytest.raises(InputError, match="has been changed since it was loaded"):
        matcher.identity()


def test_data_of_a_package_counts_and_needs_no_new_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"packed_{abs(hash(tmp_path)):x}"
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("def f(pair, limits): ...\n")
    (tmp_path / name / "weights.bin").write_text("1")
    monkeypatch.chdir(tmp_path)
    matcher = load_matcher(f"{name}:f")
    before = matcher.identity()
    (tmp_path / name / "weights.bin").write_text("2")
    assert matcher.identity() != before
