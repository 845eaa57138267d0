"""Semi-global matching of large panoramas, whose costs are made in bands of rows."""

import numpy as np
import pytest
from repeats import few

from harness.camera.sensor import Sensor
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion
from harness.matching.pair import Pair
from harness.matching.semi_global import match as matching
from harness.matching.semi_global.match import BITS, PER_BIT, SemiGlobal, rules_of
from harness.matching.semi_global.paths import aggregate, aggregate_in_bands


@pytest.mark.slow
@pytest.mark.parametrize("paths", few(1, [8, 4]))
@pytest.mark.parametrize("rows", [1, 2, 3, 7])
def test_costs_in_bands_give_the_same_sums(paths, rows):
    """Bands of one row, bands of which a half is no multiple, and one band for each half."""
    draws = np.random.default_rng(8)
    costs = draws.integers(0, PER_BIT * BITS + 1, (7, 9, 32)).astype(np.uint8)
    first = draws.integers(1, 8, (7, 9)).astype(np.int32)
    last = first + draws.integers(-1, 22, (7, 9)).astype(np.int32)  # some intervals are empty
    matcher = SemiGlobal(p1_bits=2, p2_bits=30, paths=paths)
    rules = rules_of(matcher, draws.integers(4, 61, (4, 7, 9)).astype(np.uint8))
    made = []

    def compare(begin, end, top, memory):
        memory[begin - top : end - top] = costs[begin:end]
        made.append(end - begin)

    whole = aggregate(costs, (0, first, last), rules, 1)
    parts = aggregate_in_bands(compare, costs.shape, (0, first, last), rules, 1, rows * costs[0].size)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    assert max(made) == min(rows, 4)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_matches_of_a_large_panorama_are_the_same(monkeypatch, threads):
    """Random images match nowhere well: whatever differed in a cost would show."""
    draws = np.random.default_rng(2)
    images = draws.uniform(0, 255, (2, 480, 640)).astype(np.float32)
    pair = Pair(
        (images[0], images[1]), (Sensor(), Sensor()), Motion(np.eye(3), np.array([0.3, 0.1, 0.0])),
        Grid(width_px=360, height_px=90), threads=threads,
    )  # fmt: skip
    whole = SemiGlobal().match(pair)
    monkeypatch.setattr(matching, "LARGE_BYTES", 0)
    monkeypatch.setattr(matching, "aggregate", None)
    monkeypatch.setattr(
        matching, "aggregate_in_bands", lambda *arguments: aggregate_in_bands(*arguments, band_bytes=150_000)
    )
    again = Pair(pair.images, pair.sensors, pair.motion, pair.grid, threads=threads)  # nothing is shared
    bands = SemiGlobal().match(again)
    for name in ("alpha_2", "confidence", "reason", "k"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(bands, name))
