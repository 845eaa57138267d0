"""Sweeps through the command line: killed, interrupted, failing, changed; and always the same bytes."""

import csv
import json
import os
import random
import signal
import sqlite3
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, nullcontext
from pathlib import Path

import psutil
import pytest
from repeats import few
from sweeps import begin, kill_group, omnirange, rows, wait_for, write_small

from harness.runs import run, worker
from harness.runs.details import Made, made_beforehand
from harness.runs.executors import Backend, backend_for
from harness.runs.load import load_experiment
from harness.runs.plan import plan
from harness.runs.store import Store

AXES = """
[axes]
"view_2.baseline_m" = [0.3, 0.5]
"noise.sigma_grey" = [0.0, 4.0]
seed = [1, 2, 3, 4, 5, 6]
"matching.window_px" = [5, 7]
"matching.subpixel" = ["none", "parabola"]
"""
TRIALS = 2 * 2 * 6 * 2 * 2


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    write_small(folder / "small.toml", AXES)
    return folder


@pytest.fixture(scope="module")
def whole(room: Path) -> bytes:
    """`trials.csv` of a run on one worker that nobody disturbed."""
    done = omnirange(room, "run", "small.toml", "--workers", 1, "--out", "whole")
    assert done.returncode == 0, done.stderr
    return (room / "whole" / "trials.csv").read_bytes()


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
@pytest.mark.usefixtures("whole")
def test_tables_of_a_run(room: Path) -> None:
    trials = table(room / "whole" / "trials.csv")
    assert len(trials) == len({trial["key"] for trial in trials}) == TRIALS
    assert list(trials[0])[-1] == "key"  # a hash comes last
    assert list(trials[0])[:6] == [
        "state",
        "view_2.baseline_m",
        "noise.sigma_grey",
        "seed",
        "matching.window_px",
        "matching.subpixel",
    ]
    assert not [name for name in trials[0] if name.endswith("_s")]  # what differs from run to run is in timings.csv
    assert [trial["key"] for trial in table(room / "whole" / "timings.csv")] == [trial["key"] for trial in trials]
    with Store(room / "whole" / "run.sqlite") as store:
        stored = store.finished(trial["key"] for trial in trials)
    for trial in trials:  # every figure reads back to the very number
        figures = stored[trial["key"]].figures
        assert {name: trial[name] and float(trial[name]) for name in figures} == {
            name: "" if value is None else value for name, value in figures.items()
        }
    summary = json.loads((room / "whole" / "summary.json").read_text())
    assert summary["trials"] == {"total": TRIALS, "done": TRIALS, "failed": 0}
    assert set(summary["comparison"]) == {"pixel", "subpixel"}


@pytest.mark.slow
@pytest.mark.parametrize("workers", few(1, [2, 4]))
def test_workers_change_no_bit(room: Path, whole: bytes, workers: int) -> None:
    out = f"workers{workers}"
    done = omnirange(room, "run", "small.toml", "--workers", workers, "--out", out, "--no-report")
    assert done.returncode == 0, done.stderr
    assert (room / out / "trials.csv").read_bytes() == whole


@pytest.mark.slow
@pytest.mark.usefixtures("whole")
def test_the_written_experiment_gives_the_same_trials(room: Path) -> None:
    again = load_experiment(str(room / "whole" / "experiment.toml"))
    assert [each.key for each in again.planned] == [trial["key"] for trial in table(room / "whole" / "trials.csv")]


