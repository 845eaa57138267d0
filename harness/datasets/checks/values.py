"""Numbers that stand for "no measurement", counted as measurements."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.datasets.checks.finding import Finding, StoredSet, gathered
from harness.datasets.layouts.layout import StoredPair, TruthMap
from harness.datasets.pair import NOT_SEEN, OCCLUDED, OUTSIDE, SKY, VISIBLE

_GAP = 0.9
"""Largest ratio of the second largest value to a largest value that stands out."""
_MANY = 0.002
"""Share of a map's pixels with the very same value from which it is a sentinel's: 60 pixels of 200 x 150."""
_SOME = 0.001
"""Share of a map's pixels beyond which a contradiction with the states is no rounding at an outline."""


def check_values(data: StoredSet) -> Iterator[Finding]:
    """Infinite numbers, negative ones, zeros, and one value that stands out and is many pixels'."""
    faults: dict[str, list[str]] = {}
    for pair in data.pairs:
        for each in pair.maps:
            for text in _faults(each, each.read(), each.raw()):
                faults.setdefault(text, []).append(f"{pair.name}: {each.file.name}")
        for text in _against_states(pair):
            faults.setdefault(text, []).append(pair.name)
    yield from gathered("values", faults)


def _faults(map_: TruthMap, values: NDArray[np.float64], raw: NDArray[Any]) -> Iterator[str]:
    known = values[~np.isnan(values)]
    if not known.size:
        yield "has no value at all"
        return
    if np.isinf(known).any():
        yield "has infinite values; where nothing was measured NaN belongs, or the layout's own 0"
        known = known[np.isfinite(known)]
    if (known < 0).any():
        yield f"has negative values of {map_.quantity}, which count as measurements"
    if (known == 0).any():
        yield f"has zeros, which count as measurements of {map_.quantity}"
    positive = known[known > 0]
    if positive.size:
        yield from _standing_out(positive, raw)


def _standing_out(values: NDArray[np.float64], raw: NDArray[Any]) -> Iterator[str]:
    """A largest value that many pixels have, and no other comes near: such as 65535, or 1000 m."""
    most = values.max()
    count = int((values == most).sum())
    rest = values[values < most]
    apart = rest.size == 0 or rest.max() < _GAP * most
    if count > max(10, _MANY * values.size) and apart:
        level = raw.astype(np.float64)
        shown = float(np.nanmax(np.where(np.isfinite(level), level, np.nan)))
        yield f"has its largest value, {shown:g}, many times and none near it: it may stand for a missing measurement"


def _against_states(pair: StoredPair) -> Iterator[str]:
    """Contradictions between states and values: values where nothing is seen, or none where something is."""
    if pair.state is None or not pair.maps or not pair.maps[0].is_image:
        return
    state, values = pair.state(), pair.maps[0].read()
    if state.shape != values.shape:
        yield f"its states have the shape {state.shape}, its ranges {values.shape}"
        return
    nothing, something = np.isin(state, (NOT_SEEN, SKY)), np.isin(state, (VISIBLE, OCCLUDED, OUTSIDE))
    if (nothing & np.isfinite(values)).sum() > _SOME * values.size:
        yield "pixels that see nothing, by their states, have a range that counts as measured"
    if (something & np.isnan(values)).sum() > _SOME * values.size + _lost(pair):
        yield "pixels that see a surface, by their states, have no range"


def _lost(pair: StoredPair) -> float:
    """Pixels whose value may be missing because its file cannot hold it: whole numbers of 16 bits end somewhere."""
    return float(pair.maps[0].raw().size) if pair.maps[0].raw().dtype.kind in "iu" else 0.0
