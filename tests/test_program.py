"""A matcher that is a command: what it is given, what it may write, and that nothing it does harms anything else."""

import csv
import os
import stat
import sys
import time
import tomllib
import uuid
from pathlib import Path

import numpy as np
import psutil
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from sweeps import begin, kill_group, omnirange, write_small

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor, pixel_directions
from harness.errors import InputError
from harness.geometry.panorama import Grid, cylinder
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.io.calibrations.sensors import load_sensor
from harness.io.view_folder import pose_in
from harness.matching import program
from harness.matching.pair import Pair
from harness.matching.program import Program
from harness.runs.load import load_experiment, load_matcher

START = "import sys\nimport numpy as np\nfrom pathlib import Path\nsource, target = map(Path, sys.argv[1:3])\n"
ANSWER = "alpha = np.full((16, 60), 1.5)\nnp.save(target / 'alpha_2.npy', alpha)\n"

angle = st.floats(-180, 180)


@pytest.fixture
def pair() -> Pair:
    sensor = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    draws = np.random.default_rng(1)
    images = [draws.uniform(0, 255, (120, 160)).astype(np.float32) for _ in (1, 2)]
    motion = relative_motion(Pose(), Pose(position_m=(0.3, 0.1, 0.05), yaw_deg=20, pitch_deg=5, roll_deg=-3))
    return Pair((images[0], images[1]), (sensor, sensor), motion, Grid(width_px=60, height_px=16, z_max=0.5), threads=1)


SLEEP = f"61.{uuid.uuid4().int % 10**12:012d}"
"""Seconds that no other process on this machine sleeps, such as one of the same tests in another checkout."""


def python(folder: Path, source: str) -> Program:
    """A program in Python."""
    file = folder / "matcher.py"
    file.write_text(START + source, encoding="utf-8")
    return Program(command=(sys.executable, str(file), "{input}", "{output}"))


def fast(folder: Path, source: str, **settings: object) -> Program:
    """One that begins at once: a shell script, `$1` and `$2` its folders."""
    file = folder / "matcher.sh"
    file.write_text(source, encoding="utf-8")
    return Program(command=("/bin/sh", str(file), "{input}", "{output}"), **settings)


def complaint(pair: Pair, matcher: Program) -> str:
    with pytest.raises(InputError) as caught:
        matcher.match(pair)
    text = str(caught.value)
    assert "\n" not in text
    return text


# --- What it is given ---------------------------------------------------------------------------------------------


@pytest.fixture
def folder(pair: Pair, tmp_path: Path) -> Path:
    command = ("x", "{input}", "{output}")
    matcher = Program(command=command, d_min_m=0.7, parameters={"window": 5, "names": ["a", "b"]})
    program.write_input(pair, matcher, tmp_path)
    return tmp_path


def test_the_folder_holds_both_views_and_no_truth(folder: Path) -> None:
    view = ["omni.npy", "omni.png", "panorama.npy", "panorama.png", "pose.toml", "rays.npy", "sensor.toml"]
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert files == sorted(
        ["README.txt", "limits.toml", "parameters.toml", *(f"view_{i}/{name}" for i in (1, 2) for name in view)]
    )
    readme = (folder / "README.txt").read_text()
    assert all(name in readme for name in (*view, "limits.toml", "alpha_2.npy", "sigma_alpha_2.npy", "confidence.npy"))


def test_images_and_panoramas_are_those_of_the_pair(folder: Path, pair: Pair) -> None:
    for i, panorama in enumerate(pair.panoramas()):
        view = folder / f"view_{i + 1}"
        np.testing.assert_array_equal(np.load(view / "omni.npy"), pair.images[i])
        written = np.load(view / "panorama.npy")
        np.testing.assert_array_equal(np.isnan(written), ~panorama.valid)
        assert not panorama.valid.all()  # so that there is something to leave out
        np.testing.assert_array_equal(written[panorama.valid], panorama.values[panorama.valid])
        rounded = np.asarray(Image.open(view / "panorama.png"), dtype=np.float64)
        assert np.abs(rounded - written)[panorama.valid].max() <= 0.5
        assert load_sensor(view / "sensor.toml") == pair.sensor
        rays, valid = pixel_directions(pair.sensor)
        np.testing.assert_array_equal(np.isfinite(np.load(view / "rays.npy")), np.repeat(valid[..., None], 3, axis=-1))
        np.testing.assert_allclose(np.load(view / "rays.npy")[valid], rays[valid], atol=6e-8)  # float32 below 1


