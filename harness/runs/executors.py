"""The executors that run trials: this process, processes of this machine, or a Dask cluster."""

import logging
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

from harness import interrupts
from harness.errors import InputError
from harness.machine import available_cpus, has_one_thread

QUICK_S = 4.0
"""Work below which more processes cost more than they save: each takes a second to start."""
QUICK_WHEN_FORKED_S = 1.0
"""The same where workers are forks of this process, and have loaded all that it has."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process that does one thing at a time; read when the libraries are imported."""

WORKER = {**ONE_THREAD, "OMNIRANGE_WORKER": "1"}
"""Environment of a worker, which leaves notices that concern all workers to its parent."""


@dataclass(frozen=True)
class Backend:
    """An executor of batches, with the interface of `concurrent.futures`, and its limits."""

    open: Callable[[], AbstractContextManager[Executor]]
    """Called again when the executor is broken."""
    workers: int
    slots: int
    """The most batches submitted and not yet returned."""
    threads: int | None = 1
    """The threads of a trial."""
    remote: bool = False
    """Whether workers may be on another machine, which does not have this one's files."""
    name: str = "in this process"


def backend_for(work_s: float, trials: int, workers: int | None = None, dask: str | None = None) -> Backend:
    """The backend that suits this much work.

    Parameters
    ----------
    work_s
        Seconds on one thread, a guess.
    trials
        Number of trials to run.
    workers
        As requested; None for as many as save time.
    dask
        Address of a scheduler.

    Raises
    ------
    InputError
        When Dask is not installed, or there is no scheduler or worker; or when more than one worker is requested in a
        process that may not start any.
    """
    if dask is not None:
        return _on_dask(dask)
    if multiprocessing.current_process().daemon:
        if workers not in (None, 1):
            raise InputError(
                "cannot be started here: this is a daemon process, such as one of multiprocessing.Pool, which may not "
                "have children; give workers=1, or run the experiment outside the pool",
                key="workers",
            )
        workers = 1
    quick_s = QUICK_WHEN_FORKED_S if _start_method() == "fork" else QUICK_S
    if workers is None and (work_s < quick_s or trials < 2 or available_cpus() == 1):
        return Backend(_in_process, workers=1, slots=1, threads=None)
    count = min(workers or available_cpus(), trials)
    if count == 1:
        return Backend(_in_process, workers=1, slots=1)
    # Some batches for each to go on with while this process is busy, too.
    return Backend(lambda: _in_processes(count), count, slots=3 * count, name=f"in {count} processes")


@contextmanager
def _in_process() -> Iterator[Executor]:
    yield _InProcess()


class _InProcess(Executor):
    """An executor that runs each call when it is submitted, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - to be raised where the result is asked for, as by any executor
            interrupts.check()  # some libraries wrap a KeyboardInterrupt
            future.set_exception(error)
        return future


class _Pool(ProcessPoolExecutor):
    """Workers that do not run this process's script again: they do not need it.

    So a script needs no main guard, and none of its lines is run twice.
    """

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        # Processes are begun here, as there is work. They ignore Ctrl-C once they have begun.
        with _without_script(), _ctrl_c_held_back(), warnings.catch_warnings():
            # Python 3.12 and later warn of forks beside threads, of which there are none but safe ones.
            warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)
            return super().submit(fn, *args, **kwargs)


@contextmanager
def _without_script() -> Iterator[None]:
    main = sys.modules["__main__"].__dict__
    hidden = {name: main.pop(name) for name in ("__file__", "__spec__") if name in main}
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update({"__spec__": None} | hidden)


def _start_method() -> str:
    """How workers are begun: as forks of this process if it has no other thread, whose locks they would inherit."""
    there = multiprocessing.get_all_start_methods()
    if "fork" in there and has_one_thread():
        return "fork"
    return "forkserver" if "forkserver" in there else "spawn"


@contextmanager
def _in_processes(count: int) -> Iterator[Executor]:
    kind = _start_method()
    context: Any = multiprocessing.get_context(kind)
    before = set(multiprocessing.active_children())
    settings = WORKER | {"PYTHONSAFEPATH": "1"}  # the second: a folder `harness` where one stands is not ours
    added = [name for name in settings if name not in os.environ]
    with _environment(settings):  # the processes inherit it, and read it as they begin
        if kind == "forkserver":
            _begin_server(context)
        with _Pool(count, mp_context=context, initializer=_begin, initargs=(added,)) as pool:
            try:
                yield pool
            except BaseException:
                # The results of running batches are of no use, and may take minutes.
                for process in set(multiprocessing.active_children()) - before:
                    process.kill()
                _end_server()
                raise
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _environment(settings: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _begin_server(context: Any) -> None:
    """Start the process that workers are forked from, which ignores Ctrl-C from the beginning, as they do."""
    from multiprocessing import forkserver, resource_tracker

    context.set_forkserver_preload(["harness.runs.server"])  # imported once, for all
    resource_tracker.ensure_running()  # first, as it changes the mask of blocked signals
    with _ctrl_c_held_back():
        forkserver.ensure_running()


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Ctrl-C in between comes at the end."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _end_server() -> None:
    """End the process that workers are forked from, which may be loading libraries; another is begun when needed."""
    from multiprocessing import forkserver

    server = getattr(forkserver, "_forkserver", None)
    pid = getattr(server, "_forkserver_pid", None)
    if pid is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _begin(added: list[str]) -> None:
    """A worker leaves Ctrl-C to its parent, and ends when the parent is gone.

    Parameters
    ----------
    added
        Names in the environment that were meant for its beginning, and not for programs that it runs.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    if "PYTHONSAFEPATH" in added:
        os.environ.pop("PYTHONSAFEPATH", None)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)  # a pool's process would wait for work for ever


def _on_dask(address: str) -> Backend:
    client: Any
    try:
        from distributed import Client
    except ImportError:
        raise InputError("needs Dask: pip install 'omnirange[dask]'", key="--dask") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are reported by this program, once
    try:
        client = Client(address, timeout=10, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"no scheduler responds at '{address}'; give its address, such as tcp://127.0.0.1:8786", key="--dask"
        ) from error
    threads = sum(client.nthreads().values())
    if threads == 0:
        client.close()
        raise InputError(
            f"the scheduler at '{address}' has no workers; start some with: dask worker {address} --nthreads 1",
            key="--dask",
        )

    @contextmanager
    def connected() -> Iterator[Executor]:
        try:
            yield client.get_executor(pure=False)
        finally:
            client.close()

    # More batches than workers, as workers may join.
    return Backend(connected, threads, slots=max(64, 4 * threads), remote=True, name=f"on Dask at {address}")