@pytest.mark.long
@pytest.mark.slow
def test_killed_again_and_again(room: Path, whole: bytes) -> None:
    out = room / "killed"
    when = random.Random(20)
    before: dict[str, tuple[str, str]] = {}
    for kill in range(5):
        process = begin(room, "run", "small.toml", "--workers", 2, "--out", out, "--no-report")
        if kill:  # by what is written, not by the clock: a fast machine would be done before any fixed time
            wait_for(out, len(before) + when.randint(1, 8))
        time.sleep(when.uniform(0, 0.05))
        kill_group(process)
        assert process.returncode == -signal.SIGKILL
        after = rows(out)
        assert before.items() <= after.items()  # nothing is lost, and nothing done is done again
        before = after
    assert 0 < len(before) < TRIALS
    done = omnirange(room, "run", "small.toml", "--workers", 2, "--out", out, "--no-report")
    assert done.returncode == 0, done.stderr
    assert before.items() <= rows(out).items()
    assert len(rows(out)) == TRIALS
    assert (out / "trials.csv").read_bytes() == whole


@pytest.mark.slow
@pytest.mark.parametrize("workers", few(1, [2, 1]))
def test_interrupted(room: Path, whole: bytes, workers: int) -> None:
    out = room / f"interrupted{workers}"
    process = begin(room, "run", "small.toml", "--workers", workers, "--out", out)
    wait_for(out)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
    _, said = process.communicate(timeout=600)
    assert process.returncode == 130
    done = len(rows(out))
    assert 0 < done < TRIALS
    last = f"omnirange: interrupted; {done} of {TRIALS} trials are done and stored; run the same command to resume"
    assert [line for line in said.splitlines() if line] == [last]
    resumed = omnirange(room, "run", "small.toml", "--workers", workers, "--out", out, "--no-report")
    assert resumed.returncode == 0
    assert f"{TRIALS - done} of {TRIALS} trials run" in resumed.stdout
    assert (out / "trials.csv").read_bytes() == whole


@pytest.mark.slow
def test_workers_end_with_their_parent(room: Path) -> None:
    out = room / "orphans"
    process = begin(room, "run", "small.toml", "--workers", 2, "--out", out, "--no-report")
    wait_for(out)
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    process.kill()
    process.communicate(timeout=600)
    _, alive = psutil.wait_procs(children, timeout=600)
    assert not alive


@pytest.mark.slow
def test_killed_worker_costs_time_alone(room: Path, whole: bytes) -> None:
    out = room / "murdered"
    process = begin(room, "run", "small.toml", "--workers", 2, "--out", out, "--no-report")
    wait_for(out)
    youngest = max(psutil.Process(process.pid).children(recursive=True), key=lambda child: child.create_time())
    youngest.kill()
    _, said = process.communicate(timeout=600)
    assert process.returncode == 0, said
    assert (out / "trials.csv").read_bytes() == whole


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.usefixtures("whole")
def test_nothing_left_to_do_is_quick(room: Path) -> None:
    out = room / "whole"
    report = (out / "report.html").stat().st_mtime_ns
    done = omnirange(room, "run", "small.toml", "--out", out)
    assert done.returncode == 0
    assert f"all {TRIALS} trials are done and the report is written; nothing to do" in done.stdout
    assert (out / "report.html").stat().st_mtime_ns == report
    (out / "report.html").unlink()
    assert omnirange(room, "run", "small.toml", "--out", out).returncode == 0
    assert (out / "report.html").is_file()


@pytest.mark.long
@pytest.mark.slow
def test_report_from_the_folder_alone(room: Path, whole: bytes) -> None:
    out = room / "whole"
    summary = (out / "summary.json").read_bytes()
    for name in ("experiment.toml", "report.html", "summary.json", "trials.csv"):
        (out / name).unlink()
    done = omnirange(room, "report", out)
    assert done.returncode == 0, done.stderr
    assert (out / "trials.csv").read_bytes() == whole
    assert (out / "summary.json").read_bytes() == summary
    assert (out / "report.html").is_file()


