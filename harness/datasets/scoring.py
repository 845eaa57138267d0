"""The project's figures for third-party maps on any data set: each pair's errors, and their means over the set."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import project
from harness.datasets.estimates import pixel_rad
from harness.datasets.layouts.layout import StoredPair
from harness.datasets.layouts.reading import known, read_array
from harness.datasets.pair import OCCLUDED, VISIBLE
from harness.display import OneLine
from harness.evaluation.groups import bins, grouped, members, sorted_parts
from harness.evaluation.metric_table import METRICS
from harness.evaluation.metrics import Measures, measure, measure_by_solid_angle, measure_more, measure_regions
from harness.evaluation.pixel_errors import MIN_SINE_ALPHA_1, Errors
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_EDGES_M, SLANTED_DEG, Labels, Layout, Region
from harness.evaluation.regions import OCCLUDED as HIDDEN
from harness.evaluation.regions import VISIBLE as SEEN
from harness.evaluation.shape_scores import shape_of
from harness.evaluation.tally import tally
from harness.geometry.angles import Array, angle_between
from harness.geometry.triangulation import exact_alpha_2
from harness.simulation.truth import DISCONTINUITY_RATIO

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class Score(OneLine):
    """The score of an estimate of a pair."""

    pair: StoredPair
    measures: Measures
    """The figures by name, as in `METRICS`; weighted by solid angle under the prefix `solid_angle_`."""
    regions: list[dict[str, Any]]
    """The figures of parts of the picture, as from `measure_regions`."""
    range_m: Array
    """The estimate on the truth's pixels, metres."""
    truth_m: Array
    domain: Mask
    """Pixels that figures are over: both views see the point, 30 degrees or more off the baseline."""


def true_ranges(pair: StoredPair) -> Array:
    """The ranges of a pair's truth, metres; NaN where they are unknown."""
    map_ = pair.maps[0]
    values = map_.read()
    if map_.quantity == "inverse range":
        return np.where(values > 0, 1 / np.where(values > 0, values, 1), np.nan)
    if map_.quantity == "disparity":
        from harness.datasets.layouts.helvipad import polar_of, range_of_disparity

        return range_of_disparity(values, polar_of(map_.directions()), pair.motion.baseline_m)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def score_pair(pair: StoredPair, range_m: Array) -> Score:
    """Compare estimated ranges with the truth.

    Angles are those to view 2 from the map's origin, which is view 1's place in all layouts but other people's rigs.

    Parameters
    ----------
    range_m
        `[height, width]` of the truth's map; NaN where there is no estimate.
    """
    truth_m, x = true_ranges(pair), pair.maps[0].directions()
    t = pair.views[1].position_m
    alpha_1 = angle_between(x, t)
    with np.errstate(invalid="ignore"):
        sideways = np.sin(alpha_1) >= MIN_SINE_ALPHA_1
        visible, hidden = _visibility(pair, truth_m, x)
        domain = visible & sideways
        valid = np.isfinite(range_m) & np.isfinite(truth_m)
        off = exact_alpha_2(range_m[..., None] * x, t) - exact_alpha_2(truth_m[..., None] * x, t)
        errors = Errors(alpha_2=off, disparity_px=off / pixel_rad(pair), range_m=range_m - truth_m)
    layout = _layout(pair, truth_m, x, alpha_1, domain, hidden & sideways)
    measures = measure(domain, valid, errors)
    if domain.any():
        counted = tally(layout, valid, errors)
        weighted = {f"solid_angle_{name}": value for name, value in measure_by_solid_angle(counted).items()}
        measures |= measure_more(counted) | weighted
        regions = measure_regions(counted)
    else:
        regions = []
    return Score(pair, measures, regions, range_m, truth_m, domain)


def _visibility(pair: StoredPair, truth_m: Array, x: Array) -> tuple[Mask, Mask]:
    """Pixels whose point both views see, and those whose point is hidden in view 2.

    A set without states does not tell which points are hidden: all points on view 2's image count as seen.
    """
    known = np.isfinite(truth_m)
    if pair.state is not None and pair.maps[0].is_image:
        state = pair.state()
        return known & (state == VISIBLE), known & (state == OCCLUDED)
    second = pair.views[1]
    points = (x * truth_m[..., None] - second.position_m) @ second.R_view_from_map.T
    inside = known.copy()
    inside[known] = project(second.sensor, points[known])[1]
    return inside, np.zeros_like(inside)


