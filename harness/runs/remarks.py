"""The remarks of matchers on how they made their matches, over the trials of a run."""

from collections import Counter
from collections.abc import Iterable

from harness.runs.run import Row


def remarks(rows: Iterable[Row]) -> list[str]:
    """A line for each matcher and remark of it (`Matches.remark`), with the number of trials."""
    with_one = (row for row in rows if '"remark"' in row.finished.payload)  # most rows need not be read for it
    counts = Counter((row.planned.trial.matching.kind, row.payload.get("remark", "")) for row in with_one)
    return [f"{kind}, {count} trial{'s' * (count > 1)}: {remark}" for (kind, remark), count in counts.items() if remark]
