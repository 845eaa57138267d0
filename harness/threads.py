"""Independent pieces of work on several threads. They pay where the work releases the GIL, as compiled loops do."""

import itertools
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from harness.machine import available_cpus

Item = TypeVar("Item")


def in_threads(work: Callable[[Item], None], items: Iterable[Item], threads: int | None) -> None:
    """Do independent pieces of work, which release the GIL, on some threads; all available CPUs when None.

    The calling thread is one of them: to begin another takes as long as to fill a hundred kilobytes.
    """
    left = deque(items)
    others = min(threads or available_cpus(), len(left)) - 1

    def work_off() -> None:
        while True:
            try:
                item = left.popleft()
            except IndexError:  # all are done, or under way
                return
            try:
                work(item)
            except BaseException:
                left.clear()  # what has not begun is left
                raise

    with ThreadPoolExecutor(max(others, 1)) as pool:  # which begins no thread before it is needed
        begun = [pool.submit(work_off) for _ in range(others)]
        work_off()
        for each in begun:
            each.result()


def in_bands(work: Callable[[int, int], None], length: int, bands: int, threads: int | None) -> None:
    """Call `work(first, end)` for contiguous bands that together cover `0 .. length`; see `in_threads`.

    None is empty: of a length of 0 there are none.
    """
    if length < 1:
        return
    edges = np.linspace(0, length, max(1, min(bands, length)) + 1).astype(int).tolist()
    in_threads(lambda band: work(*band), itertools.pairwise(edges), threads)