def _layout(pair: StoredPair, truth_m: Array, x: Array, alpha_1: Array, domain: Mask, hidden: Mask) -> Layout:
    """The parts of the picture that errors are reported by: visibility, kind, angle to the baseline, and range."""
    jump, slanted = _kinds(pair, truth_m, x)
    splits: list[tuple[str, tuple[str, ...], tuple[float, ...], Labels]] = [
        ("visibility", (SEEN, HIDDEN), (), _labels(domain, hidden)),
        ("kind", ("discontinuity",), (), _labels(domain & jump)),
        (
            "kind",
            (f"slanted by more than {SLANTED_DEG:.0f}°", "none of these"),
            (),
            _labels(domain & slanted, domain & ~slanted & ~jump),
        ),
    ]
    by_value: tuple[tuple[str, Array, tuple[float, ...], str], ...] = (
        ("alpha_1", np.degrees(alpha_1), ALPHA_1_EDGES_DEG, "°"),
        ("range", truth_m, RANGE_EDGES_M, " m"),
    )
    for split, values, edges, unit in by_value:
        label = bins(np.nan_to_num(values, nan=-1.0), edges)
        label[~domain] = -1
        splits.append((split, tuple(_between(*each, unit) for each in pairwise(edges)), edges, label))
    named: list[Region] = []
    layers = []
    for split, parts, edges, labels in splits:
        number = np.full(len(parts) + 1, -1, dtype=np.int16)
        for i, (part, pixels) in enumerate(zip(parts, members(labels, len(parts)), strict=True)):
            if pixels.size:
                number[i] = len(named)
                named.append(Region(split, part, pixels, edges[i] if edges else None))
        layers.append(number[labels.reshape(-1)])
    groups = grouped(layers, len(named))
    pixels = groups.pixels
    range_m = truth_m.ravel()[pixels]
    nothing = np.full(pixels.size, -1, dtype=np.int64)
    empty = sorted_parts(nothing, 0, range_m)
    return Layout(
        regions=tuple(named),
        cells=(),
        groups=groups,
        surface=np.where(domain.ravel()[pixels], np.int8(0), np.int8(-1)),
        solid_angle=_solid_angles(x).ravel()[pixels],
        range_m=range_m,
        by_range=empty,
        by_law=empty,
        shape=shape_of(truth_m, domain & _has_neighbours(pair, domain.shape), x, jump),
    )


def _has_neighbours(pair: StoredPair, shape: tuple[int, ...]) -> Mask:
    """Pixels whose neighbours are those beside them: all of a map that goes round, else not those at its sides."""
    view = pair.views[0]
    inner = np.ones(shape, dtype=bool)
    if pair.maps[0].is_image and not view.sensor.model.goes_round(view.sensor.camera):
        inner[:, [0, -1]] = False
    return inner


def _between(low: float, high: float, unit: str) -> str:
    return f"{low:g} to {high:g}{unit}" if math.isfinite(high) else f"over {low:g}{unit}"


def _labels(*masks: Mask) -> Labels:
    labels = np.full(masks[0].shape, -1, dtype=np.int16)
    for i, mask in enumerate(masks):
        labels[mask] = i
    return labels


def _kinds(pair: StoredPair, truth_m: Array, x: Array) -> tuple[Mask, Mask]:
    """Pixels beside a jump in range, and those on slanted surfaces; normals are the set's own, or of neighbours."""
    own = pair.maps[0].file.parent / "normal.npy"
    points = x * truth_m[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):
        if own.is_file():
            normal = known(read_array(own))
        else:
            normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        jump = np.zeros(truth_m.shape, dtype=bool)
        for axis in (0, 1):
            ratio = np.abs(np.diff(np.log(truth_m), axis=axis)) > 4 * np.log1p(DISCONTINUITY_RATIO)
            before, after = [slice(None)] * 2, [slice(None)] * 2
            before[axis], after[axis] = slice(None, -1), slice(1, None)
            jump[tuple(before)] |= ratio
            jump[tuple(after)] |= ratio
        slanted = np.abs(np.sum(normal * x, axis=-1)) < np.cos(np.radians(SLANTED_DEG))
    return jump, slanted & ~jump


def _solid_angles(x: Array) -> Array:
    """The solid angle of each pixel, steradians, from its neighbours' directions; 0 at the borders of the field."""
    along_rows, along_columns = np.gradient(x, axis=0), np.gradient(x, axis=1)
    return np.nan_to_num(np.linalg.norm(np.cross(along_rows, along_columns), axis=-1))


# --- Over a set -------------------------------------------------------------------------------------------------------


def mean_of(scores: Sequence[Measures]) -> Measures:
    """The mean of each figure over pairs, geometric where its metric says so; None where no pair has it."""
    out: Measures = {}
    for name in dict.fromkeys(name for each in scores for name in each):
        values = [value for each in scores if (value := each.get(name)) is not None and math.isfinite(value)]
        base = METRICS.get(name.removeprefix("solid_angle_"))
        if not values:
            out[name] = None
        elif base is not None and base.geometric and min(values) > 0:
            out[name] = float(np.exp(np.mean(np.log(values))))
        else:
            out[name] = float(np.mean(values))
    return out


def mean_of_regions(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """The mean of each figure over pairs for each part of the picture, with the part's pixels in all pairs."""
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for score in scores:
        for row in score.regions:
            rows.setdefault((row["split"], row["part"]), []).append(row)
    order = {"visibility": 0, "kind": 1, "alpha_1": 2, "range": 3}
    out = []
    for (split, part), each in rows.items():
        figures = [{name: row[name] for name in METRICS if name in row} for row in each]
        about = {"split": split, "part": part, "low": each[0]["low"], "pixels": sum(row["pixels"] for row in each)}
        out.append({**about, **mean_of(figures)})
    return sorted(out, key=lambda row: (order.get(row["split"], 9), row["low"] if row["low"] is not None else -1.0))


def nothing_for(pair: StoredPair) -> Score:
    """The score of a pair without an estimate: its density is 0."""
    return score_pair(pair, np.full(true_ranges(pair).shape, np.nan))
