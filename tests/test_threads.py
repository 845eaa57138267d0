"""Work shared by threads: everything is done once, and what goes wrong is said."""

import threading

import pytest

from harness.threads import in_bands, in_threads


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_every_piece_is_done_once(threads, count):
    done = []
    in_threads(done.append, range(count), threads)
    assert sorted(done) == list(range(count))


def test_no_more_threads_are_at_work_than_there_may_be():
    """The calling thread is one of them; both have to meet, and a third never comes."""
    both, at_work = threading.Barrier(2, timeout=30), set()

    def work(_: int) -> None:
        at_work.add(threading.get_ident())
        both.wait()

    in_threads(work, range(2), 2)
    assert len(at_work) == 2
    assert threading.get_ident() in at_work


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("kind", [IndexError, KeyboardInterrupt])
def test_an_error_is_raised_and_what_has_not_begun_is_left(threads, kind):
    done = []

    def work(number: int) -> None:
        if number == 1:
            raise kind(number)
        done.append(number)

    with pytest.raises(kind):
        in_threads(work, range(1000), threads)
    assert 1 not in done
    assert len(done) < 999 or threads > 1  # others may have been quicker


def test_an_error_of_another_thread_stops_this_one():
    failed, done = threading.Event(), []
    caller = threading.get_ident()

    def work(number: int) -> None:
        if threading.get_ident() != caller:
            failed.set()
            raise ValueError(number)
        assert failed.wait(timeout=30)
        done.append(number)

    with pytest.raises(ValueError, match=r"^\d+$"):
        in_threads(work, range(1000), 2)
    assert len(done) < 999


@pytest.mark.parametrize(("length", "bands"), [(0, 3), (1, 3), (10, 3), (10, 1), (3, 10)])
def test_bands_cover_everything_in_order(length, bands):
    covered = []
    in_bands(lambda first, end: covered.append((first, end)), length, bands, 1)
    assert [row for first, end in covered for row in range(first, end)] == list(range(length))
    assert all(first < end for first, end in covered)
