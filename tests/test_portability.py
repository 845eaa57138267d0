"""The program on systems that lack what Linux has: the names that differ are taken away."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from harness import machine

ELSEWHERE = """
import io, multiprocessing, os, signal, sys

for module, names in {
    os: ("sched_getaffinity", "sched_setaffinity", "killpg", "getpgid", "setpgid", "setsid", "fork", "forkpty",
         "getuid", "geteuid", "getpwuid", "O_NOFOLLOW", "O_DIRECTORY", "mkfifo", "nice"),
    signal: ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM", "alarm", "pthread_kill", "pthread_sigmask"),
}.items():
    for name in names:
        module.__dict__.pop(name, None)
multiprocessing.get_all_start_methods = lambda: ["spawn"]
sys.modules["fcntl"] = sys.modules["pwd"] = sys.modules["grp"] = sys.modules["resource"] = None
plain_open = io.open
def open_without_proc(file, *arguments, **options):
    if str(file).startswith("/proc/"):
        raise FileNotFoundError(2, "No such file or directory", str(file))
    return plain_open(file, *arguments, **options)
io.open = open_without_proc
"""
"""Carried out by every Python process as it begins, workers among them."""


@pytest.mark.long
@pytest.mark.slow
def test_a_sweep_needs_nothing_that_only_linux_has(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(ELSEWHERE, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parent.parent)])
    command = [sys.executable, "-m", "harness", "run", "smoke", "--workers", "2", "--out", str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": path}
    ran = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "32 of 32 trials run" in ran.stdout
    assert (tmp_path / "out" / "report.html").is_file()


def test_cpus_are_counted_where_processes_are_not_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.available_cpus() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert machine.available_cpus() == 3
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert machine.available_cpus() == 1


@pytest.mark.parametrize("missing", [(), ((os, "killpg"),)])
def test_a_program_is_ended_with_and_without_process_groups(missing, monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in missing:
        monkeypatch.delattr(module, name, raising=False)
    waiting = [sys.executable, "-S", "-c", "import time; time.sleep(60)"]
    with subprocess.Popen(waiting, start_new_session=True) as process:
        machine.kill(process)
        assert process.returncode
        machine.kill(process)  # one that has ended is no error
