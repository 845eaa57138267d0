"""A cache of results that depend on files: files are recorded when opened, and a result is valid until one changes.

A scene's identity (`fingerprint`) is computed from this record, so that it cannot miss a file that was read.
"""

import hashlib
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import update_wrapper
from pathlib import Path
from typing import Generic, ParamSpec, TypeVar, cast

from harness.errors import InputError
from harness.files import read_regular

P = ParamSpec("P")
T = TypeVar("T")

_SETTLED_NS = 2 * 10**9
"""A file that was written less than this before it was read may change again without a new time stamp: two seconds is
the coarsest resolution of a file system's clock (FAT)."""


@dataclass(frozen=True)
class FileRead:
    """A file as it was when it was read."""

    path: str
    sha256: str
    """Hash of its contents, hexadecimal."""
    stamp: tuple[int, ...]
    """Size, times and identity on the disk."""
    settled: bool
    """Whether an equal stamp suffices as evidence that the contents are unchanged."""

    def again(self) -> "FileRead | None":
        """The current record of the file; None when its contents have changed."""
        try:
            if self.settled and _stamp(self.path) == self.stamp:
                return self
            _, now = _read(self.path, self.stamp[0], "file")
        except (InputError, OSError):
            return None
        return now if now.sha256 == self.sha256 else None


def read_recorded(path: str | Path, limit_bytes: int, what: str) -> bytes:
    """Read a file as `files.read_regular`, and record it."""
    data, file = _read(str(path), limit_bytes, what)
    _record([file])
    return data


@contextmanager
def recording() -> Iterator[list[FileRead]]:
    """A context that lists the files read within it by this thread through `read_recorded`, in order."""
    files: list[FileRead] = []
    _stack().append(files)
    try:
        yield files
    finally:
        _stack().pop()
        _record(files)


class Cached(Generic[P, T]):
    """A function with cached results; see `cached_by_content`."""

    def __init__(self, function: Callable[P, T], maxsize: int) -> None:
        self._function = function
        self._maxsize = maxsize
        self._results: OrderedDict[Hashable, tuple[T, tuple[FileRead, ...]]] = OrderedDict()
        self._lock = threading.Lock()
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """The function's result, cached or computed."""
        assert not kwargs
        key = cast("Hashable", args)
        with self._lock:
            held = self._results.get(key)
        now = None if held is None else [file.again() for file in held[1]]
        if held is not None and now is not None and None not in now:
            result, files = held[0], tuple(file for file in now if file is not None)
            _record(files)
        else:
            with recording() as read:
                result = self._function(*args, **kwargs)
            files = tuple(dict.fromkeys(read))
        with self._lock:
            self._results[key] = result, files
            self._results.move_to_end(key)
            if len(self._results) > self._maxsize:
                self._results.popitem(last=False)
        return result

    def cache_clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._results.clear()


def cached_by_content(maxsize: int) -> Callable[[Callable[P, T]], Cached[P, T]]:
    """A decorator like `functools.lru_cache` whose results are valid only until a file that they depend on changes.

    Parameters
    ----------
    maxsize
        Number of results to keep, the most recently used. Arguments must be positional and hashable.
    """
    return lambda function: Cached(function, maxsize)


_local = threading.local()


def _stack() -> list[list[FileRead]]:
    return cast("list[list[FileRead]]", _local.__dict__.setdefault("stack", []))


def _record(files: Iterable[FileRead]) -> None:
    if _stack():
        _stack()[-1].extend(files)


def _read(path: str, limit_bytes: int, what: str) -> tuple[bytes, FileRead]:
    try:
        stamp = _stamp(path)  # before it is read: a change meanwhile shows
    except (OSError, ValueError):
        stamp = ()
    data = read_regular(path, limit_bytes, what)
    settled = bool(stamp) and time.time_ns() - max(stamp[1:3]) > _SETTLED_NS
    return data, FileRead(path, hashlib.sha256(data).hexdigest(), stamp or (len(data),), settled)


def _stamp(path: str) -> tuple[int, ...]:
    status = os.stat(path)  # noqa: PTH116 - the name is opened unresolved
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_dev
