"""How long a warm run and a report take, beside importing the libraries that both need.

    python benchmarks/run.py paper [--pairs 5]      # omnirange run paper, into a fresh folder each time
    python benchmarks/run.py report [--pairs 3]     # omnirange report of a finished run of `law`, made first (minutes)
    python benchmarks/run.py report --folder DIR    # of a run that is there; it is copied

Prints medians over interleaved pairs of fresh processes, and the ratios: of CPU time, with that of all processes that a
command begins, and of time on the clock until the last line of the table, and until the end. On a machine that others
use, the clock says little; see the load that is printed with it.
"""

import argparse
import ctypes
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

IMPORTS = [sys.executable, "-c", "import matplotlib.pyplot, pandas, scipy.ndimage, numba"]
OMNIRANGE = [sys.executable, "-m", "harness"]
_PR_SET_CHILD_SUBREAPER = 36
"""From prctl.h of Linux: processes whose parent has ended become ours, so that their time is counted."""


def seconds(command: list[str], last_of_table: str = "writing report") -> tuple[float, float, float]:
    """CPU time of a command and all that it begins; time on the clock until it prints that line, and to its end."""
    before, start = _cpu_of_children(), time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    shown = None
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(last_of_table):
            shown = time.perf_counter() - start
    if process.wait():
        raise SystemExit(f"{' '.join(command)} failed")
    end = time.perf_counter() - start
    while True:
        try:
            os.wait()
        except ChildProcessError:
            break
    return _cpu_of_children() - before, shown or end, end


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def compare(title: str, command: list[str], fresh: Path | None, pairs: int) -> None:
    """Print the medians of a command and of the imports, interleaved, and their ratios; the first pair is not counted.

    fresh : a folder that is removed before each run.
    """
    times = []
    for _ in range(pairs + 1):
        if fresh is not None:
            shutil.rmtree(fresh, ignore_errors=True)
        times.append((seconds(command), seconds(IMPORTS)))
    print(f"{title}, against importing pyplot, pandas, scipy.ndimage and numba; load {os.getloadavg()[0]:.1f}")
    for i, what in enumerate(("CPU time", "clock, table", "clock, all")):
        ours, theirs = (statistics.median(each[k][i] for each in times[1:]) for k in (0, 1))
        ratio = statistics.median(a[i] / b[i] for a, b in times[1:])
        print(f"{what:13} {ours:6.2f} s, imports {theirs:5.2f} s: {ratio:5.2f}")


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("paper", "report"))
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="a finished run, for 'report'")
    options = parser.parse_args()
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    with tempfile.TemporaryDirectory(prefix="omnirange-benchmark-") as room:
        folder = Path(room, "run")
        if options.what == "paper":
            compare("omnirange run paper", [*OMNIRANGE, "run", "paper", "--out", str(folder)], folder, options.pairs)
            return
        if options.folder is not None:
            shutil.copytree(options.folder, folder)
        else:
            subprocess.run([*OMNIRANGE, "run", "law", "--no-report", "--out", str(folder)], check=True)
        compare("omnirange report", [*OMNIRANGE, "report", str(folder)], None, options.pairs)


if __name__ == "__main__":
    main()
