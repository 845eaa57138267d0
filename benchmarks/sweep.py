"""What a sweep costs: two workers against one, time against the number of trials, memory of a worker, and resuming.

    python benchmarks/sweep.py                     # the law at full size: an hour or more
    python benchmarks/sweep.py --trials 200 --pair-trials 84 --pairs 3

The number of trials is set by the number of seeds. Every measured sweep begins with an empty cache of renders.
"""

import argparse
import math
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOM = tempfile.TemporaryDirectory(prefix="omnirange-benchmark-")
os.environ["OMNIRANGE_CACHE"] = f"{ROOM.name}/cache"
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import psutil  # noqa: E402

from harness.experiments import run, worker  # noqa: E402
from harness.experiments.cache import RenderCache  # noqa: E402
from harness.experiments.executors import workplace  # noqa: E402
from harness.experiments.experiment import Experiment, load_experiment  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", nargs="?", default="law", help="one with an axis 'seed'")
    parser.add_argument("--trials", type=int, default=2000, help="of the long sweep; the short one has a tenth")
    parser.add_argument("--pair-trials", type=int, default=200, help="of a sweep with one worker and one with two")
    parser.add_argument("--pairs", type=int, default=5)
    options = parser.parse_args()

    sized(options.experiment, 1)  # compile everything, in this process
    warm = sized(options.experiment, 1)
    sweep(warm, 1, most=4)

    ratios = []
    for i in range(options.pairs):
        pair = sized(options.experiment, options.pair_trials)
        order = (1, 2) if i % 2 == 0 else (2, 1)  # interleaved, so that a busy machine slows both alike
        seconds = {workers: sweep(pair, workers)[0] for workers in order}
        ratios.append(seconds[1] / seconds[2])
        print(
            f"{len(pair.planned)} trials: {seconds[1]:.1f} s with 1 worker, {seconds[2]:.1f} s with 2: {ratios[-1]:.2f}"
        )
    print(f"two workers against one: {statistics.median(ratios):.2f} (median of {len(ratios)}; at least 1.7 wanted)")

    short, long = (sized(options.experiment, n) for n in (options.trials // 10, options.trials))
    short_s, _ = sweep(short, 2)
    folder = Path(ROOM.name) / "long"
    long_s, memory = sweep(long, 2, folder=folder)
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


def sweep(
    experiment: Experiment, workers: int, *, folder: Path | None = None, most: int | None = None
) -> tuple[float, list[int]]:
    """Seconds of a sweep with an empty cache, and the resident bytes of its largest worker, twice a second."""
    RenderCache().clear()
    worker.forget()
    memory: list[int] = []
    ended = threading.Event()
    watch = threading.Thread(target=_watch, args=(memory, ended))
    with tempfile.TemporaryDirectory(dir=ROOM.name) as room:
        folder = folder or Path(room)
        folder.mkdir(exist_ok=True)
        with run.open_run(experiment, folder) as store:
            left = run.standing(experiment, store).plan
            if most:
                left = type(left)(left.trials[:most], left.seconds[:most])
            watch.start()
            begin = time.perf_counter()
            run.sweep(left, store, workplace(left.total_s, len(left.trials), workers))
            seconds = time.perf_counter() - begin
            ended.set()
            watch.join()
    return seconds, memory


def _watch(memory: list[int], ended: threading.Event) -> None:
    own = psutil.Process()
    while not ended.wait(0.5):
        sizes = [own.memory_info().rss]
        for child in own.children(recursive=True):
            try:
                sizes.append(child.memory_info().rss)
            except psutil.Error:  # it has just ended
                continue
        memory.append(max(sizes[1:] or sizes))


if __name__ == "__main__":
    main()
