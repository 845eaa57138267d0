"""Work that is shared with a copy of the process: the same whatever becomes of the copy."""

import os
import signal
import threading
import time
import warnings

import pytest

from harness import copies, machine
from harness.copies import begun_in_a_copy, made_with_a_copy

NUMBERS = range(3, 23)
HERE = os.getpid()

pytestmark = pytest.mark.skipif(not machine.can_be_copied(), reason="no copies here: another system, or one CPU")


def is_copy() -> bool:
    return os.getpid() != HERE


def slowly(number: int) -> tuple[int, bool]:
    time.sleep(0.01)
    return number**2, is_copy()


def test_both_make_some_and_all_are_made() -> None:
    begun: list[int] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = made_with_a_copy(slowly, NUMBERS, begun.append)
    assert list(made) == list(NUMBERS)
    assert all(square == number**2 for number, (square, _) in made.items())
    assert {by_copy for _, by_copy in made.values()} == {True, False}
    here = [number - NUMBERS[0] for number, (_, by_copy) in made.items() if not by_copy]
    assert begun == here  # what is begun here is told here


def test_without_copies_all_is_made_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copies, "can_be_copied", lambda: False)
    begun: list[int] = []
    assert made_with_a_copy(slowly, NUMBERS, begun.append) == {number: (number**2, False) for number in NUMBERS}
    assert begun == list(range(len(NUMBERS)))


def dies(number: int) -> tuple[int, bool]:
    if is_copy():
        os.kill(os.getpid(), signal.SIGKILL)
    return slowly(number)


def raises(number: int) -> tuple[int, bool]:
    if is_copy():
        raise ValueError(number)
    return slowly(number)


def sends_what_cannot_be_sent(number: int) -> object:
    return threading.Lock() if is_copy() else slowly(number)


@pytest.mark.parametrize("make", [dies, raises, sends_what_cannot_be_sent])
def test_what_a_copy_fails_to_make_is_made_here(make) -> None:
    assert made_with_a_copy(make, NUMBERS) == {number: (number**2, False) for number in NUMBERS}


def test_a_copy_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copies, "_PATIENCE_S", 0.05)

    def hangs(number: int) -> tuple[int, int]:
        if is_copy():
            time.sleep(600)
        return slowly(number)

    assert made_with_a_copy(hangs, NUMBERS) == {number: (number**2, False) for number in NUMBERS}


def test_ctrl_c_ends_the_copy_too(monkeypatch: pytest.MonkeyPatch) -> None:
    copied: list[int] = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: copied.append(fork()) or copied[0])

    def interrupted(_: int) -> None:
        if is_copy():
            time.sleep(600)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made_with_a_copy(interrupted, NUMBERS)
    with pytest.raises(ProcessLookupError):
        os.kill(copied[0], 0)


def whose() -> tuple[str, bool]:
    return "made", is_copy()


@pytest.mark.parametrize("may_copy", [True, False])
def test_a_copy_makes_something_meanwhile(*, may_copy: bool) -> None:
    with begun_in_a_copy(whose, may_copy=may_copy) as result:
        assert result() == ("made", may_copy)


@pytest.mark.parametrize("make", [dies, raises, sends_what_cannot_be_sent])
def test_what_a_copy_fails_to_make_meanwhile_is_made_here(make) -> None:
    with begun_in_a_copy(lambda: make(7)) as result:
        assert result() == (49, False)


def test_a_copy_that_nobody_asks_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    copied: list[int] = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: copied.append(fork()) or copied[0])
    with pytest.raises(KeyboardInterrupt), begun_in_a_copy(lambda: time.sleep(600)):
        raise KeyboardInterrupt
    with pytest.raises(ProcessLookupError):
        os.kill(copied[0], 0)
