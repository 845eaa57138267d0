"""Loaded once by the process that workers are forked from, instead of by each of them."""

import sys
from types import TracebackType

import harness.runs.worker  # noqa: F401 - what takes time

_ORPHANED = (EOFError, FileNotFoundError, ConnectionError)
"""Errors of a worker that starts when its parent has ended, after Ctrl-C: a closed pipe, or a lock that is gone."""


def _say_unless_orphaned(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if not issubclass(kind, _ORPHANED):
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _say_unless_orphaned
