"""Sums of path costs over a panorama, and the best label of every pixel.

Paths come from above and from below at the same time, each first through its own half of the rows, then through the
other's, where all sums become complete: two threads help.

Matching costs and sums of a large panorama would take gigabytes. There the costs are made in bands of rows. In its own
half a side leaves nothing but the state of its paths at the border of every band; when the other side comes to a band,
the costs of the band are made again and the paths followed through it again. All numbers are whole: they are the same.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.matching.semi_global import _semi_global_kernels as kernels
from harness.threads import in_threads

LARGE_BYTES = 200_000_000
"""Size of the matching costs, a byte for every pixel and label, above which they are made in bands: that takes half as
long again."""
_BAND_BYTES = 16_000_000
"""Size of a band's costs."""

Interval = tuple[int, NDArray[np.int32], NDArray[np.int32]]
"""k_0, the sample that is the first label, and the samples to choose from, k_first and k_last, `[height, width]`."""
Best = tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.uint16]]
"""best, nearby and second of all pixels, as in `SearchResult`."""
Compare = Callable[[int, int, int, NDArray[np.uint8]], None]
"""`compare(first, end, top, costs)` writes the costs of rows first .. end; `costs` begins with row `top`."""


@dataclass(frozen=True, repr=False)
class Rules(OneLine):
    """What changes of the label cost along a path, in halves of a bit."""

    p2: NDArray[np.uint8]
    """`[4, height, width]`, from `jumps`."""
    p1: int
    paths: int
    """4 or 8."""

    @property
    def sideways(self) -> NDArray[np.int64]:
        """How many columns each path moves with every row."""
        return np.array([0] if self.paths == 4 else [0, 1, -1])

    @property
    def sum_type(self) -> type[np.uint8] | type[np.uint16]:
        """A path cost fits into 8 bits, the sum of three does not."""
        return np.uint8 if self.paths == 4 else np.uint16


class _Memory(threading.local):
    """Arrays that a thread reuses for its next pair: fresh memory takes longer to get than to fill."""

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}


_reused = _Memory()


