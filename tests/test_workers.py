"""How workers are begun."""

import os
import subprocess
import sys

import pytest

BEGUN = """
import threading
from harness.machine import FORK_SAFE, has_one_thread
from harness.runs.executors import _start_method

print(has_one_thread(), _start_method())
ended = threading.Event()
thread = threading.Thread(target=ended.wait)
thread.start()
print(has_one_thread(), _start_method())
FORK_SAFE.add(thread.native_id)
print(has_one_thread(), _start_method())
ended.set()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how many threads there are")
def test_workers_are_forks_only_of_a_process_without_other_threads() -> None:
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # as the command has them
    done = subprocess.run([sys.executable, "-c", BEGUN], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split("\n")[:3] == ["True fork", "False forkserver", "True fork"]


LOCKED = """
import io, os, sys, threading, time
from harness.cli import heartbeat

class Terminal(io.StringIO):
    def isatty(self):
        return True

    def write(self, text):
        time.sleep(0.2)  # so long that a fork comes in between
        return len(text)

heartbeat.SILENCE_S, heartbeat._EVERY_S = 0.0, 0.01
real, sys.stdout, sys.stderr = sys.stdout, Terminal(), Terminal()
with heartbeat.heartbeat():
    time.sleep(0.1)
    pid = os.fork()
    if not pid:
        sys.stderr.write("said by the fork")
        os._exit(7)
    ended = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
print(ended, file=real)
"""


@pytest.mark.skipif(not hasattr(os, "register_at_fork"), reason="no forks here")
def test_a_fork_beside_the_sign_of_life_can_write() -> None:
    command = [sys.executable, "-W", "ignore", "-c", LOCKED]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "7\n"