def test_settings_are_toml(folder: Path) -> None:
    assert tomllib.loads((folder / "limits.toml").read_text()) == {"d_min_m": 0.7, "d_max_m": 10.0, "threads": 1}
    assert tomllib.loads((folder / "parameters.toml").read_text()) == {"window": 5, "names": ["a", "b"]}


def test_poses_tell_the_motion_and_the_grid(folder: Path, pair: Pair) -> None:
    one, two = (tomllib.loads((folder / f"view_{i}" / "pose.toml").read_text()) for i in (1, 2))
    assert one["position_m"] == [0, 0, 0]
    assert one["R_world_from_view"] == np.eye(3).tolist()
    np.testing.assert_array_equal(two["position_m"], pair.t_v1)
    np.testing.assert_array_equal(np.array(two["R_world_from_view"]).T, pair.motion.R_v2_from_v1)
    # Twice a few roundings: to angles in degrees, and back.
    turned = Pose(**{key: two[key] for key in ("yaw_deg", "pitch_deg", "roll_deg")}).R_world_from_view
    np.testing.assert_allclose(turned.T, pair.motion.R_v2_from_v1, atol=1e-14)
    grid = one["panorama"]
    assert two["panorama"] == grid
    phi = -np.pi + (7 + 0.5) * 2 * np.pi / grid["width_px"]
    z = grid["z_max"] - (3 + 0.5) * (grid["z_max"] - grid["z_min"]) / grid["height_px"]
    np.testing.assert_allclose([np.cos(phi), np.sin(phi), z], cylinder(pair.grid)[3, 7], atol=1e-15)


@pytest.mark.slow
@given(yaw=angle, pitch=angle, roll=angle)
def test_any_rotation_as_angles(yaw: float, pitch: float, roll: float) -> None:
    """Against scipy's matrices. Near the poles atan2 of two small numbers loses half its digits: 1e-7."""
    R = Pose(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll).R_world_from_view
    pose = pose_in(Motion(R.T, np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose(pose.R_world_from_view, R, atol=1e-7)


@pytest.mark.parametrize("pitch", [90, -90])
def test_looking_straight_up_or_down(pitch: float) -> None:
    R = Pose(yaw_deg=30, pitch_deg=pitch, roll_deg=50).R_world_from_view
    pose = pose_in(Motion(R.T, np.array([1.0, 0.0, 0.0])))
    assert pose.roll_deg == 0
    np.testing.assert_allclose(pose.R_world_from_view, R, atol=1e-9)  # what counts as straight up


# --- What it may write --------------------------------------------------------------------------------------------


def test_arrays_are_read(pair: Pair, tmp_path: Path) -> None:
    more = "alpha[:, 3] = np.nan\nnp.save(target / 'alpha_2.npy', np.asfortranarray(alpha.astype('>f4')))\n"
    more += "np.save(target / 'confidence.npy', alpha * 10)\nnp.save(target / 'sigma_alpha_2.npy', alpha / 100)\n"
    matched = python(tmp_path, ANSWER + more).match(pair)
    expected = np.full((16, 60), 1.5)
    expected[:, 3] = np.nan
    np.testing.assert_array_equal(matched.alpha_2, expected)  # 1.5 is exact in single precision
    np.testing.assert_array_equal(matched.confidence, expected * 10)
    np.testing.assert_array_equal(matched.sigma_alpha_2, expected / 100)
    assert (matched.reasons == np.where(np.isnan(expected), 6, 0)).all()


def npy(folder: Path, array: np.ndarray, name: str = "alpha_2.npy") -> str:
    """A shell line that writes an array."""
    file = folder / f"given_{name}"
    np.save(file, array)
    return f"cp {file} $2/{name}\n"


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.full((16, 59), 1.5), "alpha_2 must have the panorama's shape (16, 60); it has (16, 59)"),
        (np.full((16, 60), "x"), "alpha_2 must be an array of real numbers; its dtype is <U1"),
        (
            np.full((16, 60), 90.0),
            "alpha_2 must lie within 0 .. pi radians, or be NaN for no match; it is 90 at [0, 0]",
        ),
        (np.full((16, 60), np.inf), "alpha_2 must lie within 0 .. pi radians"),
        (np.full((16, 60), None), "alpha_2.npy cannot be read as a .npy file of plain numbers"),
    ],
)
def test_nonsense_is_refused(array: np.ndarray, said: str, pair: Pair, tmp_path: Path) -> None:
    assert complaint(pair, fast(tmp_path, npy(tmp_path, array))).startswith(f"program matcher.sh: {said}")