def reused(name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> NDArray[Any]:
    """An uninitialised array, valid until this thread asks for one of this name again."""
    array = _reused.arrays.get(name)
    if array is None or array.shape != shape or array.dtype != dtype:
        array = _reused.arrays[name] = np.empty(shape, dtype)
    return array


def forget_reused() -> None:
    """Give back what this thread reuses."""
    _reused.arrays.clear()


def aggregate(
    costs: NDArray[np.uint8], interval: Interval, rules: Rules, threads: int, sums: NDArray[np.uint16] | None = None
) -> Best:
    """Follow the paths, add up their costs, and take the best label of each pixel.

    Parameters
    ----------
    costs
        `[height, width, labels]`, halves of a bit.
    sums
        Written if given, `[height, width, labels]`: the sums over all paths.
    """
    height = costs.shape[0]
    half_sums = reused("half sums", costs.shape, rules.sum_type)
    best = _nothing(costs.shape)
    sides = [_Side(costs.shape, rules) for _ in range(2)]
    middle = height // 2
    own = [(0, middle), (middle, height)]

    def begin_from(side: int) -> None:
        sides[side].follow(costs, own[side], 0, side == 0, half_sums)

    def continue_from(side: int) -> None:
        sides[side].complete(costs, own[1 - side], 0, side == 0, half_sums, interval, best, sums)

    in_threads(begin_from, (0, 1), threads)
    in_threads(continue_from, (0, 1), threads)
    return best


def aggregate_in_bands(
    compare: Compare,
    shape: tuple[int, int, int],
    interval: Interval,
    rules: Rules,
    threads: int,
    band_bytes: int = _BAND_BYTES,
) -> Best:
    """The same as `aggregate`, of costs that are never there all at once.

    Parameters
    ----------
    shape
        `(height, width, labels)` of all costs.
    band_bytes
        Size of the costs of a band.
    """
    height, width, labels = shape
    rows = max(1, band_bytes // (width * labels))
    middle = height // 2
    bands = [  # of the rows above the middle and below it, from the border of the panorama inwards
        [(first, min(first + rows, middle)) for first in range(0, middle, rows)],
        [(max(end - rows, middle), end) for end in range(height, middle, -rows)],
    ]
    best = _nothing(shape)
    sides = [_Side(shape, rules) for _ in range(2)]
    waiting: list[list[_Side]] = [[], []]

    def costs_of(band: tuple[int, int], memory: NDArray[np.uint8]) -> NDArray[np.uint8]:
        costs = memory[: band[1] - band[0]]
        compare(*band, band[0], costs)
        return costs

    def begin_from(side: int) -> None:
        memory = np.empty((rows, width, labels), np.uint8)
        unused = np.empty((rows, width, labels), rules.sum_type)
        for band in bands[side]:
            waiting[side].append(sides[side].copy())
            sides[side].follow(costs_of(band, memory), band, band[0], side == 0, unused)

    def continue_from(side: int) -> None:
        memory = np.empty((rows, width, labels), np.uint8)
        half_sums = np.empty((rows, width, labels), rules.sum_type)
        other = 1 - side
        for band in reversed(bands[other]):
            costs = costs_of(band, memory)
            waiting[other].pop().follow(costs, band, band[0], other == 0, half_sums)
            sides[side].complete(costs, band, band[0], side == 0, half_sums, interval, best)

    in_threads(begin_from, (0, 1), threads)
    in_threads(continue_from, (0, 1), threads)
    return best


def _nothing(shape: tuple[int, ...]) -> Best:
    height, width = shape[:2]
    return (
        np.empty((height, width), np.int32),
        np.zeros((height, width, 3), np.uint16),
        np.zeros((height, width), np.uint16),
    )


class _Side:
    """The paths that come from above, or from below: what they cost in the last row that they have covered."""

    def __init__(self, shape: tuple[int, ...], rules: Rules) -> None:
        _, width, labels = shape
        self.rules = rules
        self.guard = 255 - rules.p1
        self.done = 0
        self.state = np.full((2, rules.sideways.size, width, labels + 2), self.guard, np.uint8)
        self.least = np.zeros((2, rules.sideways.size, width), np.uint8)

    def copy(self) -> "_Side":
        """The paths as they stand."""
        other = _Side.__new__(_Side)
        other.rules, other.guard, other.done = self.rules, self.guard, self.done
        other.state, other.least = self.state.copy(), self.least.copy()
        return other

    def follow(
        self, costs: NDArray[np.uint8], band: tuple[int, int], top: int, downwards: bool, half_sums: NDArray[Any]
    ) -> None:
        """Go on through a band of rows; `costs` and `half_sums`, which is written, begin with row `top`."""
        first, end = band
        kernels.first_half(
            costs, first - top if downwards else end - 1 - top, end - first, self.done, downwards,
            self.rules.sideways, np.uint8(self.rules.p1), self._jumps(top, len(costs)), self.state, self.least,
            half_sums,
        )  # fmt: skip
        self.done += end - first

    def complete(
        self,
        costs: NDArray[np.uint8],
        band: tuple[int, int],
        top: int,
        downwards: bool,
        half_sums: NDArray[Any],
        interval: Interval,
        best: Best,
        sums: NDArray[np.uint16] | None = None,
    ) -> None:
        """Go on through a band that the other side's paths, in `half_sums`, have covered, and take the best labels."""
        (first, end), (_, width, labels) = band, costs.shape
        k_0, *limits = interval
        rows = slice(top, top + len(costs))
        kernels.second_half(
            costs, first - top if downwards else end - 1 - top, end - first, self.done, downwards,
            self.rules.sideways, np.uint8(self.rules.p1), self._jumps(top, len(costs)), self.state, self.least,
            half_sums, np.full((2, width, labels + 2), self.guard, np.uint8),
            np.full((1, 1, labels + 2), self.guard, np.uint8),
            np.empty((1, width, labels), np.uint16) if sums is None else sums,
            k_0, *(each[rows] for each in limits), *(each[rows] for each in best),
        )  # fmt: skip
        self.done += end - first

    def _jumps(self, top: int, rows: int) -> NDArray[np.uint8]:
        """P2 of these rows and of the one below, as that holds the jumps to it."""
        return np.ascontiguousarray(self.rules.p2[:, top : top + rows + 1])
