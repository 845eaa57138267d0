"""Scores of trials beside those of their ranges: warped views, range profiles, maps, localisation."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from harness.runs.experiment import Planned
from harness.runs.localisations import localisations_conclusions, localisations_of
from harness.runs.methods import MethodName
from harness.runs.novel_views import novel_views_of, views_conclusions
from harness.runs.path_maps import path_maps_conclusions, path_maps_of
from harness.runs.scans import scans_conclusions, scans_of

Entries = list[dict[str, Any]]


class Further(NamedTuple):
    """One kind of score."""

    name: str
    """Its key in `summary.json`."""
    entries_of: Callable[[Sequence[tuple[Planned, dict[str, Any]]]], Entries]
    """Computes the summary's entries from trials and their rows; empty if none of them has this score."""
    conclusions: Callable[[Entries, Mapping[MethodName, str]], list[str]]
    """Conclusions from these entries, in sentences, with the names of methods."""


FURTHER = (
    Further("novel_views", novel_views_of, views_conclusions),
    Further("scans", scans_of, scans_conclusions),
    Further("maps", path_maps_of, path_maps_conclusions),
    Further("localisation", localisations_of, localisations_conclusions),
)
"""All further scores, in the order of the summary and of the conclusions."""
