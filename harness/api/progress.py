"""Progress of a running sweep."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from harness.runs.store import Finished

_LINE_EVERY_S = 60.0
_NOTEBOOK_EVERY_S = 0.5
"""Seconds between updates of the line in a notebook, each of which is a message to the browser."""


def someone_watches() -> bool:
    """Whether output goes to a terminal or a notebook."""
    from rich.console import Console

    console = Console()
    return console.is_terminal or console.is_jupyter


class Progress:
    """Shows trials done, failures, rate and time left.

    On a terminal as a bar, in a notebook as a line that is updated, elsewhere as a line per minute and one at the end.
    """

    def __init__(self, name: str, total: int, done: int, noun: str = "trials") -> None:
        """Begin to show it.

        Parameters
        ----------
        noun
            What is counted.
        """
        from rich import progress as bar
        from rich.console import Console
        from rich.markup import escape

        self._name, self._total, self._before, self._noun = name, total, done, noun
        self._verb = "run" if noun == "trials" else "made"
        self._done, self._failed = done, 0
        self._begun = self._said = time.monotonic()
        self._console = Console()
        self._is_notebook = self._console.is_jupyter
        self._longest = 0
        self._bar = bar.Progress(
            bar.TextColumn("{task.description}"),
            bar.BarColumn(bar_width=24),
            bar.MofNCompleteColumn(),
            bar.TextColumn("{task.fields[pace]}"),
            console=self._console,
            disable=not self._console.is_terminal,
            transient=True,
            auto_refresh=False,  # no thread of its own: workers may be forked while it is shown
        )
        self._task = self._bar.add_task(escape(name), total=total, completed=done, pace="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Remove the bar."""
        self._bar.stop()

    def say(self, text: str) -> None:
        """Print a line above the bar; nothing if there is no bar."""
        if self._console.is_terminal:
            self._console.print(f"{self._name}: {text}", highlight=False, markup=False)

    def update(self, rows: "Sequence[Finished]") -> None:
        """Count rows that were just finished."""
        self.count(len(rows), sum(row.state == "failed" for row in rows))

    def count(self, done: int, failed: int = 0) -> None:
        """Count trials that were just finished, and how many of them failed."""
        self._done += done
        self._failed += failed
        rate = (self._done - self._before) / max(time.monotonic() - self._begun, 1e-9)
        failures = f", {self._failed} failed" if self._failed else ""
        pace = f"{failures.lstrip(', ')} {rate:.1f}/s, {duration((self._total - self._done) / rate)} left".lstrip()
        self._bar.update(self._task, completed=self._done, pace=pace, refresh=True)
        if self._is_notebook:
            self._write_over(f"{self._name}: {self._done} of {self._total} {self._noun}{failures}, {pace}")
        elif not self._console.is_terminal and time.monotonic() - self._said > _LINE_EVERY_S:
            self._said = time.monotonic()
            print(f"{self._name}: {self._done} of {self._total} {self._noun}{failures}, {pace}", flush=True)

    def _write_over(self, text: str) -> None:
        """Replace the previous line, if it has been shown long enough to be read."""
        if time.monotonic() - self._said > _NOTEBOOK_EVERY_S:
            self._said = time.monotonic()
            self._longest = max(self._longest, len(text))
            print(f"\r{text:<{self._longest}}", end="", flush=True)

    def finish(self) -> None:
        """Print how many trials were run, and how long it took."""
        ran = self._done - self._before
        self.stop()
        if not ran:
            print(f"{self._name}: all {self._total} {self._noun} are done")
            return
        seconds = time.monotonic() - self._begun
        failed = f", {self._failed} of them failed" if self._failed else ""
        before = f", {self._before} done before" if self._before else ""
        if self._longest:  # the last line replaces the one in a notebook
            print(f"\r{'':<{self._longest}}\r", end="")
        print(
            f"{self._name}: {ran} of {self._total} {self._noun} {self._verb}{failed}, in {duration(seconds)} "
            f"({ran / seconds:.1f} {self._noun}/s){before}",
            flush=True,
        )


class Steps:
    """Shows on a terminal how many steps are done; elsewhere prints each step as it begins."""

    def __init__(self, what: str) -> None:
        from rich import progress as bar
        from rich.console import Console

        console = Console()
        self._bar = bar.Progress(
            bar.TextColumn("{task.description}"),
            bar.BarColumn(bar_width=24),
            bar.MofNCompleteColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
            auto_refresh=False,
        )
        self._task = self._bar.add_task(what, total=None)
        if not console.is_terminal:
            print(what, flush=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, done: int, total: int) -> None:
        """Show the number of steps that are done."""
        self._bar.update(self._task, completed=done, total=total, refresh=True)


def duration(seconds: float) -> str:
    """A duration as text."""
    if seconds < 99.5:
        return f"{seconds:.3g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
