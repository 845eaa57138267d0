"""Figures of the shape of a map of ranges, which errors pixel by pixel do not show: its seam, boundaries and normals.

As in the benchmarks Helvipad (the seam) and Pano3D (boundaries, after Hu et al., WACV 2019, and normals).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.evaluation import _shape_kernels as _kernels
from harness.geometry.angles import Array

Mask = NDArray[np.bool_]

EDGES_M = (0.25, 0.5, 1.0)
"""A pixel is on a boundary where Sobel's gradient of the range, unnormalised, is longer than this."""
NORMALS_DEG = (11.25, 22.5, 30.0)


@dataclass(frozen=True, repr=False)
class Shape(OneLine):
    """The true shape of a picture, on view 1's panorama `[height, width]`: trials share it."""

    range_m: Array
    domain: Mask
    directions: Array
    """`[height, width, 3]`, unit vectors; normals are in the same frame."""
    edge: Array
    """The length of Sobel's gradient of the true range, metres; NaN where a neighbour has no range."""
    normal: Array
    """`[height, width, 3]`, by the true points of the four neighbours: smeared at an edge as an estimate's are."""
    smooth: Mask
    """Pixels of the domain that are not next to a jump in range."""
    around: bool
    """Whether the first and the last column are neighbours, as in a panorama: there is a seam."""


def shape_of(range_m: Array, domain: Mask, directions: Array, discontinuity: Mask) -> Shape:
    """The true shape of any map, `[height, width]`, with unit directions `[height, width, 3]`."""
    around = goes_around(directions)
    edge, normal = edges_and_normals(range_m, directions, around=around)
    return Shape(range_m, domain, directions, edge, normal, domain & ~discontinuity, around)


def goes_around(directions: Array) -> bool:
    """Whether the last column of a map is next to its first one: no farther from it than the second one, by half."""
    cosines = (np.einsum("ij,ij->i", directions[:, 0], directions[:, column]) for column in (-1, 1))
    last, second = (np.sort(each[np.isfinite(each)]) for each in cosines)
    if not last.size or not second.size:
        return False
    angles = (np.arccos(np.clip(each[each.size // 2], -1, 1)) for each in (last, second))
    return bool(next(angles) <= 1.5 * next(angles))


def edges_and_normals(range_m: Array, directions: Array, *, around: bool) -> tuple[Array, Array]:
    """The length of Sobel's gradient, metres, and unit normals towards the viewpoint, of a map of ranges."""
    edge, normal = np.empty(range_m.shape), np.empty(directions.shape)
    range_m = np.ascontiguousarray(range_m, dtype=np.float64)
    _kernels.sobel(range_m, around, edge)
    _kernels.normals(range_m, np.ascontiguousarray(directions), around, normal)
    return edge, normal


@dataclass(frozen=True)
class ShapeScores:
    """The figures; NaN where there is nothing to take one from."""

    seam_m: float
    """Left-right consistency error: the mean over rows of the difference between the range errors in the first and in
    the last column, absolute, metres. A jump at the seam that is not in the scene."""
    seam_px: float
    """Left-right consistency error of disparities, pixels."""
    precision: tuple[float, float, float]
    """The share of the estimate's boundary pixels that are boundary pixels of the truth, for each of `EDGES_M`."""
    recall: tuple[float, float, float]
    """The share of the truth's boundary pixels that are boundary pixels of the estimate; one without an estimate, or
    without a neighbour's, is missed."""
    normal_mean_deg: float
    normal_rmse_deg: float
    """The angle between the normals of estimate and truth."""
    normal_within: tuple[float, float, float]
    """Shares of normals within each of `NORMALS_DEG`."""


def shape_scores(shape: Shape, range_error_m: Array, disparity_error_px: Array, valid: Mask) -> ShapeScores:
    """The figures of an estimate.

    Parameters
    ----------
    range_error_m, disparity_error_px
        `[height, width]`, estimate minus truth; NaN where either is missing.
    valid
        Pixels with an estimate.
    """
    error = np.where(valid, range_error_m, np.nan)
    edge, normal = edges_and_normals(shape.range_m + error, shape.directions, around=shape.around)
    boundaries, angles, within = np.zeros((len(EDGES_M), 3)), np.zeros(3), np.zeros(len(NORMALS_DEG))
    _kernels.compare(
        edge, normal, shape.edge, shape.normal, shape.domain, shape.smooth, np.array(EDGES_M), np.array(NORMALS_DEG),
        boundaries, angles, within,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        recall, precision = (boundaries[:, 2] / boundaries[:, which] for which in (0, 1))
        mean, mean_square = angles[1:] / angles[0]
        shares = within / angles[0]
    return ShapeScores(
        seam_m=_seam(error, shape.domain) if shape.around else np.nan,
        seam_px=_seam(disparity_error_px, shape.domain & valid) if shape.around else np.nan,
        precision=_three(precision),
        recall=_three(recall),
        normal_mean_deg=float(mean),
        normal_rmse_deg=float(np.sqrt(mean_square)),
        normal_within=_three(shares),
    )


def _three(values: Array) -> tuple[float, float, float]:
    one, two, three = map(float, values)
    return one, two, three


def _seam(error: Array, domain: Mask) -> float:
    """The mean over rows of the difference of errors across the seam; NaN where no row has both columns."""
    apart = np.abs(error[:, 0] - error[:, -1])[domain[:, 0] & domain[:, -1]]
    known = apart[np.isfinite(apart)]
    return float(known.mean()) if known.size else np.nan
