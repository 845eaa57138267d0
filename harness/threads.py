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
    threads = threads or available_cpus()
    with ThreadPoolExecutor(max(threads - 1, 1)) as pool:  # which begins no thread before it is needed
        in_pool(pool, work, items, threads)


def in_pool(pool: ThreadPoolExecutor, work: Callable[[Item], None], items: Iterable[Item], threads: int) -> None:
    """The same with a pool's threads: each takes the next piece when it is free.

    A task of the pool for each would take 20 microseconds of the interpreter's time, which threads have to share.
    """
    left = deque(items)

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

    begun = [pool.submit(work_off) for _ in range(min(threads, len(left)) - 1)]
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
