"""The numbers behind figures and tables: CSV inside the page, and cells that sort by their values."""

import csv
import io
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from harness.report.typography import figure


@dataclass(frozen=True)
class Data:
    """A table of plain numbers to download."""

    name: str
    """The file's name, without its ending."""
    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]

    @cached_property
    def csv(self) -> str:
        """The rows as CSV with five significant digits; an empty field for a missing number."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.headings)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return stream.getvalue()

    @property
    def address(self) -> str:
        """A data URI."""
        return f"data:text/csv;charset=utf-8;base64,{b64encode(self.csv.encode()).decode()}"

    @property
    def size(self) -> str:
        """The size of the CSV in words."""
        return f"{max(1, round(len(self.csv.encode()) / 1000))}\u00a0kB"


def _plain(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return f"{value:.5g}" if np.isfinite(value) else ""
    return "" if value is None else value


@dataclass(frozen=True)
class Heading:
    """The heading of a column."""

    name: str
    unit: str = ""
    text: bool = False
    """Words, not numbers: set flush left."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, and the value that the table sorts by."""

    text: str
    value: float | str | None = None
    """The value to sort by; None sorts last."""
    colour: str = ""
    """The colour of a method's key beside the text."""
    below: str = ""
    """A second, smaller line."""
    faint: bool = False
    """Whether the row is set in grey, as one that does not count; in the first column only."""


@dataclass(frozen=True)
class Table:
    """A table for the page; its numbers may be downloaded in full."""

    headings: list[Heading]
    rows: list[list[Cell]]
    data: Data | None = None
    left_out: int = 0
    """Rows that are in the data only."""
    screen_only: tuple[int, ...] = ()
    """Columns that a sheet of paper has no room for."""

    @property
    def known(self) -> "Table":
        """The same table without the columns in which no row has a number."""
        empty = {i for i in range(len(self.headings)) if self.rows and all(row[i].text == "–" for row in self.rows)}
        if not empty:
            return self
        columns = [i for i in range(len(self.headings)) if i not in empty]
        return replace(
            self,
            headings=[self.headings[i] for i in columns],
            rows=[[row[i] for i in columns] for row in self.rows],
            screen_only=tuple(columns.index(i) for i in self.screen_only if i in columns),
        )


def words(text: str, colour: str = "") -> Cell:
    """A cell of text."""
    return Cell(text, text, colour)


def number(value: float | None, form: str, scale: float = 1.0, between: tuple[float, float] | None = None) -> Cell:
    """A cell of a number, with its interval below it; a dash for a missing number."""
    if value is None or not np.isfinite(value):
        return Cell("–")
    below = "" if between is None else interval(between, form, scale)
    return Cell(figure(scale * value, form), scale * value, below=below)


def interval(between: tuple[float, float] | Sequence[float], form: str, scale: float = 1.0) -> str:
    """`[low, high]`, not to be broken over lines."""
    low, high = (figure(scale * each, form) for each in between)
    return f"[{low},\u00a0{high}]"


def count(value: int) -> Cell:
    """A cell of a whole number."""
    return Cell(f"{value:,}".replace(",", "\u202f"), value)
