"""What a sweep costs: two workers against one, time against the number of trials, memory of a worker, and resuming.

    python benchmarks/sweep.py                     # the law at full size: an hour or more
    python benchmarks/sweep.py --trials 200 --pair-trials 84 --pairs 3

The number of trials is set by the number of seeds. Every measured sweep begins with an empty cache of renders.

Where others use the machine too, the ratio of times says little; the CPU time that two workers take together,
against that of one, then bounds what they would gain on idle cores.
"""

import argparse
import math
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOM = tempfile.TemporaryDirectory(prefix="omnirange-benchmark-")
os.environ["OMNIRANGE_CACHE"] = f"{ROOM.name}/cache"
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import psutil  # noqa: E402

from harness.pipeline.render_cache import RenderCache  # noqa: E402
from harness.runs import run, worker  # noqa: E402
from harness.runs.executors import backend_for  # noqa: E402
from harness.runs.experiment import Experiment  # noqa: E402
from harness.runs.load import load_experiment  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", nargs="?", default="law", help="one with an axis 'seed'")
    parser.add_argument("--trials", type=int, default=2000, help="of the long sweep; the short one has a tenth")
    parser.add_argument("--pair-trials", type=int, default=200, help="of a sweep with one worker and one with two")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="the pairs alone")
    options = parser.parse_args()

    sized(options.experiment, 1)  # compile everything, in this process
    warm = sized(options.experiment, 1)
    sweep(warm, 1, most=4)

    ratios, bounds = [], []
    for i in range(options.pairs):
        pair = sized(options.experiment, options.pair_trials)
        order = (1, 2) if i % 2 == 0 else (2, 1)  # interleaved, so that a busy machine slows both alike
        took = {workers: sweep(pair, workers) for workers in order}
        ratios.append(took[1].seconds / took[2].seconds)
        bounds.append(2 * took[1].cpu_s / took[2].cpu_s)
        print(
            f"{len(pair.planned)} trials: {took[1].seconds:.1f} s with 1 worker, {took[2].seconds:.1f} s with 2: "
            f"{ratios[-1]:.2f}, {len(pair.planned) / took[2].seconds:.1f} a second; "
            f"CPU {took[1].cpu_s:.1f} s and {took[2].cpu_s:.1f} s: at most {bounds[-1]:.2f}"
        )
    print(f"two workers against one: {statistics.median(ratios):.2f} (median of {len(ratios)}; at least 1.7 wanted)")
    print(f"on idle cores at most: {statistics.median(bounds):.2f}")

    if options.quick:
        return

    short, long = (sized(options.experiment, n) for n in (options.trials // 10, options.trials))
    if len(short.planned) == len(long.planned):
        parser.error("--trials is too small: the short sweep and the long one are the same")
    short_s = sweep(short, 2).seconds
    folder = Path(ROOM.name) / "long"
    whole = sweep(long, 2, folder=folder, watched=True)
    long_s, memory = whole.seconds, whole.memory
    exponent = math.log(long_s / short_s) / math.log(len(long.planned) / len(short.planned))
    print(f"{len(short.planned)} trials in {short_s:.1f} s, {len(long.planned)} in {long_s:.1f} s")
    print(f"time grows with trials to the power of {exponent:.3f} (at most 1.05 wanted)")

    quarter = max(len(memory) // 4, 1)
    middle, end = max(memory[quarter : 2 * quarter] or memory), max(memory[-quarter:])
    print(f"memory of the largest worker: {max(memory) / 2**20:.0f} MB at most (below 1000 wanted)")
    print(f"its last quarter against its second: {end / middle:.3f} (flat: about 1)")

    seeds = ",".join(str(seed) for seed in long.axes["seed"])
    command = [
        sys.executable,
        "-m",
        "harness",
        "run",
        options.experiment,
        "--axis",
        f"seed={seeds}",
        "--out",
        str(folder),
    ]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # writes the report
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    print(f"resuming the finished run: {time.perf_counter() - begin:.2f} s (below 3 wanted)")


def sized(name: str, trials: int) -> Experiment:
    """The experiment with as many seeds as make at least so many trials."""
    a_seed = len(load_experiment(name, axes=["seed=1"]).planned)
    seeds = ",".join(str(seed + 1) for seed in range(math.ceil(trials / a_seed)))
    return load_experiment(name, axes=[f"seed={seeds}"])


@dataclass
class Took:
    """What a sweep took."""

    seconds: float = 0.0
    cpu_s: float = 0.0
    """CPU time of this process and of its workers, if it was not watched."""
    memory: list[int] = field(default_factory=list)
    """Resident bytes of the largest worker, twice a second."""


def sweep(
    experiment: Experiment,
    workers: int,
    *,
    folder: Path | None = None,
    most: int | None = None,
    watched: bool = False,
) -> Took:
    """Run a sweep with an empty cache, in a process of its own: one that has run a trial has threads of libraries, and
    its workers are not forks.

    watched : record the workers' memory. That takes a thread, too.
    """
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=lambda: send.send(_sweep(experiment, workers, folder, most, watched)))
    process.start()
    send.close()
    took: Took = receive.recv()
    process.join()
    return took


def _sweep(experiment: Experiment, workers: int, folder: Path | None, most: int | None, watched: bool) -> Took:
    RenderCache().clear()
    worker.forget()
    took, ended = Took(), threading.Event()
    watch = threading.Thread(target=_watch, args=(took, ended))
    with tempfile.TemporaryDirectory(dir=ROOM.name) as room:
        folder = folder or Path(room)
        folder.mkdir(exist_ok=True)
        with run.open_run(experiment, folder) as store:
            left = run.run_status(experiment, store).plan
            if most:
                left = type(left)(left.trials[:most], left.seconds[:most], left.new_geometry[:most])
            if watched:
                watch.start()
            begin, before = time.perf_counter(), sum(os.times()[:4])
            run.run_plan(left, store, backend_for(left.total_s, len(left.trials), workers))
            took.seconds, took.cpu_s = time.perf_counter() - begin, sum(os.times()[:4]) - before
            if watched:
                ended.set()
                watch.join()
    return took


def _watch(took: Took, ended: threading.Event) -> None:
    own = psutil.Process()
    while not ended.wait(0.5):
        sizes = [own.memory_info().rss]
        for child in own.children(recursive=True):
            try:
                sizes.append(child.memory_info().rss)
            except psutil.Error:  # it has just ended
                continue
        took.memory.append(max(sizes[1:] or sizes))


if __name__ == "__main__":
    main()
