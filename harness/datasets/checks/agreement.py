"""Consistency of redundant data: ranges and disparities, correspondences and geometry, points and their pixels."""

from collections.abc import Iterator

import numpy as np

from harness.camera.sensor import project
from harness.datasets.checks.finding import Finding, StoredSet
from harness.datasets.layouts.helvipad import polar_of, range_of_disparity
from harness.datasets.layouts.layout import StoredPair
from harness.display import counted
from harness.geometry.angles import Array

_MOST_PAIRS = 12
_OFF = 0.05
"""Median relative difference of ranges and disparities that rounding to 16 bits cannot explain."""
_OFF_PX = 0.1
"""Pixels off that rounding cannot explain: single precision has 6e-5 px."""
_FARTHEST_BASELINES = 30.0
"""Points farther off than this many baselines tell little of a formula."""


def check_disparity(data: StoredSet) -> Iterator[Finding]:
    """Whether disparities are those of the ranges: their unit, their sign, and the formula between the two."""
    readings: dict[str, list[float]] = {}
    for pair in data.some(_MOST_PAIRS):
        for reading, off in _disparity_off(pair).items():
            readings.setdefault(reading, []).append(off)
    if not readings:
        return
    median = {reading: float(np.median(each)) for reading, each in readings.items()}
    if median[""] < _OFF:
        return
    best = min(median, key=lambda reading: median[reading])
    cause = (
        f"they agree to {median[best]:.1%} if {best}"
        if best and median[best] < _OFF
        else "no usual mistake explains it"
    )
    text = f"disparities give ranges that are {median['']:.0%} off those of the set (median); {cause}"
    yield Finding("disparity", counted(len(readings[""]), "pair"), text)


def _disparity_off(pair: StoredPair) -> dict[str, float]:
    """Median relative error of ranges from disparities under each reading of them; empty without both maps."""
    by = {each.quantity: each for each in pair.maps}
    if not {"range", "disparity"} <= by.keys():
        return {}
    range_m, disparity = by["range"].read(), by["disparity"].read()
    polar, B = polar_of(by["range"].directions()), pair.motion.baseline_m
    height = pair.views[0].sensor.camera.height_px
    degrees_a_pixel = 180 / height if 2 * height == range_m.shape[1] else 360 / range_m.shape[1]
    use = np.isfinite(range_m) & np.isfinite(disparity) & (range_m < _FARTHEST_BASELINES * B)
    if use.sum() < 100:
        return {}
    range_m, disparity, polar = range_m[use], disparity[use], polar[use]
    steps = 65536 / 2048
    readings = {
        "": range_of_disparity(disparity, polar, B),
        "they are in pixels": range_of_disparity(disparity * degrees_a_pixel, polar, B),
        "they are in radians": range_of_disparity(np.degrees(disparity), polar, B),
        "their sign is the other one": range_of_disparity(steps - disparity, polar, B),
        "the sign before the cosine is the other one": range_of_disparity(disparity, np.pi - polar, B),
        "they are those of half the baseline": range_of_disparity(disparity, polar, B / 2),
        "they are those of twice the baseline": range_of_disparity(disparity, polar, 2 * B),
    }
    return {reading: _relative(each, range_m) for reading, each in readings.items()}


def _relative(found: Array, expected: Array) -> float:
    """The median relative difference; a value that is missing is as far off as can be."""
    return float(np.median(np.nan_to_num(np.abs(found / expected - 1), nan=np.inf)))


def check_correspondences(data: StoredSet) -> Iterator[Finding]:
    """Whether stated correspondences, and stated pixels of points, are where range, motion and calibration put them."""
    off = [each for pair in data.some(_MOST_PAIRS) for each in _pixels_off(pair)]
    off_by_more = [(name, shift, size) for name, shift, size in off if size > _OFF_PX]
    if not off_by_more:
        return
    shift, size = (
        np.median([each[1] for each in off_by_more], axis=0),
        float(np.median([each[2] for each in off_by_more])),
    )
    text = f"points are {size:.2g} px off where range, motion and calibration put them (median)"
    if np.hypot(*shift) > 0.9 * size and np.allclose(np.abs(2 * shift), np.rint(np.abs(2 * shift)), atol=0.1):
        text += f": a shift by ({shift[0]:+.1f}, {shift[1]:+.1f}) px, as where pixels are counted from their corners"
    yield Finding(
        "correspondences",
        f"{off_by_more[0][0]} and {len(off_by_more) - 1} more" if len(off_by_more) > 1 else off_by_more[0][0],
        text,
    )


def _pixels_off(pair: StoredPair) -> Iterator[tuple[str, Array, float]]:
    """Median shift `[2]` and median distance, pixels, for each view whose pixels the set states."""
    if pair.observed is not None:
        points, *stated = pair.observed
        for number, (view, pixels) in enumerate(zip(pair.views, stated, strict=True), 1):
            projected, _ = project(view.sensor, (points - view.position_m) @ view.R_view_from_map.T)
            yield from _named(f"{pair.name}, view {number}", projected - pixels)
    if pair.match is not None and pair.maps:
        stated_match = pair.match()
        points = pair.maps[0].directions() * pair.maps[0].read()[..., None]
        view = pair.views[1]
        known = np.isfinite(stated_match[..., 0]) & np.isfinite(points[..., 0])
        projected, _ = project(view.sensor, (points[known] - view.position_m) @ view.R_view_from_map.T)
        yield from _named(f"{pair.name}, view 2", projected - stated_match[known])


def _named(name: str, off: Array) -> Iterator[tuple[str, Array, float]]:
    off = off[np.isfinite(off[:, 0])]
    if len(off) >= 20:
        yield name, np.median(off, axis=0), float(np.median(np.linalg.norm(off, axis=1)))
