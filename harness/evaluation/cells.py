"""A trial's errors in cells of surface, direction and range: the observations that the law is tested on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from harness.evaluation._grouping_kernels import GROSS
from harness.evaluation.groups import medians_of_scored
from harness.evaluation.tally import Tally
from harness.geometry.triangulation import paper_law

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


def cells(errors: Tally, baseline_m: float, pixel_rad: float) -> list[dict[str, Any]]:
    """The cells of one trial with enough estimates, as JSON-able tables in a fixed order.

    pixel_rad : one pixel of disparity in radians.
    """
    layout = errors.layout
    of_cells = slice(len(layout.regions), None)
    count = errors.count[of_cells]
    range_m = medians_of_scored(layout.by_range, errors.scored, count)
    law = medians_of_scored(layout.by_law, errors.scored, count)
    with np.errstate(invalid="ignore"):
        gross = errors.sums[of_cells, GROSS] / count
    columns = {
        "pixels": count,
        "range_m": range_m,
        "spread_m": NORMAL * errors.median_abs_m[of_cells],
        "sigma_alpha": NORMAL * errors.median_abs_px[of_cells] * pixel_rad,
        "law_exact": law,
        # The median of d²/|t| is that of d, squared, except where it is the mean of two middle values.
        "law_paper": paper_law(range_m, baseline_m),
        "disparity_bias_px": errors.median_px[of_cells],
        "missing": 1 - count / np.array([part.pixels.size for part in layout.cells]),
        "gross": gross,
    }
    named = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [
        vars(Cell(part.surface, part.alpha_bin, part.range_bin, *values))
        for part, values in zip(layout.cells, named, strict=True)
        if values[0] >= MIN_PIXELS
    ]
