"""A sign of life on a terminal while a command is silent, as it loads libraries or computes."""

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from harness.api.progress import duration
from harness.machine import FORK_SAFE

SILENCE_S = 1.5
"""Longest silence on a terminal, seconds; people begin to wonder at about two seconds."""
_EVERY_S = 0.25


class Heard:
    """A wrapper of a stream that knows when it was last written to, and clears the sign of life first."""

    def __init__(self, stream: TextIO, pulse: "Pulse") -> None:
        self._stream = stream
        self._pulse = pulse

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, in place of a sign of life."""
        with self._pulse.lock:
            self._pulse.clear()
            return self._stream.write(text)


class Pulse:
    """Writes and clears the sign of life."""

    def __init__(self, stream: TextIO) -> None:
        self.lock = threading.RLock()
        self._stream = stream
        self._shown = 0
        self._text = ""
        self._last = time.monotonic()

    def clear(self) -> None:
        """Take the sign away, and note that something is being said."""
        if self._shown:
            self._stream.write(f"\r{'':<{self._shown}}\r")
            self._stream.flush()
        self._shown = 0
        self._last = time.monotonic()

    def beat(self) -> None:
        """Show for how long nothing has been said, if that is long."""
        with self.lock:
            silent = time.monotonic() - self._last
            if silent < SILENCE_S:
                return
            text = f"working, {duration(float(round(silent)))}"
            if text == self._text and self._shown:
                return
            self._text = text
            self._stream.write(f"\r{text:<{self._shown}}")
            self._stream.flush()
            self._shown = max(self._shown, len(text))


_beating: list[Pulse] = []
"""The pulse that beats, if any."""


def _hold() -> None:
    for pulse in _beating:
        pulse.lock.acquire()


def _let_go() -> None:
    for pulse in _beating:
        pulse.lock.release()


if hasattr(os, "register_at_fork"):  # no fork finds the thread in the middle of a write
    os.register_at_fork(before=_hold, after_in_parent=_let_go, after_in_child=_let_go)


@contextmanager
def heartbeat() -> Iterator[None]:
    """Say on a terminal that a command is at work whenever it has been silent for long; nothing elsewhere."""
    out, err = sys.stdout, sys.stderr
    if not all(stream is not None and stream.isatty() for stream in (out, err)):
        yield
        return
    pulse, ended = Pulse(err), threading.Event()
    sys.stdout, sys.stderr = (Heard(stream, pulse) for stream in (out, err))

    def beat() -> None:
        while not ended.wait(_EVERY_S):
            pulse.beat()

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    _beating.append(pulse)
    FORK_SAFE.add(thread.native_id or 0)
    try:
        yield
    finally:
        ended.set()
        thread.join()
        FORK_SAFE.discard(thread.native_id or 0)
        _beating.remove(pulse)
        with pulse.lock:
            pulse.clear()
        sys.stdout, sys.stderr = out, err