def test_a_confidence_without_a_match_is_refused(pair: Pair, tmp_path: Path) -> None:
    good = np.full((16, 60), 1.5)
    script = npy(tmp_path, np.where(np.arange(60) < 30, good, np.nan)) + npy(tmp_path, good, "confidence.npy")
    assert "confidence must be NaN where there is no match" in complaint(pair, fast(tmp_path, script))


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("true", "wrote no alpha_2.npy into the output folder, but nothing"),
        ("touch $2/alpha2.npy", "wrote no alpha_2.npy into the output folder, but alpha2.npy"),
        (
            "touch $2/alpha_2.npy",
            "alpha_2.npy cannot be read as a .npy file of plain numbers: cut short, pickled or of a",
        ),
        ("echo '1.5 1.5' > $2/alpha_2.npy", "alpha_2.npy cannot be read as a .npy file of plain numbers"),
        ("head -c 5000 {good} > $2/alpha_2.npy", "alpha_2.npy cannot be read as a .npy file of plain numbers"),
        ("head -c 20 {good} > $2/alpha_2.npy", "alpha_2.npy cannot be read as a .npy file of plain numbers"),
        ("cp {archive} $2/alpha_2.npy", "alpha_2.npy is an .npz archive; write the array alone"),
        ("mkdir $2/alpha_2.npy", "alpha_2.npy is not a file"),
        ("mkfifo $2/alpha_2.npy", "alpha_2.npy is not a file"),
        ("ln -s /nowhere $2/alpha_2.npy", "alpha_2.npy is not a file"),
        ("cp {huge} $2/alpha_2.npy", "alpha_2.npy cannot be read as a .npy file of plain numbers"),
        ("rm -r $1 $2", "removed the output folder"),
        ("echo one >&2; echo two >&2; exit 3", "ended with exit code 3; its last output: one two"),
        ("exit 3", "ended with exit code 3; it wrote nothing to stderr"),
        ("kill -SEGV $$", "was ended by SIGSEGV"),
        ("yes abcdefg | head -c 100000 >&2; exit 1", "ended with exit code 1; its last output: ... "),
    ],
)
def test_whatever_goes_wrong_is_one_line(script: str, said: str, pair: Pair, tmp_path: Path) -> None:
    good, archive, huge = (tmp_path / name for name in ("good.npy", "archive.npz", "huge.npy"))
    np.save(good, np.full((16, 60), 1.5))
    np.savez(archive, alpha_2=np.full((16, 60), 1.5))
    with huge.open("wb") as stream:  # says that it is 8 TB long
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)})
    text = complaint(pair, fast(tmp_path, script.format(good=good, archive=archive, huge=huge)))
    assert text.startswith(f"program matcher.sh: {said}")
    assert len(text) < 700


@pytest.mark.slow
def test_the_time_limit_ends_all_that_was_started(pair: Pair, tmp_path: Path) -> None:
    """The grandchild holds on to stderr, ignores what can be ignored, and is gone all the same."""
    script = f"(trap '' TERM INT HUP; echo here >&2; echo $$ > {tmp_path}/pid; sleep {SLEEP}) &\nsleep {SLEEP}\n"
    text = complaint(pair, fast(tmp_path, script, timeout_s=1.0))
    assert text == "program matcher.sh: did not finish within timeout_s = 1 s, and was killed; its last output: here"
    assert not _sleepers()


def test_nothing_is_left_running_behind_a_good_answer(pair: Pair, tmp_path: Path) -> None:
    script = npy(tmp_path, np.full((16, 60), 1.5)) + f"sleep {SLEEP} &\n"
    fast(tmp_path, script).match(pair)
    assert not _sleepers()


@pytest.mark.slow
def test_a_program_does_not_outlive_who_started_it(tmp_path: Path) -> None:
    (tmp_path / "matcher.sh").write_text(f"touch {tmp_path}/begun\nsleep {SLEEP}\n")
    write_small(
        tmp_path / "small.toml",
        '[trial.matching]\nkind = "program"\ncommand = ["sh", "matcher.sh", "{input}", "{output}"]\n',
    )
    process = begin(tmp_path, "run", "small.toml", "--out", "out", "--no-report")
    deadline = time.monotonic() + 60
    while not (tmp_path / "begun").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    kill_group(process)
    assert (tmp_path / "begun").exists()
    assert not _sleepers()


def _sleepers() -> list[psutil.Process]:
    """Processes that one of these tests has left asleep; a killed one may take a moment to go."""
    deadline = time.monotonic() + 5
    while True:
        result = [
            each
            for each in psutil.process_iter(["cmdline", "status"])
            if each.info["cmdline"] == ["sleep", SLEEP] and each.info["status"] != psutil.STATUS_ZOMBIE
        ]
        if not result or time.monotonic() > deadline:
            return result
        time.sleep(0.02)