@pytest.mark.long
@pytest.mark.slow
def test_a_trial_that_fails(room: Path) -> None:
    write_small(
        room / "failing.toml",
        '[[cases]]\nname = "near"\n"view_2.baseline_m" = 0.3\n[[cases]]\nname = "far"\n"view_2.baseline_m" = 50.0\n'
        '[[cases]]\nname = "7"\nseed = 7\n',
        name="failing",
    )
    out = room / "failing"
    done = omnirange(room, "run", "failing.toml", "--out", out)
    assert done.returncode == 1
    will, failed = done.stderr.splitlines(keepends=True)
    assert will.startswith(
        "omnirange: 1 of 3 trials will fail; the first: trial.view_2: scene box: the view at (50, 0, 1) "
    )
    assert failed == (
        f"omnirange: 1 of 3 trials failed; {out / 'failures.csv'} says why; the same command runs them again\n"
    )
    trials = table(out / "trials.csv")
    assert [trial["state"] for trial in trials] == ["done", "failed", "done"]
    assert [trial["case"] for trial in trials] == ["near", "far", '"7"']  # text that reads as a number is quoted
    assert [trial["density"] != "" for trial in trials] == [True, False, True]
    failures = table(out / "failures.csv")
    assert len(failures) == 1
    assert "box" in failures[0]["message"]
    assert failures[0]["traceback"].startswith("Traceback")
    assert (out / "report.html").is_file()

    again = omnirange(room, "run", "failing.toml", "--out", out, "--no-report")
    assert again.returncode == 1
    assert "1 of 3 trials run, 1 of them failed" in again.stdout
    assert "2 done before" in again.stdout


@pytest.mark.long
@pytest.mark.slow
def test_rows_of_other_code_are_set_aside(tmp_path: Path) -> None:
    write_small(tmp_path / "code.toml", "[axes]\nseed = [1, 2]\n", name="code")
    out = tmp_path / "out"
    assert omnirange(tmp_path, "run", "code.toml", "--out", out, "--no-report").returncode == 0
    trials = (out / "trials.csv").read_bytes()
    with closing(sqlite3.connect(out / "run.sqlite")) as connection, connection:
        forged = '{"figures": {"density": 123}}'
        connection.execute("UPDATE trials SET code = 'older', payload = ?", (forged,))
    done = omnirange(tmp_path, "run", "code.toml", "--out", out, "--no-report")
    assert "2 trials in this folder were made by other code or libraries: they are not used" in done.stdout
    assert "2 of 2 trials run" in done.stdout
    assert (out / "trials.csv").read_bytes() == trials


@pytest.mark.long
@pytest.mark.slow
def test_a_scene_changed_since(tmp_path: Path) -> None:
    scene = tmp_path / "room.toml"
    text = (Path(__file__).parent.parent / "scenes" / "box.toml").read_text()
    scene.write_text(text)
    experiment = write_small(tmp_path / "changed.toml", "[axes]\nseed = [1, 2]\n", name="changed").read_text()
    (tmp_path / "changed.toml").write_text(experiment.replace('scene = "box"', 'scene = "./room.toml"'))
    out = tmp_path / "out"
    assert omnirange(tmp_path, "run", "changed.toml", "--out", out, "--no-report").returncode == 0
    before = (out / "trials.csv").read_bytes()
    scene.write_text(text + "\n# the same\n")
    same = omnirange(tmp_path, "run", "changed.toml", "--out", out, "--no-report")
    assert same.stdout == "changed: all 2 trials are done\n"
    scene.write_text(text.replace("6.0", "6.5", 1))
    done = omnirange(tmp_path, "run", "changed.toml", "--out", out, "--no-report")
    assert "2 trials in this folder were made of other scenes, or of an earlier version of this one" in done.stdout
    assert len(table(out / "trials.csv")) == 2
    assert (out / "trials.csv").read_bytes() != before


