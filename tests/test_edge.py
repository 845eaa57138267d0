"""Whatever escapes from a command is one line, and one failure costs nothing that has no need of it."""

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from repeats import few
from sweeps import environment, omnirange, write_small

from harness.cli import main
from harness.cli import settings as command
from harness.errors import InputError, described
from harness.runs import worker

MATCHERS = '''
import asyncio, os
import numpy as np

class Panic(BaseException):
    """Stands for those of other languages."""

class Silent(Exception):
    def __str__(self):
        raise ValueError

def fail(how):
    if how == "cancelled":
        raise asyncio.CancelledError("the inner task")
    if how == "panic":
        raise Panic("called unwrap on None")
    if how == "interrupt":
        raise KeyboardInterrupt
    if how == "exit":
        raise SystemExit(0)
    if how == "_exit":
        os._exit(0)
    if how == "bytes":
        raise ValueError("cannot read " + os.fsdecode(b"caf\\xe9"))
    if how == "silent":
        raise Silent
    if how == "folder":
        os.chdir("/")

def match(pair, limits, *, how="none"):
    fail(how)
    return np.minimum(np.array(pair.alpha_1) + 0.05, np.pi)
'''
FAILURES = {
    "cancelled": "CancelledError: the inner task",
    "panic": "Panic: called unwrap on None",
    "interrupt": "KeyboardInterrupt",
    "exit": "SystemExit: 0",
    "_exit": "_Exit: os._exit(0) was called",
    "bytes": r"ValueError: cannot read caf\udce9",
    "silent": "Silent",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    worker.forget()
    return tmp_path


@pytest.mark.parametrize(
    ("error", "said", "code"),
    [
        (InputError("is wrong", file="x.toml", key="a.b"), "x.toml: a.b: is wrong", 2),
        (OSError(errno.ENOSPC, "No space left on device", "out/x"), "out/x: No space left on device", 2),
        (PermissionError(errno.EACCES, "Permission denied", b"caf\xe9"), r"caf\udce9: Permission denied", 2),
        (MemoryError("Unable to allocate 8 TiB"), "there is not enough memory for this; ", 2),
        (RecursionError("maximum recursion depth exceeded"), "something that was given is nested too deeply", 2),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid"), "something that was given is not text in UTF-8", 2),
        (ZeroDivisionError("one\ntwo"), "ZeroDivisionError: one two: this is a bug in omnirange; please report it", 70),
        (GeneratorExit("x"), "GeneratorExit: x: this is a bug", 70),
        (SystemExit(0), "RuntimeError: a library tried to end the program (0): this is a bug", 70),
    ],
)
@pytest.mark.parametrize("debug", [False, True])
def test_what_escapes_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    said: str,
    code: int,
    debug: bool,
) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr(command, "run", fail)
    assert main(["settings", *["--debug"][:debug]]) == code
    *trace, line = capsys.readouterr().err.splitlines()
    assert line.startswith(f"omnirange: {said}")
    assert bool(trace) == debug


def test_errors_are_described_on_one_line() -> None:
    assert described(ValueError("a\n b\udce9")) == r"ValueError: a b\udce9"
    assert described(ValueError()) == "ValueError"