# --- Its command --------------------------------------------------------------------------------------------------


def test_parameters_and_folders_are_filled_in(tmp_path: Path) -> None:
    matcher = Program(
        command=("x", "--in={input}", "{output}", "-w{window}", "{deep}", "{on}", "{unknown}", "{ not}"),
        parameters={"window": 5, "deep": [1, 2], "on": True, "name": "{input}"},
    )
    words = ["x", f"--in={tmp_path}/input", f"{tmp_path}/output", "-w5", "[1, 2]", "true", "{unknown}", "{ not}"]
    assert program.filled_in(matcher, tmp_path) == words


def test_files_of_a_command_lie_beside_the_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / "deep"
    deep.mkdir()
    for name in ("run.sh", "table.txt", "sh"):
        (deep / name).touch()
    (deep / "run.sh").chmod(0o755)
    command = ["sh", "run.sh", "table.txt", "./table.txt", "other.txt", "{input}", "{output}"]
    rest = f'[trial.matching]\nkind = "program"\ncommand = {command}\n'
    path = write_small(deep / "e.toml", rest)
    expected = ("sh", f"{deep}/run.sh", f"{deep}/table.txt", f"{deep}/table.txt", "other.txt", "{input}", "{output}")
    monkeypatch.chdir(tmp_path)
    experiment = load_experiment("deep/e.toml")
    assert experiment.trial.matching.command == expected
    again = tmp_path / "written.toml"
    again.write_text(path.read_text().replace(str(command), str(list(expected))))
    assert load_experiment(str(again)).trial.key == experiment.trial.key
    axis = '"matching.command" = [["./run.sh", "{input}", "{output}"], ["sh", "{input}", "{output}"]]'
    path.write_text(f"{path.read_text()}[axes]\n{axis}\n")
    commands = [each.trial.matching.command[0] for each in load_experiment("deep/e.toml").planned]
    assert commands == [f"{deep}/run.sh", "sh"]


