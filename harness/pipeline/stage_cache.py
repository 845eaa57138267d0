"""Results of stages that trials share: the latest ones, by their keys."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Protocol, TypeVar, cast

T = TypeVar("T")

SIZES = dict.fromkeys(("render", "exposure", "colour", "project"), 4) | dict.fromkeys(("noise", "unwrap", "filter"), 8)
"""Number of results kept for each stage, two views per trial; `OTHERS` for all other stages, as they may be large.

With eight, what view 1 shows at each of three levels of noise is still there when the next baseline comes.
"""
OTHERS = 2
_MISSING: Any = object()


class Source(Protocol):
    """A slower store in which the results of a stage may lie, such as a disk."""

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result with this key, made if it is missing."""


class StageCache:
    """The latest results of the stages; the least recently used one is dropped first.

    Parameters
    ----------
    sizes
        Number of results kept for the stages named; `OTHERS` for all others.
    backing
        By stage, a store that is searched before a result is made.
    """

    def __init__(self, sizes: Mapping[str, int] = SIZES, backing: Mapping[str, Source] | None = None) -> None:
        self._sizes = sizes
        self._backing = backing or {}
        self._results: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, stage: str, key: Hashable, make: Callable[..., T]) -> T:
        """The result of a stage with this key, made if it is missing."""
        results = self._results.setdefault(stage, OrderedDict())
        result = results.pop(key, _MISSING)  # one look-up: keys are deep, and compared anew at each
        if result is _MISSING:
            if len(results) >= self._sizes.get(stage, OTHERS):
                results.popitem(last=False)  # before the new one is made: two cost volumes need not fit
            source = self._backing.get(stage)
            result = make() if source is None else source.get(key, make)
        results[key] = result
        return cast("T", result)