@pytest.mark.slow
@pytest.mark.parametrize("how", FAILURES)
def test_what_a_matcher_raises_is_one_failed_trial(folder: Path, capsys: pytest.CaptureFixture[str], how: str) -> None:
    name = f"borders_{how.strip('_')}{how.count('_')}"
    (folder / f"{name}.py").write_text(MATCHERS)
    write_small(folder / "e.toml", f'[trial.matching]\nkind = "{name}:match"\n')
    arguments = ["--axis", f"matching.parameters.how={how},none", "--out", "o", "--no-report"]
    assert main(["run", "e.toml", *arguments]) == 1
    table = (folder / "o" / "trials.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in table] == ["state", "failed", "done"]
    assert f"{name}:match: fails: {FAILURES[how]} (" in (folder / "o" / "failures.csv").read_text()
    assert "1 of 2 trials failed; o/failures.csv says why" in capsys.readouterr().err


def test_a_matcher_that_changes_the_folder(folder: Path) -> None:
    (folder / "borders_folder.py").write_text(MATCHERS)
    write_small(folder / "e.toml", '[trial.matching]\nkind = "borders_folder:match"\nparameters.how = "folder"\n')
    assert main(["run", "e.toml", "--out", "o", "--no-report"]) == 0
    assert Path.cwd() == folder
    assert (folder / "o" / "trials.csv").is_file()


@pytest.mark.parametrize("how", ["panic", "_exit"])
def test_a_module_that_fails_as_it_is_loaded(folder: Path, capsys: pytest.CaptureFixture[str], how: str) -> None:
    name = f"loaded_{how.strip('_')}"
    (folder / f"{name}.py").write_text(f"{MATCHERS}\nfail({how!r})\n")
    write_small(folder / "e.toml", f'[trial.matching]\nkind = "{name}:match"\n')
    assert main(["run", "e.toml", "--out", "o"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"the module {name} fails: {FAILURES[how]}" in line


@pytest.mark.slow
def test_a_worker_that_a_matcher_ends(folder: Path) -> None:
    """As C code does, past all of Python: the trial fails, and the other one is done."""
    (folder / "ends.py").write_text(
        "import ctypes, numpy as np\n"
        "def match(pair, limits, *, code=-1):\n"
        "    code < 0 or ctypes.CDLL(None)._exit(code)\n"
        "    return np.minimum(np.array(pair.alpha_1) + 0.05, np.pi)\n"
    )
    write_small(folder / "e.toml", '[trial.matching]\nkind = "ends:match"\n')
    axis = "matching.parameters.code=0,-1"
    ran = omnirange(folder, "run", "e.toml", "--axis", axis, "--out", "o", "--no-report", "--workers", 2)
    assert ran.returncode == 1
    table = (folder / "o" / "trials.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in table] == ["state", "failed", "done"]


# --- What is printed ----------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["[/b]", "[bold]x", "$x$", "a b'"])
def test_names_are_no_markup(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    write_small(folder / "e.toml")
    for _ in range(2):  # made, and shown again
        assert main(["run", "e.toml", "--out", name]) == 0
        said = capsys.readouterr().out
        assert f"report: {name}/report.html" in said


class Failing(io.TextIOWrapper):
    """A stream that fails from the first write on."""

    def __init__(self, code: int) -> None:
        super().__init__(io.BytesIO(), encoding="utf-8")
        self.code = code

    def write(self, _: str) -> int:
        raise OSError(self.code, os.strerror(self.code))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "exits", "said"),
    [
        (errno.EPIPE, 0, ""),
        (errno.ENOSPC, 2, "omnirange: standard output: cannot be written (No space left on device)\n"),
    ],
)
def test_a_closed_or_full_output_costs_no_result(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code: int,
    exits: int,
    said: str,
) -> None:
    write_small(folder / "e.toml")
    stream = Failing(code)
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["run", "e.toml", "--out", "o"]) == exits
    assert sys.stdout is stream
    assert capsys.readouterr().err == said
    assert (folder / "o" / "report.html").is_file()
    assert json.loads((folder / "o" / "summary.json").read_text())["trials"]["done"] == 1


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
def test_real_pipes_and_devices(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "harness", "settings"]
    variables = environment(tmp_path) | {"PYTHONPATH": str(Path(__file__).parent.parent)}
    reader, writer = os.pipe()
    os.close(reader)
    for output, code, said in (
        (writer, 0, b""),
        (
            os.open("/dev/full", os.O_WRONLY),
            2,
            b"omnirange: standard output: cannot be written (No space left on device)\n",
        ),
    ):
        done = subprocess.run(line, stdout=output, stderr=subprocess.PIPE, env=variables, check=False)
        os.close(output)
        assert (done.returncode, done.stderr) == (code, said)


# --- Where it is called from --------------------------------------------------------------------------------------

API = """
from pathlib import Path
from harness.runs.load import load_experiment
from harness.runs.run import run_experiment
print("begun", flush=True)
def work(folder, workers=2):
    experiment = load_experiment("e.toml")
    return len(run_experiment(experiment, Path(folder), workers=workers).rows)
"""


def script(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    write_small(folder / "e.toml", "[axes]\nseed = [1, 2]\n")
    (folder / "script.py").write_text(API + text)
    variables = environment(folder) | {"PYTHONPATH": str(Path(__file__).parent.parent)}
    return subprocess.run(
        [sys.executable, "script.py"], cwd=folder, env=variables, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_script_without_a_main_guard(tmp_path: Path) -> None:
    """Not a line of it is run twice, and its folder is made."""
    done = script(tmp_path, "print(work('deep/out'))\n")
    assert (done.returncode, done.stdout, done.stderr) == (0, "begun\n2\n", "")


@pytest.mark.slow
def test_inside_a_pool(tmp_path: Path) -> None:
    text = """
import multiprocessing
if __name__ == "__main__":
    with multiprocessing.get_context("fork").Pool(1) as pool:
        try:
            pool.apply(work, ("out",))
        except Exception as error:
            print(error)
        print(pool.apply(work, ("out", None)))
"""
    done = script(tmp_path, text)
    assert done.returncode == 0, done.stderr
    begun, said, rows = done.stdout.splitlines()
    assert said.startswith(
        "workers: cannot be started here: this is a daemon process, such as one of multiprocessing.Pool"
    )
    assert (begun, rows) == ("begun", "2")


@pytest.mark.slow
@pytest.mark.parametrize("kind", few(1, ["package", "module"]))
def test_beside_a_folder_of_the_same_name(tmp_path: Path, kind: str) -> None:
    """What is called `harness` in the working folder is another project's: neither the command nor workers load it."""
    if kind == "package":
        (tmp_path / "harness").mkdir()
    stranger = tmp_path / {"package": "harness/__init__.py", "module": "harness.py"}[kind]
    stranger.write_text("raise RuntimeError('of another project')\n")
    write_small(tmp_path / "e.toml", "[axes]\nseed = [1, 2]\n")
    variables = environment(tmp_path) | {"PYTHONPATH": str(Path(__file__).parent.parent)}
    start = "import sys; from harness.__main__ import main; sys.exit(main())"
    line = [sys.executable, "-P", "-c", start, "run", "e.toml", "--out", "o", "--no-report", "--workers", "2"]
    done = subprocess.run(line, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "2 of 2 trials run" in done.stdout


def test_compare_answers_to_links_in_a_circle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        (tmp_path / "loop").symlink_to("loop")
    except OSError:
        pytest.skip("links need a right that this user has not got")
    assert main(["compare", str(tmp_path / "loop"), str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {tmp_path / 'loop'}: holds no run")
