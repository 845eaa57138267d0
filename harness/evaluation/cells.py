"""A trial's errors in cells of surface, direction and range: the observations that the law is tested on."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.errors import Errors, Reference
from harness.stereo.ranging import paper_law

ALPHA_1_EDGES_DEG = (30.0, 50.0, 70.0, 90.0, 110.0, 130.0, 150.0)
"""The domain, sin(alpha_1) >= 0.5, in six parts."""

RANGE_RATIO = 2**0.5
"""Ranges are binned by powers of this. With baselines that are such powers too, |t|/d falls into the same bins for all."""

MIN_PIXELS = 200
"""A median of fewer correlated pixels is no observation."""

NORMAL = 1.4826
"""Median absolute value of a Gaussian times this is its standard deviation."""


@dataclass(frozen=True)
class Cell:
    """Robust figures of one cell of one trial."""

    surface: str
    """`wall` or `floor` (which stands for ceilings too)."""
    alpha_bin: int
    """Index into `ALPHA_1_EDGES_DEG`."""
    range_bin: int
    """`floor(log(d)/log(RANGE_RATIO))`, d in metres."""
    pixels: int
    range_m: float
    """Median true range."""
    spread_m: float
    """1.4826 median |range error|."""
    sigma_alpha: float
    """1.4826 median |alpha_2 error|, radians."""
    law_exact: float
    """Median of d_2²/(|t| sin alpha_1), metres per radian."""
    law_paper: float
    """Median of d²/|t|, metres per radian."""
    disparity_bias_px: float
    """Median signed error of alpha_2 in pixels."""
    missing: float
    """Share of the cell's pixels without an estimate."""
    gross: float
    """Share of the estimates that are off by more than one pixel."""


def cells(truth: Reference, found: Errors, valid: NDArray[np.bool_], baseline_m: float) -> list[dict[str, Any]]:
    """The cells of one trial with enough pixels, as JSON-able tables in a fixed order.

    Parameters
    ----------
    valid
        `[height, width]`: pixels with an estimate of the range.
    """
    domain = truth.domain
    alpha_bin = np.digitize(np.degrees(truth.alpha_1[domain]), ALPHA_1_EDGES_DEG) - 1
    alpha_bin = np.clip(alpha_bin, 0, len(ALPHA_1_EDGES_DEG) - 2)
    range_bin = np.floor(np.log(truth.range_m[domain]) / np.log(RANGE_RATIO)).astype(np.int64)
    wall = truth.wall[domain]
    lowest = range_bin.min(initial=0)
    group = ((range_bin - lowest) * 8 + alpha_bin) * 2 + wall
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    seen = valid[domain]
    angle, distance = found.alpha_2[domain], found.range_m[domain]
    disparity = found.disparity_px[domain]
    range_m, law = truth.range_m[domain], truth.law[domain]
    table = []
    for members in np.split(order, starts[1:]):
        have = members[seen[members]]
        if have.size < MIN_PIXELS:
            continue
        first = members[0]
        ranges = range_m[have]
        table.append(
            asdict(
                Cell(
                    surface="wall" if wall[first] else "floor",
                    alpha_bin=int(alpha_bin[first]),
                    range_bin=int(range_bin[first]),
                    pixels=int(have.size),
                    range_m=_median(ranges),
                    spread_m=NORMAL * _median(np.abs(distance[have])),
                    sigma_alpha=NORMAL * _median(np.abs(angle[have])),
                    law_exact=_median(law[have]),
                    law_paper=_median(paper_law(ranges, baseline_m)),
                    disparity_bias_px=_median(disparity[have]),
                    missing=1 - have.size / members.size,
                    gross=float(np.mean(np.abs(disparity[have]) > 1)),
                )
            )
        )
    return table


def _median(values: Array) -> float:
    return float(np.median(values))
