"""How long `omnirange design` takes to answer, beside importing pyplot: `python benchmarks/answer.py [PAIRS]` (5).

Prints the median ratio over interleaved pairs of fresh processes, of CPU time (user and system) and of time on the
clock. The first pair only fills the caches of compiled code.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RIG = """
baseline_m = 0.5
noise_grey = 2.0

[uncertainty]
rotation_deg = 0.02
t_direction_deg = 0.1
t_length = 0.002
focal = 0.0005
centre_px = 0.1
shape = 0.001
alignment_mm = 0.1
alignment_deg = 0.05
"""


def seconds(command: list[str], folder: str) -> tuple[float, float]:
    """CPU time and time on the clock of a process."""
    start = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed")
    return used.ru_utime + used.ru_stime, time.perf_counter() - start


def main(pairs: int = 5) -> None:
    """Print both ratios, and the medians that they are of."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "rig.toml").write_text(RIG, encoding="utf-8")
        ours = [sys.executable, "-m", "harness", "design", "rig.toml"]
        peer = [sys.executable, "-c", "import matplotlib.pyplot"]
        times = [(seconds(ours, folder), seconds(peer, folder)) for _ in range(pairs + 1)][1:]
    for i, what in enumerate(("CPU time", "clock")):
        ratio = statistics.median(a[i] / b[i] for a, b in times)
        medians = [statistics.median(each[k][i] for each in times) for k in (0, 1)]
        print(f"{what:9} omnirange design {medians[0]:.2f} s, import matplotlib.pyplot {medians[1]:.2f} s: {ratio:.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
