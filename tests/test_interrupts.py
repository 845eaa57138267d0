"""Ctrl-C is never lost, and never taken for a failure, wherever it strikes."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Callable
from pathlib import Path

import pytest
from sweeps import begin, write_small

from harness import first_moment, interrupts
from harness.cli import main
from harness.runs import worker
from harness.runs.load import load_experiment
from harness.runs.run import open_run, run_status


def press() -> None:
    """The signal of Ctrl-C, handled before this returns."""
    signal.raise_signal(signal.SIGINT)


def swallow() -> None:
    """As a serialiser does that catches everything."""
    with contextlib.suppress(BaseException):
        press()


def lose() -> None:
    """Python drops what is raised in the callback of a weak reference."""

    class Thing:
        pass

    thing = Thing()
    reference = weakref.ref(thing, lambda _: press())
    del thing
    assert reference() is None


def wrap() -> None:
    """As numba does."""
    try:
        press()
    except BaseException as error:
        raise SystemError("returned a result with an exception set") from error


@pytest.mark.parametrize("strike", [press, swallow, lose, wrap])
def test_heard_whatever_becomes_of_the_exception(
    strike: Callable[[], None], capsys: pytest.CaptureFixture[str]
) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupts.heard():
        strike()
    assert signal.getsignal(signal.SIGINT) is handler
    assert capsys.readouterr().err == ""  # not even "exception ignored in"
    with interrupts.heard():  # forgotten
        interrupts.check()


def test_warnings_of_what_it_broke_are_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pydantic drops what its callbacks raise while it serialises, and warns that the value is odd."""
    shown: list[str] = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_more, **_options: shown.append(str(message)))
    show = warnings.showwarning
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with contextlib.suppress(KeyboardInterrupt), interrupts.heard():
            warnings.warn("before", stacklevel=1)
            swallow()
            warnings.warn("of what was broken", stacklevel=1)
        assert warnings.showwarning is show
    assert shown == ["before"]


def test_an_error_of_ones_own_is_no_interrupt() -> None:
    with interrupts.heard():
        assert not interrupts.is_real(KeyboardInterrupt())
        assert not interrupts.is_real(SystemError())
    assert interrupts.is_real(KeyboardInterrupt())  # nobody has listened, so it may well have been pressed
    in_thread = []
    thread = threading.Thread(target=lambda: in_thread.append(interrupts.is_real(KeyboardInterrupt())))
    thread.start()
    thread.join()
    assert in_thread == [False]


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    worker.forget()
    return write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2, 3]\n")


@pytest.mark.parametrize("strike", [press, swallow, lose, wrap])
@pytest.mark.parametrize("where", ["planning", "trial", "writing"])
def test_a_run_is_interrupted_wherever_it_strikes(
    small: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    strike: Callable[[], None],
    where: str,
) -> None:
    """In the second trial, the first is kept, the second is no failure, and the third is not begun."""
    from harness.runs import run

    module, name = {
        "planning": (run, "plan"),
        "trial": (worker, "run_trial"),
        "writing": (run, "_csv"),
    }[where]
    original, calls = getattr(module, name), []

    def struck(*arguments, **options):
        calls.append(name)
        if len(calls) == (2 if where == "trial" else 1):
            strike()
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, struck)
    out = tmp_path / "out"
    assert main(["run", str(small), "--out", str(out), "--no-report", "--workers", "1"]) == 130
    said = [line for line in capsys.readouterr().err.splitlines() if line]
    assert len(said) == 1
    assert said[0].startswith("omnirange: interrupted; ")
    monkeypatch.undo()
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    experiment = load_experiment(str(small))
    with open_run(experiment, out) as store:
        now = run_status(experiment, store)
    least = {"planning": 0, "trial": 1, "writing": 3}[where]
    # A trial whose interrupt was dropped goes on to its end, and is right.
    assert now.done in {least, least + (where == "trial" and strike in (swallow, lose))}
    assert now.failed == 0


