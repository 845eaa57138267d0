"""A section of the report: its input and its blocks."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from markupsafe import Markup

from harness.pipeline.specification import Trial
from harness.report.data import Data, Table
from harness.report.markup import html
from harness.report.method_styles import Method, Named, methods_of, names_of
from harness.report.sweep import Sweep, sweep_of
from harness.report.theme import Picture
from harness.runs.run import Result

MOST_BYTES = 4_900_000
"""The most that the sections of a page have together: with its head it stays below five megabytes, for mail."""

# --- What a section is made from ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Context:
    """A finished experiment, as sections read it."""

    result: Result
    sweep: Sweep
    """The rows of all trials as tables."""
    methods: list[Method]
    """The base trial by each method, with its pixels; empty if no method can be shown."""
    compared: list[Named]
    """The methods of the base trial whose comparison is known, with or without pixels."""
    trial: Trial
    """The base trial."""
    room: int = MOST_BYTES
    """Bytes that a section may take that takes the rest: all of the page, or what the other sections leave."""

    @classmethod
    def of(cls, result: Result) -> "Context":
        """The context for the report of a result."""
        planned, labels = result.experiment.planned, result.experiment.method_labels
        methods = methods_of(result.outcomes, planned, labels)
        named = names_of(result.details.trials, planned, labels)
        return cls(
            result=result,
            sweep=sweep_of(result),
            methods=methods,
            compared=[each for each in named if each.key in result.summary["comparison"]],
            trial=methods[0].outcome.trial if methods else result.details.trials[0],
        )

    @property
    def summary(self) -> dict[str, Any]:
        """The contents of `summary.json`."""
        return self.result.summary

    @property
    def law(self) -> dict[str, Any] | None:
        """The summary's test of the law; None where it was not tested, or no slope could be fitted."""
        law: dict[str, Any] = self.summary.get("law") or {"images": []}
        fitted = any(fit["law"] == "exact" and fit["slope"] is not None for fit in law["images"])
        return law if fitted else None

    @cached_property
    def column_deg(self) -> float:
        """One pixel of disparity, degrees."""
        return float(np.degrees(self.trial.panorama.phi_pitch))


# --- What a section is made of ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Paragraph:
    """Any HTML that has no number: paragraphs, lists, sub-headings."""

    kind: ClassVar = "paragraph"
    html: Markup


@dataclass(frozen=True)
class Figure:
    """A numbered figure of one or more panels."""

    kind: ClassVar = "figure"
    id: str
    pictures: Sequence[Picture]
    caption: Markup
    layout: Literal["two", "wide"] = "two"
    """Two panels beside each other where there is room, or each as wide as the page."""
    data: Data | None = None
    """The numbers behind it, to download."""
    missing: str = ""
    """The text in place of a missing picture; empty for the default."""
    paper: str = ""
    """The figure of the paper that it repeats, such as `fig. 5(a)`."""


@dataclass(frozen=True)
class LineKey:
    """The legend of the figures that follow: a picture without a number."""

    kind: ClassVar = "key"
    picture: Picture


@dataclass(frozen=True)
class TableBlock:
    """A numbered table that readers can sort and download."""

    kind: ClassVar = "table"
    id: str
    table: Table
    caption: Markup
    full: bool = True
    """Whether it is as wide as the page."""


@dataclass(frozen=True)
class FixedTable:
    """A numbered table whose rows stay in their order, for grouped rows or symbols in headings."""

    kind: ClassVar = "fixed table"
    html: Markup
    """The contents of `<table>`."""
    caption: Markup
    full: bool = False
    id: str = ""
    table: Table | None = None
    """The same as plain rows, for a file of tables; None for an explanation of the page alone."""


@dataclass(frozen=True)
class InAbstract:
    """A section's contribution to the head of a sweep's report; not shown in the section itself."""

    kind: ClassVar = "abstract"
    html: Markup


@dataclass(frozen=True)
class Interactive:
    """A part of the page that needs a script: it has no number, and contains its own text for use without scripts."""

    kind: ClassVar = "interactive"
    html: Markup
    script: Markup
    """JavaScript, put at the end of the page."""


Block = Paragraph | Figure | LineKey | TableBlock | FixedTable | InAbstract | Interactive


@dataclass(frozen=True)
class Section:
    """A section, ready for the template."""

    id: str
    """The anchor of links."""
    title: str
    blocks: tuple[Block, ...]

    @property
    def abstract(self) -> list[Markup]:
        """Its contributions to the head of the page."""
        return [block.html for block in self.blocks if isinstance(block, InAbstract)]

    @property
    def size(self) -> int:
        """About how many bytes of the page it is."""
        return sum(_size_of(block) for block in self.blocks)


_CELL = 90
"""Bytes of a cell of a table with its tags, roughly."""


def _size_of(block: Block) -> int:
    if isinstance(block, TableBlock):
        cells = len(block.table.headings) * (1 + len(block.table.rows))
        return _CELL * cells + (len(block.table.data.address) if block.table.data else 0)
    if isinstance(block, Figure):
        return sum(len(each.source) for each in block.pictures) + (len(block.data.address) if block.data else 0)
    if isinstance(block, LineKey):
        return len(block.picture.source)
    return len(block.html)


# --- How one is declared ------------------------------------------------------------------------------------------


class About(Enum):
    """The subject of a section, which decides its position."""

    ALL_TRIALS = "all trials"
    """Made from rows. It comes first in the report of a sweep, after the base trial elsewhere."""
    BASE_TRIAL = "the base trial"
    THE_RUN = "the run"
    """The run itself. It comes last."""


@dataclass(frozen=True)
class Declared:
    """A section as declared in its file; calling it with a context makes it."""

    id: str
    title: str | Callable[[Context], str]
    about: About
    needs_pixels: bool
    """Whether it cannot be made from rows and summary alone; without pixels it states that."""
    takes_the_rest: bool
    """Whether it is made again, with the room that the others leave (`Context.room`), if it takes more."""
    make: Callable[[Context], Iterator[Block]]

    def __call__(self, context: Context) -> Section | None:
        """The section; None where it has nothing to show."""
        if self.needs_pixels and not context.methods:
            blocks: tuple[Block, ...] = (Paragraph(html(_WITHOUT_PIXELS)),)
        else:
            blocks = tuple(self.make(context))
        for block in blocks:
            if not isinstance(block, Block):
                raise TypeError(f"a section is made of blocks such as Figure, not of {type(block).__name__}")
        return Section(self.id, self.title_in(context), blocks) if blocks else None

    def title_in(self, context: Context) -> str:
        """The section's title in a report."""
        return self.title if isinstance(self.title, str) else self.title(context)


def section_of(
    about: About,
    section_id: str,
    title: str | Callable[[Context], str],
    *,
    needs_pixels: bool = False,
    takes_the_rest: bool = False,
) -> Callable[[Callable[[Context], Iterator[Block]]], Declared]:
    """Declare a section: for a function that yields its blocks in the order of the page, or none to be left out."""

    def declare(make: Callable[[Context], Iterator[Block]]) -> Declared:
        return Declared(section_id, title, about, needs_pixels, takes_the_rest, make)

    return declare


_WITHOUT_PIXELS = """\
<p class="missing">Not shown: this section needs the pixels of the base trial; what is left
out and why is listed <a href="#comparison">above</a>.</p>
"""
