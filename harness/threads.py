"""Independent pieces of work on several threads. They pay where the work releases the GIL, as compiled loops do."""

import itertools
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from harness.machine import available_cpus

Item = TypeVar("Item")


def in_threads(work: Callable[[Item], None], items: Iterable[Item], threads: int | None) -> None:
    """Do independent pieces of work, which release the GIL, on some threads; all available CPUs when None."""
    count = threads or available_cpus()
    items = list(items)
    if count == 1 or len(items) <= 1:
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(count) as pool:
        for future in [pool.submit(work, item) for item in items]:
            future.result()


def in_bands(work: Callable[[int, int], None], length: int, bands: int, threads: int | None) -> None:
    """Call `work(first, end)` for contiguous bands that together cover `0 .. length`; see `in_threads`."""
    edges = np.linspace(0, length, max(1, min(bands, length)) + 1).astype(int).tolist()
    in_threads(lambda band: work(*band), itertools.pairwise(edges), threads)