@pytest.mark.slow
def test_a_second_one_ends_at_once() -> None:
    """The first is caught by somebody who goes on for ever."""
    script = (
        "import time; from harness import interrupts\n"
        "with interrupts.heard():\n"
        "    while True:\n"
        "        try:\n"
        "            print('here', flush=True); time.sleep(600)\n"
        "        except BaseException: pass\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "here\n"
    time.sleep(2 * interrupts._SAME_S)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    assert said.strip() == "omnirange: stopped at once; finished trials are stored"


@pytest.mark.slow
def test_workers_in_the_midst_of_a_trial_are_not_awaited(tmp_path: Path) -> None:
    """Both would take an hour."""
    (tmp_path / "sleeper.py").write_text(
        "import time\ndef match(pair, limits):\n    open('begun', 'w').close()\n    time.sleep(3600)\n"
    )
    write_small(tmp_path / "small.toml", '[axes]\nseed = [1, 2]\n[trial.matching]\nkind = "sleeper:match"\n')
    process = begin(tmp_path, "run", "small.toml", "--workers", 2, "--out", "out", "--no-report")
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()  # would wait for an hour
    assert process.returncode == 130
    assert [line for line in said.splitlines() if line] == [
        "omnirange: interrupted; 0 of 2 trials are done and stored; run the same command to resume"
    ]


_PRESSED_AS_THE_PACKAGE_LOADS = """
import sys, _signal
class Finder:
    def find_spec(name, path=None, target=None):
        if "harness" in sys.modules and name != "harness.first_moment":
            _signal.raise_signal(2)
sys.meta_path.insert(0, Finder)
"""


@pytest.mark.parametrize("started", [["-m", "harness"], ["omnirange"], ["-X", "utf8", "omnirange"]])
def test_from_the_first_moment(tmp_path: Path, started: list[str]) -> None:
    """Pressed at whatever the package loads first: nothing else may be loaded before Ctrl-C is answered."""
    (tmp_path / "sitecustomize.py").write_text(_PRESSED_AS_THE_PACKAGE_LOADS)
    (tmp_path / "omnirange").write_text("from harness.__main__ import main\nmain()\n")
    path = os.pathsep.join([str(tmp_path), str(Path(interrupts.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, *started, "--version"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "\nomnirange: interrupted\n")


@pytest.mark.parametrize(
    ("started", "listens"),
    [
        (["-m", "harness", "run"], True),
        (["-W", "error", "/usr/bin/omnirange"], True),
        (["-m", "pytest", "-m", "harness"], False),
        (["script.py", "omnirange"], False),
        (["-c", "import harness", "omnirange"], False),
        (["-m", "ipykernel_launcher"], False),
        ([], False),
    ],
)
def test_nothing_changes_in_a_script_or_a_notebook(started: list[str], listens: bool) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        first_moment.listen(["python", *started])
        assert (signal.getsignal(signal.SIGINT) is first_moment.end_at_once) == listens
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["import", "exec", "shutdown"])
def test_before_and_after_the_command(moment: str) -> None:
    """While libraries are loaded, and while Python shuts down."""
    script = {
        "import": "sys.modules['harness.cli'] = type('', (), {'__getattr__': lambda *_: signal.raise_signal(2)})()",
        "exec": "import harness.cli.settings as s; s.run = lambda _: exec('signal.raise_signal(2)'); "
        "sys.argv = ['omnirange', 'settings']",
        "shutdown": "atexit.register(signal.raise_signal, 2); sys.argv = ['omnirange', 'settings', 'seed']",
    }[moment]
    script = f"import atexit, signal, sys; {script}\nfrom harness.__main__ import main\nsys.exit(main())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    if moment == "import":
        assert (done.returncode, done.stderr) == (130, "\nomnirange: interrupted\n")
    elif moment == "exec":  # Python would end itself by the signal
        assert (done.returncode, done.stderr.count("\n")) == (130, 2)
    else:  # all is written by then
        assert (done.returncode in (0, 130), "Traceback" in done.stderr) == (True, False)


def test_what_a_library_warns_of_after_ctrl_c_is_not_shown_by_the_command(capsys, monkeypatch):
    """The command shows warnings its own way, which hides them then too."""
    from harness import interrupts
    from harness.cli.parser import _Notices

    _Notices().show("of itself", UserWarning, "a.py", 1)
    monkeypatch.setattr(interrupts, "_asked_at", [1.0])
    _Notices().show("of what was broken", UserWarning, "a.py", 1)
    said = capsys.readouterr().err
    assert "of itself" in said
    assert "broken" not in said
