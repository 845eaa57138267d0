"""Work shared with a copy of this process, which has all loaded modules and data already.

A copy is a fork. Its threads are gone, so it only computes the requested results, prints nothing, and ends at once.
Results that it has not computed when it ends, for whatever reason, are computed here: no result depends on it.
"""

import os
import pickle
import select
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import IO, TypeVar

from harness.machine import can_be_copied

T = TypeVar("T")

_PATIENCE_S = 20.0
"""Seconds to wait for a copy when there is nothing left to do here; the time worked before, if that is longer."""


def made_with_a_copy(
    make: Callable[[int], T],
    numbers: Sequence[int],
    begun: Callable[[int], None] = lambda _: None,
    *,
    may_copy: bool = True,
) -> dict[int, T]:
    """The result of `make` for each number, some computed by a copy of this process where the system allows that.

    Parameters
    ----------
    make
        Its result must not depend on earlier calls. One that cannot be pickled is computed here.
    numbers
        Each between 0 and 255, in the order in which they are begun.
    begun
        Called whenever a number is begun here, with the count of those begun before.
    may_copy
        False to compute all results here.
    """
    if not (may_copy and can_be_copied()):
        return {number: _observed(make, begun, number, i) for i, number in enumerate(numbers)}
    waiting, put = os.pipe()
    os.write(put, bytes(numbers))
    os.close(put)
    begin = time.monotonic()
    with tempfile.TemporaryFile() as answers, os.fdopen(waiting, "rb", buffering=0) as left:
        ended, ending = os.pipe()
        pid = _copy()
        if pid == 0:
            _help(make, left, answers)
        os.close(ending)
        try:
            made = {number: _observed(make, begun, number, numbers.index(number)) for number in _taken(left)}
            select.select([ended], [], [], max(_PATIENCE_S, time.monotonic() - begin))
        finally:
            os.close(ended)
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        made |= _read(answers)
    return {number: made[number] if number in made else make(number) for number in numbers}


def _observed(make: Callable[[int], T], begun: Callable[[int], None], number: int, before: int) -> T:
    begun(before)
    return make(number)


def _copy() -> int:
    with warnings.catch_warnings():
        # Python 3.12 and later warn about forks beside threads. The copy waits for no lock that one of them might hold;
        # if a library does, this process does not wait for the copy.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _taken(left: IO[bytes]) -> Iterator[int]:
    """The numbers that the other process has not taken, one by one: each byte of a pipe is read by one process."""
    while taken := left.read(1):
        yield taken[0]


def _help(make: Callable[[int], T], left: IO[bytes], answers: IO[bytes]) -> None:
    """Do the copy's part of the work, and end the process; never returns."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that was copied, which ends this one
        pickle.dump({number: make(number) for number in _taken(left)}, answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()
    finally:
        os._exit(0)


def _read(answers: IO[bytes]) -> dict[int, T]:
    """The results of the copy by number; empty if it did not finish."""
    answers.seek(0)
    try:
        return dict(pickle.load(answers))  # noqa: S301 - written by this program, in a file without a name
    except (EOFError, pickle.UnpicklingError):
        return {}
