"""Runs with third-party matchers."""

import csv
import shutil
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from plugin_modules import FAR, Write
from sweeps import omnirange, rows, write_small

from harness.runs.load import load_experiment
from harness.runs.worker import run_here


@pytest.mark.long
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
    assert "2 trials in this folder were made with other settings: they are not used" in second.stdout
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


@pytest.mark.long
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
