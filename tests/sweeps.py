"""The command line run as people run it, for the tests of sweeps: in processes and folders of its own."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

SMALL = """
name = "{name}"

[trial]
scene = "box"
seed = 1

[trial.sensor.camera]
width_px = 160
height_px = 120
focal_px = 153.53
cx_px = 79.5
cy_px = 59.5

[trial.render]
samples = 4

[trial.panorama]
width_px = 180
height_px = 50
"""


def write_small(path: Path, rest: str = "", name: str = "small") -> Path:
    """An experiment of one trial of 30 ms, with more TOML after it."""
    path.write_text(SMALL.format(name=name) + rest, encoding="utf-8")
    return path


def environment(folder: Path) -> dict[str, str]:
    """A cache of renders of the test's own."""
    return os.environ | {"OMNIRANGE_CACHE": str(folder / "cache")}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "harness", *map(str, arguments)]


def omnirange(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run to the end."""
    return subprocess.run(
        command(*arguments),
        cwd=folder,
        env=environment(folder) | {"PYTHONPATH": str(Path(__file__).parent.parent)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def begin(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    """Start in a process group of its own."""
    return subprocess.Popen(
        command(*arguments),
        cwd=folder,
        env=environment(folder) | {"PYTHONPATH": str(Path(__file__).parent.parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def kill_group(process: subprocess.Popen[str]) -> None:
    """Kill a process and all that it started, at once."""
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def rows(out: Path) -> dict[str, tuple[str, str]]:
    """State and timings of the trials in a run's file, by key; none while it is held by a run."""
    database = out / "run.sqlite"
    if not database.exists():
        return {}
    with closing(sqlite3.connect(database, timeout=0)) as connection:
        try:
            result = connection.execute("SELECT key, state, seconds FROM trials").fetchall()
        except sqlite3.OperationalError:  # locked, or killed before there was a table
            return {}
    return {key: (state, seconds) for key, state, seconds in result}


def wait_for(folder: Path, trials: int = 2, seconds: float = 600) -> None:
    """Wait until some trials are in a run's file, which the run itself keeps locked."""
    deadline = time.monotonic() + seconds
    while _written(folder / "run.sqlite") < trials:
        if time.monotonic() > deadline:
            raise TimeoutError(f"there were no {trials} trials in {folder} within {seconds} s")
        time.sleep(0.01)


def _written(database: Path) -> int:
    """How many trials are written; 0 while the file cannot be read, as in the midst of a transaction."""
    try:
        with closing(sqlite3.connect(f"{database.as_uri()}?immutable=1", uri=True)) as connection:
            [[count]] = connection.execute("SELECT count(*) FROM trials")
    except sqlite3.Error:
        return 0
    return int(count)
