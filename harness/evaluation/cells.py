"""A trial's errors in cells of surface, direction and range: the observations that the law is tested on."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.errors import Errors, Reference
from harness.evaluation.regions import CellPixels
from harness.stereo.ranging import paper_law

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
    """Index into `regions.ALPHA_1_EDGES_DEG`."""
    range_bin: int
    """`floor(log(d)/log(regions.RANGE_RATIO))`, d in metres."""
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


def cells(
    parts: tuple[CellPixels, ...], truth: Reference, found: Errors, valid: NDArray[np.bool_], baseline_m: float
) -> list[dict[str, Any]]:
    """The cells of one trial with enough estimates, as JSON-able tables in a fixed order.

    Parameters
    ----------
    valid
        `[height, width]`: pixels with an estimate of the range.
    """
    seen, angle, distance = valid.ravel(), found.alpha_2.ravel(), found.range_m.ravel()
    disparity, range_m, law = found.disparity_px.ravel(), truth.range_m.ravel(), truth.law.ravel()
    table = []
    for part in parts:
        have = part.pixels[seen[part.pixels]]
        if have.size < MIN_PIXELS:
            continue
        ranges = range_m[have]
        cell = Cell(
            surface=part.surface,
            alpha_bin=part.alpha_bin,
            range_bin=part.range_bin,
            pixels=int(have.size),
            range_m=_median(ranges),
            spread_m=NORMAL * _median(np.abs(distance[have])),
            sigma_alpha=NORMAL * _median(np.abs(angle[have])),
            law_exact=_median(law[have]),
            law_paper=_median(paper_law(ranges, baseline_m)),
            disparity_bias_px=_median(disparity[have]),
            missing=1 - have.size / part.pixels.size,
            gross=float(np.mean(np.abs(disparity[have]) > 1)),
        )
        table.append(asdict(cell))
    return table


def _median(values: Array) -> float:
    return float(np.median(values))
