"""Runs trials on an executor and keeps each as it is finished."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from pathlib import Path

from harness import interrupts
from harness.errors import InputError, described
from harness.runs.executors import Workplace
from harness.runs.experiment import Planned
from harness.runs.store import Finished, Store
from harness.runs.worker import pack, work
from harness.simulation.fingerprint import fingerprint

Trials = tuple[Planned, ...]
_PATIENCE_S = 1.0
"""How long trials that workers have begun are awaited after Ctrl-C."""

Observer = Callable[[Sequence[Finished]], None]
"""Called with trials that have just been written."""


def run_sweep(
    batches: Iterable[Trials],
    store: Store,
    place: Workplace,
    observe: Observer = lambda _: None,
    maps: Path | None = None,
) -> None:
    """Run batches and write their rows as they come; in which order they do makes no difference to any row.

    A batch whose worker died is run again trial by trial, alone, and a trial that ends its worker once more is written
    as failed. When this is interrupted, what workers finish within a second is written first.

    Parameters
    ----------
    maps
        The folder in which to keep the trials' maps, see `pipeline.maps`.

    Raises
    ------
    InputError
        When a worker has other code, or the scheduler has gone away. What is finished is written.
    """
    sweep = _Sweep(store, place, observe, deque(batches), maps)
    with interrupts.heard():
        while sweep.waiting or sweep.suspects:
            with place.open() as executor:
                sweep.drain(executor)


@dataclass
class _Sweep:
    store: Store
    place: Workplace
    observe: Observer
    waiting: deque[Trials]
    maps: Path | None
    suspects: deque[Trials] = field(default_factory=deque)
    """Single trials of batches that came to grief, to be run alone."""
    running: dict[Future[list[Finished]], Trials] = field(default_factory=dict)
    alone: bool = False

    def drain(self, executor: Executor) -> None:
        """Run all that is waiting, or until the executor is broken."""
        try:
            while self.waiting or self.suspects or self.running:
                interrupts.check()
                if not self._hand_over(executor):
                    self._suspect_all()
                    return
                done, _ = wait(self.running, return_when=FIRST_COMPLETED)
                broken = [self._is_broken(future) for future in done]
                if any(broken):
                    self._suspect_all()
                    return
        except BaseException as error:
            # What workers are at may be a compilation: after Ctrl-C nobody waits for long.
            self._wind_up(_PATIENCE_S if interrupts.is_real(error) else None)
            raise

    def _hand_over(self, executor: Executor) -> bool:
        """Give the workers as much as they should have; False when the executor is broken."""
        if not self.running:
            self.alone = bool(self.suspects)
        queue, slots = (self.suspects, 1) if self.alone else (self.waiting, self.place.slots)
        while queue and len(self.running) < slots:
            trials = queue.popleft()
            batch = pack(trials, threads=self.place.threads, maps=self.maps, with_files=self.place.elsewhere)
            try:
                self.running[executor.submit(work, batch)] = trials
            except BrokenExecutor:
                queue.appendleft(trials)
                return False
        return True

    def _is_broken(self, future: Future[list[Finished]]) -> bool:
        """Take what a batch came to; True when its executor is of no more use."""
        trials = self.running.pop(future)
        try:
            rows = future.result()
        except InputError:
            raise
        except CancelledError:
            raise InputError(
                f"the workers {self.place.name} have gone away; what is finished is kept, run the same command to go on"
            ) from None
        except Exception as error:  # noqa: BLE001 - the worker's end, not the trial's: those are rows
            interrupts.check()
            self._grieve(trials, error)
            return isinstance(error, BrokenExecutor)
        self._keep(rows)
        return False

    def _grieve(self, trials: Trials, error: Exception) -> None:
        if not self.alone:
            self.suspects.extend((trial,) for trial in trials)
            return
        message = f"the worker that ran this trial died: {described(error)}"
        self._keep([Finished(each.key, fingerprint(each.trial.scene), "failed", message=message) for each in trials])

    def _suspect_all(self) -> None:
        for trials in self.running.values():
            self.suspects.extend((trial,) for trial in trials)
        self.running.clear()

    def _wind_up(self, patience_s: float | None) -> None:
        """Keep what is finished, within some seconds, among that which nobody awaits any more."""
        for future in self.running:
            future.cancel()
        done, _ = wait(self.running, timeout=patience_s)
        for future in list(self.running):
            del self.running[future]
            if future in done and not future.cancelled() and future.exception() is None:
                self._keep(future.result())

    def _keep(self, rows: list[Finished]) -> None:
        self.store.add(rows)
        self.observe(rows)
