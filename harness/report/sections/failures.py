"""Trials that failed, by message."""

from collections.abc import Iterator
from typing import Any

from harness.report.data import Data, Heading, Table, count, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, TableBlock, section_of
from harness.runs.run import Result
from harness.runs.values import shown

_TABLE = """
Trials that failed, by message. They count in no other figure or table. <code>failures.csv</code> has the tracebacks.
"""


@section_of(About.THE_RUN, "failures", "Failures")
def section(context: Context) -> Iterator[Block]:
    """The messages of failed trials; nothing if no trial failed."""
    table = failures(context.result)
    if table.rows:
        yield TableBlock("table-failures", table, html(_TABLE))


def failures(result: Result) -> Table:
    """A table of the failed trials, one row for each message."""
    failed: dict[str, list[Any]] = {}
    for row in result.rows:
        if row.state == "failed":
            failed.setdefault(row.finished.message, []).append(row)
    rows = [
        [words(message), count(len(trials)), words(shown(trials[0].coordinates)), words(trials[0].planned.key)]
        for message, trials in failed.items()
    ]
    data = Data(
        "failures",
        ["key", "settings", "message"],
        [[row.planned.key, shown(row.coordinates), message] for message, trials in failed.items() for row in trials],
    )
    head = [
        Heading("Message", text=True),
        Heading("Trials"),
        Heading("First at", text=True),
        Heading("Its key", text=True),
    ]
    return Table(head, rows, data)