def test_trials_that_share_a_geometry_go_together() -> None:
    """They are next to each other whatever the order of the axes, and cut apart only when they are many."""
    experiment = load_experiment("smoke")
    turned = experiment.model_copy(update={"axes": dict(reversed(experiment.axes.items()))})
    whole = plan(turned.planned)
    assert sorted(each.key for each in whole.trials) == sorted(each.key for each in experiment.planned)
    assert sum(whole.new_geometry) == 2  # one a baseline
    assert whole.renders == 3  # of which the first view is common
    for batch_s in (0.0, 0.01, 0.1, 100.0):
        batches = whole.batches(batch_s)
        assert tuple(each for batch in batches for each in batch) == whole.trials
    assert len(whole.batches(0.0)) == len(whole.trials)
    assert len(whole.batches(whole.total_s / 2 - 1e-9)) == 2
    assert len(whole.batches(100.0)) == 1


class _Brittle(Executor):
    """Breaks, as a pool does, on the trial with one seed; runs all others at once."""

    def submit(self, fn, /, batch):
        future = Future()
        if any(table["seed"] == 3 for _, _, table in batch.trials):
            future.set_exception(BrokenProcessPool("gone"))
        else:
            future.set_result(fn(batch))
        return future


class _Later(Executor):
    """Runs what was submitted when a step of other work has been taken since."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self._waiting: list[tuple[Future, object, object]] = []

    def submit(self, fn, /, batch):
        self._waiting.append((Future(), fn, batch))
        self.said.append("trial")
        return self._waiting[-1][0]

    def steps(self, count: int):
        for number in range(count):
            self.said.append(f"step {number}")
            waiting, self._waiting = self._waiting, []
            for future, fn, batch in waiting:
                future.set_result(fn(batch))
            yield


def test_while_workers_are_busy_other_work_is_done_in_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path))
    experiment = load_experiment(str(write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2, 3, 4, 5]\n")))
    later = _Later()
    backend = Backend(lambda: nullcontext(later), workers=2, slots=2, threads=1)
    with Store() as store:
        run.run_plan(run.run_status(experiment, store).plan, store, backend, meanwhile=later.steps(9))
        assert run.run_status(experiment, store).done == 5
    # Workers are given work first; steps that nobody waits for are left out.
    assert later.said == ["trial", "trial", "step 0", "trial", "trial", "step 1", "trial", "step 2"]


def test_details_that_were_made_beforehand_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path))
    axes = '[axes]\nseed = [1, 2]\n"matching.subpixel" = ["none", "parabola"]\n'
    experiment = load_experiment(str(write_small(tmp_path / "small.toml", axes)))
    made: dict[str, Made] = {}
    assert len(list(made_beforehand(experiment, made))) == 2 * 2  # two steps for each method
    kept = []
    for beforehand in (made, {}):
        worker.forget()
        with run.open_run(experiment, tmp_path / str(len(beforehand))) as store:
            run.run_plan(run.run_status(experiment, store).plan, store, backend_for(0.0, 1))
            result = run.result_from(experiment, run.rows_of(experiment, store), store, beforehand=beforehand)
            assert [each.trial for each in result.outcomes] == [each.outcome.trial for each in made.values()]
            kept.append((result.summary, [store.answer(key) for key in result.details.keys]))
            assert (result.outcomes[0] is next(iter(made.values())).outcome) == bool(beforehand)
    assert kept[0] == kept[1]
    assert all(kept[0][1])


def test_a_trial_that_kills_its_worker_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path))
    experiment = load_experiment(str(write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2, 3, 4, 5]\n")))
    backend = Backend(lambda: nullcontext(_Brittle()), workers=2, slots=2, threads=1)
    with Store() as store:
        run.run_plan(run.run_status(experiment, store).plan, store, backend)
        stored = store.finished(each.key for each in experiment.planned)
    states = {each.trial.seed: stored[each.key].state for each in experiment.planned}
    assert states == {1: "done", 2: "done", 3: "failed", 4: "done", 5: "done"}
    message = next(row.message for row in stored.values() if row.state == "failed")
    assert message == "the worker that ran this trial died: BrokenProcessPool: gone"
