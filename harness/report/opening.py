"""The head of a report: the paper's claims, or a sweep's conclusion in one sentence and one picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from harness.report.section import Context, Figure, LineKey, Section
from harness.report.sweep import Axis
from harness.report.theme import Picture
from harness.runs.headline import BASELINE

FIGURES = {
    "discretisation": "figure-profile",
    "compensation": "figure-profile",
    "one-degree": "figure-law",
    "other-rows": "figure-rows",
}
"""The figure that shows each claim."""
_OF_RESULTS = (
    "figure-localisation",
    "figure-scans",
    "figure-novel-views",
    "figure-budget",
    "figure-limit",
    "figure-law-images",
    "figure-cases",
)
"""Figures that show a sweep's result, if it has them, before the figures of its axes."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, ready for the page."""

    judged: dict[str, Any]
    """An entry of the summary's `claims`."""
    figure: str
    """The anchor that its link leads to."""
    number: int | None
    """The figure's number; None where it is not on the page."""


@dataclass(frozen=True)
class Opening:
    """The head of a report."""

    claims: tuple[Claim, ...]
    headline: str | None
    picture: Picture | None
    """The first panel of the figure that shows it."""
    key: Picture | None
    """The legend of its lines, where it is a picture of its own."""
    figure: str
    number: int | None


def opening(context: Context, sections: Sequence[Section]) -> Opening:
    """The head of the report whose sections these are."""
    figures = [block for section in sections for block in section.blocks if isinstance(block, Figure)]
    number = {each.id: i for i, each in enumerate(figures, start=1)}
    claims = tuple(
        Claim(each, FIGURES[each["id"]], number.get(FIGURES[each["id"]])) for each in context.summary.get("claims", ())
    )
    drawn = {each.id: each for each in figures if each.pictures and not each.pictures[0].failure}
    shown = None if claims else next((drawn[each] for each in _wanted(context) if each in drawn), None)
    return Opening(
        claims=claims,
        headline=context.summary.get("headline"),
        picture=shown.pictures[0] if shown else None,
        key=_key_of(shown, sections) if shown else None,
        figure=shown.id if shown else "",
        number=number[shown.id] if shown else None,
    )


def _key_of(figure: Figure, sections: Sequence[Section]) -> Picture | None:
    """The key to the lines that comes before a figure in its section."""
    for section in sections:
        key = None
        for block in section.blocks:
            if isinstance(block, LineKey):
                key = block.picture
            if block is figure:
                return key
    return None


def _wanted(context: Context) -> list[str]:
    """Figures that may show the conclusion of a sweep, the first one first; none of one trial."""
    sweep, said = context.sweep, context.summary.get("headline") or ""
    if not sweep.several:
        return []
    axes = sorted(sweep.axes, key=lambda axis: (_is_about(said, axis), *_interest(axis)), reverse=True)
    best = ["figure-best-baseline"] if [axis.key for axis in axes] == [BASELINE] else []
    return [*_OF_RESULTS, *best, *(f"figure-{axis.slug}" for axis in axes), "figure-regions"]


def _is_about(said: str, axis: Axis) -> bool:
    return said.startswith((f"{axis.name}:", f"{axis.name} "))


def _interest(axis: Axis) -> tuple[bool, int]:
    """Axes of numbers are lines, and more values make a better one."""
    return axis.numeric, len(axis.values)
