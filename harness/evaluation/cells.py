"""A trial's errors in cells of surface, direction and range: the observations that the law is tested on."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from harness.evaluation.errors import Reference
from harness.evaluation.groups import counts, means, medians
from harness.evaluation.metrics import Ranked
from harness.evaluation.regions import Layout
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


def cells(layout: Layout, truth: Reference, errors: Ranked, baseline_m: float) -> list[dict[str, Any]]:
    """The cells of one trial with enough estimates, as JSON-able tables in a fixed order."""
    groups, seen = layout.cell_groups, errors.seen
    count = counts(groups, seen)
    range_m = medians(groups, seen, count, truth.range_m.ravel(), layout.by_range)
    spread_m = NORMAL * medians(groups, seen, count, errors.off_m, errors.by_off)
    spread_px = NORMAL * medians(groups, seen, count, errors.absolute_px, errors.by_absolute)
    law = medians(groups, seen, count, truth.law.ravel(), layout.by_law)
    bias_px = medians(groups, seen, count, errors.disparity_px, errors.by_disparity)
    gross = means(groups, seen, count, (errors.absolute_px > 1).astype(np.float64)[:, None])[:, 0]
    # The median of d²/|t| is that of d, squared, but for the mean of two middle values.
    law_paper = paper_law(range_m, baseline_m)
    return [
        asdict(
            Cell(
                surface=part.surface,
                alpha_bin=part.alpha_bin,
                range_bin=part.range_bin,
                pixels=int(count[i]),
                range_m=float(range_m[i]),
                spread_m=float(spread_m[i]),
                sigma_alpha=float(spread_px[i] * errors.pixel_rad),
                law_exact=float(law[i]),
                law_paper=float(law_paper[i]),
                disparity_bias_px=float(bias_px[i]),
                missing=float(1 - count[i] / part.pixels.size),
                gross=float(gross[i]),
            )
        )
        for i, part in enumerate(layout.cells)
        if count[i] >= MIN_PIXELS
    ]
