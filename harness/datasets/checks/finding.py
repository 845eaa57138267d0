"""What a check says, and what all checks are given."""

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
    """What is wrong, with the figures that say so."""


@dataclass(frozen=True, eq=False, repr=False)
class StoredSet(OneLine):
    """A data set on the disk."""

    folder: Path
    layout: Layout
    pairs: tuple[StoredPair, ...]
    manifest: dict[str, Any] | None
    """None for a set without one."""

    def some(self, most: int) -> list[StoredPair]:
        """At most so many pairs, spread evenly over the set."""
        count = len(self.pairs)
        step = max(1.0, count / most)
        return [self.pairs[int(i * step)] for i in range(min(most, count))]


def listed(names: list[str], most: int = 3) -> str:
    """Some of the names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def gathered(check: str, faults: dict[str, list[str]]) -> Iterator[Finding]:
    """One finding for each text, over all that it is said of."""
    for text, names in faults.items():
        yield Finding(check, listed(names), text)


def problem_of(error: InputError) -> str:
    """What an error says, without its file."""
    return f"{error.key}: {error.problem}" if error.key else error.problem
