"""The findings of checks, and the data set that all checks take."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.datasets.layouts.layout import Layout, StoredPair
from harness.display import OneLine
from harness.errors import InputError


@dataclass(frozen=True)
class Finding:
    """A fault of a set."""

    check: str
    """The check that found it; see `check.CHECKS`."""
    where: str
    """A file or a pair, or how many; empty for the whole set."""
    text: str
    """The fault, with the figures that show it."""


@dataclass(frozen=True, eq=False, repr=False)
class StoredSet(OneLine):
    """A data set on the disk."""

    folder: Path
    layout: Layout
    pairs: tuple[StoredPair, ...]
    manifest: dict[str, Any] | None
    """The manifest; None for a set without one."""

    def some(self, most: int) -> list[StoredPair]:
        """At most `count` pairs, spread evenly over the set."""
        count = len(self.pairs)
        step = max(1.0, count / most)
        return [self.pairs[int(i * step)] for i in range(min(most, count))]


def listed(names: list[str], most: int = 3) -> str:
    """The first names as text, with the number of all others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def gathered(check: str, faults: dict[str, list[str]]) -> Iterator[Finding]:
    """Findings with equal texts as one, over all that they are about."""
    for text, names in faults.items():
        yield Finding(check, listed(names), text)


def problem_of(error: InputError) -> str:
    """The text of an error without its file."""
    return f"{error.key}: {error.problem}" if error.key else error.problem