def test_a_changed_file_of_the_command_is_another_matcher(tmp_path: Path) -> None:
    (tmp_path / "data.txt").write_text("1")
    write_small(
        tmp_path / "e.toml",
        '[trial.matching]\nkind = "program"\ncommand = ["sh", "data.txt", "{input}", "{output}"]\n',
    )
    before = load_experiment(str(tmp_path / "e.toml")).trial.key
    assert load_experiment(str(tmp_path / "e.toml")).trial.key == before
    (tmp_path / "data.txt").write_text("22")
    assert load_experiment(str(tmp_path / "e.toml")).trial.key != before


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("", "matching.command: this key is missing"),
        (
            'command = ["x", "{input}"]',
            "matching.command: must name the output folder: no word of it contains {outpu",
        ),
        ("command = []", "matching.command: must be a list"),
        ('command = ["x", "", "{input}", "{output}"]', "matching.command[1]: "),
        ('command = "x {input} {output}"', "matching.command: must be a list; found 'x {input} {output}'"),
        ('command = ["no-such-x", "{input}", "{output}"]', "matching.command: no-such-x: there is no such program"),
        ('command = ["./e.toml", "{input}", "{output}"]', "matching.command: {here}/e.toml: is not executable"),
        ('command = ["./gone", "{input}", "{output}"]', "matching.command: {here}/gone: there is no such program"),
        ('command = ["sh", "{input}", "{output}"]\ntimeout_s = 0', "matching.timeout_s: must be above 0; found 0"),
        (
            'command = ["sh", "{input}", "{output}"]\nparameters = { input = 1 }',
            "matching.parameters: 'input' cannot be",
        ),
    ],
)
def test_refused_before_a_run(table: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "e.toml"
    file.write_text(f'[matching]\nkind = "program"\n{table}\n')
    with pytest.raises(InputError) as caught:
        load_matcher(str(file))
    assert str(caught.value).startswith(f"{file}: {said.replace('{here}', str(tmp_path))}")


def test_a_program_that_cannot_be_started(pair: Pair, tmp_path: Path) -> None:
    file = tmp_path / "matcher"
    file.write_text("no program at all")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    command = (str(file), "{input}", "{output}")
    assert complaint(pair, Program(command=command)) == "program matcher: cannot be started (Exec format error)"


@pytest.mark.slow
def test_one_trial_of_a_run_fails(tmp_path: Path) -> None:
    np.save(tmp_path / "good.npy", np.full((50, 180), 1.5))
    (tmp_path / "matcher.sh").write_text("test $4 = 2 && sleep 100\ncp $3 $2/alpha_2.npy\n")
    command = ["sh", "matcher.sh", "{input}", "{output}", "good.npy", "{mode}"]
    write_small(
        tmp_path / "small.toml",
        f'[trial.matching]\nkind = "program"\ntimeout_s = 3\ncommand = {command}\n'
        '[axes]\n"matching.parameters.mode" = [1, 2, 3]\n',
    )
    done = omnirange(tmp_path, "run", "small.toml", "--out", "out", "--no-report")
    assert (done.returncode, "1 of 3 trials failed" in done.stderr) == (1, True), done.stderr
    with (tmp_path / "out" / "failures.csv").open() as file:
        (failure,) = csv.DictReader(file)
    assert failure["matching.parameters.mode"] == "2"
    assert failure["message"].startswith("program matcher.sh: did not finish within timeout_s = 3 s, and was killed")


# --- What a program is made of ------------------------------------------------------------------------------------

FOLDER = {
    "m.py": "import helper\nfrom pack import inner\nimport numpy\n",
    "helper.py": "def f():\n    import deeper\n",
    "deeper.py": "",
    "pack/__init__.py": "",
    "pack/inner.py": "from . import other\n",
    "pack/other.py": "",
    "pack/weights.bin": "1",
    "pack/.hidden": "",
    "pack/__pycache__/inner.pyc": "",
    "unused.py": "",
    "run": "#!/usr/bin/env python3\nimport helper\n",
    "tool.sh": "#!/bin/sh\nimport helper\n",
    "data/a.bin": "a",
    "data/deep/b.bin": "b",
    "w.npy": "w",
}


def _made_of(folder: Path, program: Program) -> set[str]:
    """The files whose contents change what the program is."""
    result = set()
    for name in FOLDER:
        before, old = program.identity(), (folder / name).read_text()
        (folder / name).write_text(f"{old}# more\n")
        result |= {name} if program.identity() != before else set()
        (folder / name).write_text(old)
        assert program.identity() == before
    return result


IMPORTED = {"helper.py", "deeper.py"}
PACKAGE = {"pack/__init__.py", "pack/inner.py", "pack/other.py", "pack/weights.bin"}
BINARIES = {"data/a.bin", "data/deep/b.bin"}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"command": ["python3", "m.py"]}, {"m.py", *IMPORTED, *PACKAGE}),
        ({"command": ["./run"]}, {"run", *IMPORTED}),
        ({"command": ["./tool.sh"]}, {"tool.sh"}),
        ({"command": ["./tool.sh"], "files": ["data/*.bin"]}, {"tool.sh", "data/a.bin"}),
        ({"command": ["./tool.sh"], "files": ["data/**/*.bin", "w.npy"]}, {"tool.sh", "w.npy", *BINARIES}),
        ({"command": ["./tool.sh"], "parameters": {"weights_file": "w.npy"}}, {"tool.sh", "w.npy"}),
    ],
)  # fmt: skip
def test_an_edited_file_makes_another_program(tmp_path: Path, settings: dict, expected: set[str]) -> None:
    for name, content in FOLDER.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
        (tmp_path / name).chmod(0o755)
    table = {"matching": {"kind": "program", **settings, "command": [*settings["command"], "{input}", "{output}"]}}
    (tmp_path / "program.toml").write_text(tomli_w.dumps(table))
    program = load_matcher(str(tmp_path / "program.toml"))
    assert _made_of(tmp_path, program) == expected


def test_a_program_on_the_search_path_counts_by_its_contents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "mine").write_text("#!/bin/sh\n")
    (tmp_path / "mine").chmod(0o755)
    program = Program(command=("mine", "{input}", "{output}"))
    before = program.identity()
    (tmp_path / "mine").write_text("#!/bin/sh\n#\n")
    assert program.identity() != before


def test_patterns_that_match_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^files: no file matches '.*nothing\*'") as caught:
        Program(command=("python3", "{input}", "{output}"), files=(f"{tmp_path}/nothing*",)).check()
    assert caught.value.key == "files"


def test_files_are_relative_to_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "w.npy").write_text("1")
    case = '[[cases]]\nname = "mine"\n"matching.kind" = "program"\n'
    case += '"matching.command" = ["python3", "{input}", "{output}"]\n'
    path = write_small(tmp_path / "e.toml", case + '"matching.files" = ["*.npy"]\n')
    (planned,) = load_experiment(str(path)).planned
    (tmp_path / "w.npy").write_text("2")
    (again,) = load_experiment(str(path)).planned
    assert planned.trial.matching.files == (str(tmp_path / "*.npy"),)
    assert planned.key != again.key
