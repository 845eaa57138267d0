"""Handling of Ctrl-C such that it is never lost.

Python raises KeyboardInterrupt wherever the program happens to be. In the callback of a weak reference it is dropped,
and libraries that catch everything drop it, or wrap it into an error of their own. So the signal is also remembered,
and code that is about to continue, or to report a failure, checks that record first.
"""

import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from harness.first_moment import EXIT_CODE, end, end_at_once

__all__ = ["EXIT_CODE", "asked", "check", "end_at_once", "heard", "is_real"]

_SAME_S = 0.3
"""Signals within this time are one Ctrl-C: a terminal sends it to a whole group, and a launcher may pass it on too."""

_asked_at: list[float] = []
"""When Ctrl-C was pressed since `heard` was entered."""


@contextmanager
def heard() -> Iterator[None]:
    """Remember Ctrl-C, and raise KeyboardInterrupt at the end if it was swallowed or changed inside.

    A second Ctrl-C ends the process.

    Nothing is changed outside the main thread, where signals are somebody else's, or when a handler that is not
    Python's own is there already, this one among them.
    """
    if threading.current_thread() is not threading.main_thread() or not _is_ours_to_take():
        yield
        return
    before, hook, show = signal.getsignal(signal.SIGINT), sys.unraisablehook, warnings.showwarning

    def show_unless_asked(*of: Any, **more: Any) -> None:
        # A library that swallowed the interrupt may warn about the consequences: pydantic does.
        if not _asked_at:
            show(*of, **more)

    _asked_at.clear()
    sys.unraisablehook = _silent_when_asked
    warnings.showwarning = show_unless_asked
    signal.signal(signal.SIGINT, _on_signal)
    try:
        yield
        check()
    except BaseException as error:
        if _asked_at and not isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook
        warnings.showwarning = show
        _asked_at.clear()


def check() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed, however long ago."""
    if _asked_at:
        raise KeyboardInterrupt


def asked() -> bool:
    """Whether Ctrl-C was pressed."""
    return bool(_asked_at)


def is_real(error: BaseException) -> bool:
    """Whether an error is due to Ctrl-C: one that was pressed, or that nobody here could have remembered.

    A KeyboardInterrupt that somebody's code raises of itself is an error like any other.
    """
    if _asked_at:
        return True
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    return signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, _on_signal)


def _is_ours_to_take() -> bool:
    return signal.getsignal(signal.SIGINT) in (signal.default_int_handler, end_at_once)


def _on_signal(_number: int, _frame: FrameType | None) -> None:
    now = time.monotonic()
    if _asked_at and now - _asked_at[0] > _SAME_S:
        end("omnirange: stopped at once; finished trials are stored")
    _asked_at.append(now)
    raise KeyboardInterrupt


def _silent_when_asked(unraisable: Any) -> None:
    """Silence errors in destructors and callbacks that follow from Ctrl-C."""
    if not _asked_at:
        sys.__unraisablehook__(unraisable)
