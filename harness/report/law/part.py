"""What the sections on the law have in common."""

from dataclasses import dataclass, field
from typing import Any

from harness.report.data import Data, Table
from harness.report.sweep import Way
from harness.report.theme import Picture

LAW_NAMES = {"exact": "exact law", "paper": "$d^2/|t|$"}
PLAIN_NAMES = {"exact": "exact law", "paper": "d²/|t|", "bound": "exact law × bound"}

Fit = dict[str, Any]
"""An entry of the summary's `law`."""


@dataclass(frozen=True)
class Part:
    """Figures and tables of one section."""

    pictures: dict[str, list[Picture]]
    tables: dict[str, Table]
    data: dict[str, Data]
    notes: dict[str, str] = field(default_factory=dict)
    """Numbers that captions speak of."""


def is_of(entry: dict[str, Any], way: Way, surface: str) -> bool:
    """Whether an entry of the summary is about this method and surface."""
    return (entry["matcher"], entry["subpixel"], entry["surface"]) == (way.matcher, way.subpixel, surface)
