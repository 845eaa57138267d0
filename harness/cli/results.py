"""The last step of `run` and `report`: writing the output files of a run, and printing a summary."""

import gc
import sys
import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from harness import interrupts
from harness.api.progress import Steps
from harness.cli.exits import FAILED, OK
from harness.cli.tables import cases_table, claims_table, law_tables, methods_table
from harness.display import counted, listed, unbroken
from harness.errors import InputError, Notice

if TYPE_CHECKING:
    from harness.runs.details import Beforehand
    from harness.runs.experiment import Experiment
    from harness.runs.run import Result
    from harness.runs.store import Store, UnusedRows

_FEW = 100
"""Trials below which what they say together is worked out before a copy of the process could begin."""


def write(
    experiment: "Experiment",
    store: "Store",
    folder: Path,
    *,
    given: str | Path,
    shown: Path | None = None,
    with_report: bool = True,
    run_code: bool = True,
    beforehand: "Beforehand" = MappingProxyType({}),
) -> int:
    """Write all output files of a run, print a summary, and return the exit code.

    Parameters
    ----------
    folder
        The output folder.
    given
        The experiment as the user gave it, for messages.
    shown
        The folder as the user gave it, for messages.
    run_code
        Whether matchers that are not part of this program may be run.
    beforehand
        Outcomes of the base trial that are there already, by the trials' keys.

    Raises
    ------
    InputError
        When every trial failed because of `given`, which the user can correct.
    """
    shown = shown or folder
    from harness.copies import begun_in_a_copy
    from harness.runs.all_trials import all_trials_of
    from harness.runs.density import too_sparse
    from harness.runs.remarks import remarks
    from harness.runs.run import result_from, rows_of, run_status, write_summary, write_tables
    from harness.runs.written import OF_ALL_ROWS

    rows = rows_of(experiment, store)
    now = run_status(experiment, store)
    has_report = with_report and bool(now.done)
    may_copy = has_report and len(rows) > _FEW
    with _long_lived(), begun_in_a_copy(lambda: all_trials_of(experiment, rows), may_copy=may_copy) as all_trials:
        removed, left = write_tables(experiment, rows, store, folder)
        interrupts.check()
        if may_copy:
            from harness.report import build  # noqa: F401 - it takes long, and the copy takes longer
        if has_report:
            result = result_from(
                experiment, rows, store, run_code=run_code, beforehand=beforehand, all_trials=all_trials
            )
    if has_report:
        write_summary(result, store, folder)  # first, so that a failure of the report does not lose it
        show(result.summary)
        _draw(result, store, folder)
        show_report(shown)
    elif removed:
        print(f"removed from {shown}: {listed(removed)} of earlier trials")
    if still := [each for each in left if not has_report or each not in OF_ALL_ROWS]:  # a report replaces those
        print(f"still in {shown} of earlier trials: {listed(still)}")
    sparse = too_sparse((row.planned.trial, row.payload) for row in rows if row.state == "done")
    for line in filter(None, (sparse, *remarks(rows))):
        warnings.warn(line, Notice, stacklevel=1)
    if not now.failed:
        return OK
    failures = [
        row for row in store.finished(each.key for each in experiment.planned).values() if row.state == "failed"
    ]
    if len(failures) == now.total and all(row.is_refused for row in failures):
        raise InputError(failures[0].message, file=given)
    print(
        f"omnirange: {now.failed} of {now.total} trials failed; {shown / 'failures.csv'} says why; "
        "the same command runs them again",
        file=sys.stderr,
    )
    return FAILED


@contextmanager
def _long_lived() -> Iterator[None]:
    """What is there is no garbage: nobody looks for any among millions of rows, which copies of the process share."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _draw(result: "Result", store: "Store", folder: Path) -> None:
    """Write the report, and say what it lacks."""
    from harness.report.build import build_report  # only now, as drawing libraries take long to load
    from harness.runs.run import write_report

    not_drawn: list[str] = []
    with _long_lived(), Steps("writing report") as steps:
        page = build_report(result, not_drawn, observe=steps.update, may_copy=True)
    write_report(result, page, store, folder)
    for each in result.details.left_out:
        print(f"omnirange: left out of the report: {each.matcher}: {each.reason}", file=sys.stderr)
    for failure in not_drawn:
        print(f"omnirange: {failure}", file=sys.stderr)


def show(summary: dict[str, Any]) -> None:
    """Print the results: the conclusions of a sweep, or else the figures of the one trial by each method."""
    from rich.console import Console

    from harness.runs.conclusions import leading

    console = Console()
    claims, headline = (summary.get(name) for name in ("claims", "headline"))
    sentences, more = leading(summary.get("conclusions", ()))
    if claims:
        console.print(claims_table(summary))
        console.print()
    if headline:
        console.print(_wrapped(f"{summary['experiment']}: {headline}", console.width), style="bold", **_PLAIN)
    of_one_trial = bool(summary["comparison"]) and not (headline and sentences)  # a sweep is not summed up by one trial
    if of_one_trial:
        console.print(methods_table(summary))
    if summary.get("cases") and not (of_one_trial and summary.get("labels")):  # cases that name methods are in it
        console.print()
        console.print(cases_table(summary))
    if sentences:
        console.print()
    for each in sentences:
        console.print(_wrapped(each, console.width, "- "), **_PLAIN)
    if more:
        console.print(f"- {len(more)} more in the report", **_PLAIN)
    for table in law_tables(summary):
        console.print()
        console.print(table)
    console.print()


_PLAIN: Any = {"soft_wrap": True, "highlight": False, "markup": False}
"""For text that is wrapped already."""


def _wrapped(text: str, width: int, bullet: str = "") -> str:
    """Text in lines that end at spaces alone, and not between a number and its unit."""
    indent = " " * len(bullet)
    whole: Any = {"break_on_hyphens": False, "break_long_words": False}
    return textwrap.fill(unbroken(text), width, initial_indent=bullet, subsequent_indent=indent, **whole)


def show_report(folder: Path) -> None:
    """Print where the report is."""
    from rich.console import Console

    Console().print(f"report: {folder / 'report.html'}", soft_wrap=True, highlight=False, markup=False)


def say_unused_rows(unused: "UnusedRows") -> None:
    """Print how many trials of a folder are not used, and why."""
    for count, why in (
        (unused.other_code, "by other code or libraries"),
        (unused.other_scene, "of other scenes, or of an earlier version of this one"),
        (unused.other_settings, "with other settings"),
    ):
        if count:
            were, they_are = ("was", "it is") if count == 1 else ("were", "they are")
            print(f"{counted(count, 'trial')} in this folder {were} made {why}: {they_are} not used")
