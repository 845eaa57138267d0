"""Run trials on an executor, and write each as it is finished."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from pathlib import Path

from harness import interrupts
from harness.errors import InputError, described
from harness.runs.executors import Backend
from harness.runs.experiment import Planned
from harness.runs.store import Finished, Store
from harness.runs.worker import pack, work
from harness.simulation.fingerprint import fingerprint

Trials = tuple[Planned, ...]
_NO_STEP = object()
_GRACE_S = 1.0
"""Seconds to wait after Ctrl-C for trials that workers have begun."""

Observer = Callable[[Sequence[Finished]], None]
"""Called with trials that have just been written."""


def run_batches(
    batches: Iterable[Trials],
    store: Store,
    backend: Backend,
    observe: Observer = lambda _: None,
    maps: Path | None = None,
    meanwhile: Iterable[object] = (),
) -> None:
    """Run batches and write their rows as they come; no row depends on their order.

    A batch whose worker died is run again trial by trial, alone, and a trial that ends its worker once more is written
    as failed. When this is interrupted, what workers finish within a second is written first.

    Parameters
    ----------
    maps
        The folder in which to keep the trials' maps, see `pipeline.maps`.
    meanwhile
        Work for this process while the workers are busy, in short steps: the next one is taken when they have enough
        to do. Steps that are left when all trials are done are not taken.

    Raises
    ------
    InputError
        When a worker has other code, or the scheduler has gone away. What is finished is written.
    """
    scheduler = _Scheduler(store, backend, observe, deque(batches), maps, iter(meanwhile))
    with interrupts.heard():
        while scheduler.waiting or scheduler.retries:
            with backend.open() as executor:
                scheduler.drain(executor)


@dataclass
class _Scheduler:
    store: Store
    backend: Backend
    observe: Observer
    waiting: deque[Trials]
    maps: Path | None
    meanwhile: Iterator[object]
    retries: deque[Trials] = field(default_factory=deque)
    """Single trials of batches whose worker died, to be run again one at a time."""
    running: dict[Future[list[Finished]], Trials] = field(default_factory=dict)
    retrying: bool = False

    def drain(self, executor: Executor) -> None:
        """Run all waiting batches, or until the executor is broken."""
        try:
            while self.waiting or self.retries or self.running:
                interrupts.check()
                if not self._submit(executor):
                    self._retry_all()
                    return
                took_step = next(self.meanwhile, _NO_STEP) is not _NO_STEP
                done, _ = wait(self.running, timeout=0 if took_step else None, return_when=FIRST_COMPLETED)
                broken = [self._is_broken(future) for future in done]
                if any(broken):
                    self._retry_all()
                    return
        except BaseException as error:
            # A worker may be compiling: after Ctrl-C nobody waits for long.
            self._collect_finished(_GRACE_S if interrupts.is_real(error) else None)
            raise

    def _submit(self, executor: Executor) -> bool:
        """Submit as many batches as the backend takes; False when the executor is broken."""
        if not self.running:
            self.retrying = bool(self.retries)
        queue, slots = (self.retries, 1) if self.retrying else (self.waiting, self.backend.slots)
        while queue and len(self.running) < slots:
            trials = queue.popleft()
            batch = pack(trials, threads=self.backend.threads, maps=self.maps, with_files=self.backend.remote)
            try:
                self.running[executor.submit(work, batch)] = trials
            except BrokenExecutor:
                queue.appendleft(trials)
                return False
        return True

    def _is_broken(self, future: Future[list[Finished]]) -> bool:
        """Write the rows of a finished batch; True when its executor is broken."""
        trials = self.running.pop(future)
        try:
            rows = future.result()
        except InputError:
            raise
        except CancelledError:
            raise InputError(
                f"the workers {self.backend.name} are gone; finished trials are stored, run the same command to resume"
            ) from None
        except Exception as error:  # noqa: BLE001 - the worker's end, not the trial's: those are rows
            interrupts.check()
            self._fail_or_retry(trials, error)
            return isinstance(error, BrokenExecutor)
        self._write(rows)
        return False

    def _fail_or_retry(self, trials: Trials, error: Exception) -> None:
        if not self.retrying:
            self.retries.extend((trial,) for trial in trials)
            return
        message = f"the worker that ran this trial died: {described(error)}"
        self._write([Finished(each.key, fingerprint(each.trial.scene), "failed", message=message) for each in trials])

    def _retry_all(self) -> None:
        for trials in self.running.values():
            self.retries.extend((trial,) for trial in trials)
        self.running.clear()

    def _collect_finished(self, grace_s: float | None) -> None:
        """Cancel the running batches, and write those that finish within some seconds."""
        for future in self.running:
            future.cancel()
        done, _ = wait(self.running, timeout=grace_s)
        for future in list(self.running):
            del self.running[future]
            if future in done and not future.cancelled() and future.exception() is None:
                self._write(future.result())

    def _write(self, rows: list[Finished]) -> None:
        self.store.add(rows)
        self.observe(rows)
