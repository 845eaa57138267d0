"""How workers are begun."""

import subprocess
import sys

import pytest

BEGUN = """
import threading
from harness.machine import has_one_thread
from harness.runs.executors import _start_method

print(has_one_thread(), _start_method())
ended = threading.Event()
threading.Thread(target=ended.wait).start()
print(has_one_thread(), _start_method())
ended.set()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how many threads there are")
def test_workers_are_forks_only_of_a_process_without_other_threads() -> None:
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # as the command has them
    done = subprocess.run([sys.executable, "-c", BEGUN], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split("\n")[:2] == ["True fork", "False forkserver"]
