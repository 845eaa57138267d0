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
from contextlib import ExitStack, contextmanager
from typing import IO, Any, TypeVar

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
    with os.fdopen(waiting, "rb", buffering=0) as left:

        def in_turn() -> dict[int, T]:
            return {number: make(number) for number in _taken(left)}

        with _copied(in_turn) as of_copy:
            made = {number: _observed(make, begun, number, numbers.index(number)) for number in _taken(left)}
            made |= of_copy() or {}
    return {number: made[number] if number in made else make(number) for number in numbers}


@contextmanager
def begun_in_a_copy(make: Callable[[], T], *, may_copy: bool = True) -> Iterator[Callable[[], T]]:
    """Let a copy of this process make something meanwhile, where the system allows that.

    Yields a function that waits for it and returns it, made here if the copy did not succeed. It is to be called once.

    Parameters
    ----------
    make
        Its result is made here if it cannot be pickled. It is never None.
    may_copy
        False to make it here, when it is asked for.
    """
    if not (may_copy and can_be_copied()):
        yield make
        return
    with _copied(make) as of_copy:

        def result() -> T:
            made = of_copy()
            return make() if made is None else made

        yield result


@contextmanager
def _copied(make: Callable[[], T]) -> Iterator[Callable[[], T | None]]:
    """Begin a copy, and end it in the end.

    Yields a function that waits for what the copy makes, and ends it; None if it made nothing in that time.
    """
    begin = time.monotonic()
    with tempfile.TemporaryFile() as answer, ExitStack() as until_it_ends:
        ended, ending = os.pipe()
        pid = _copy()
        if pid == 0:
            _help(make, answer)
        os.close(ending)
        until_it_ends.callback(os.waitpid, pid, 0)
        until_it_ends.callback(os.kill, pid, signal.SIGKILL)
        until_it_ends.callback(os.close, ended)

        def result() -> T | None:
            select.select([ended], [], [], max(_PATIENCE_S, time.monotonic() - begin))
            until_it_ends.close()  # before its file is read, as they share the place in it
            return _read(answer)

        yield result


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


def _help(make: Callable[[], object], answer: IO[bytes]) -> None:
    """Do the copy's part of the work, and end the process; never returns."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that was copied, which ends this one
        pickle.dump(make(), answer, pickle.HIGHEST_PROTOCOL)
        answer.flush()
    finally:
        os._exit(0)


def _read(answer: IO[bytes]) -> Any:
    """What the copy made; None if it did not finish."""
    answer.seek(0)
    try:
        return pickle.load(answer)  # noqa: S301 - written by this program, in a file without a name
    except (EOFError, pickle.UnpicklingError):
        return None
