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
    """`[3, height, width]`, unit vectors; normals are in the same frame."""
    edge: Array
    """The length of Sobel's gradient of the true range, metres; NaN where a neighbour has no range."""
    normal: Array
    """`[3, height, width]`, by the true points of the four neighbours: smeared at an edge as an estimate's are."""
    smooth: Mask
    """Pixels of the domain that are not next to a jump in range."""
    around: bool
    """Whether the first and the last column are neighbours, as in a panorama: there is a seam."""


def shape_of(range_m: Array, domain: Mask, directions: Array, discontinuity: Mask) -> Shape:
    """The true shape of any map, `[height, width]`, with unit directions `[height, width, 3]`."""
    around = goes_around(directions)
    components = np.ascontiguousarray(np.moveaxis(directions, -1, 0))
    edge, normal = _edges_and_normals(range_m, components, around=around)
    return Shape(range_m, domain, components, edge, normal, domain & ~discontinuity, around)


def goes_around(directions: Array) -> bool:
    """Whether the last column of a map is next to its first one: no farther from it than the second one, by half."""
    cosines = (np.einsum("ij,ij->i", directions[:, 0], directions[:, column]) for column in (-1, 1))
    last, second = (np.sort(each[np.isfinite(each)]) for each in cosines)
    if not last.size or not second.size:
        return False
    angles = (np.arccos(np.clip(each[each.size // 2], -1, 1)) for each in (last, second))
    return bool(next(angles) <= 1.5 * next(angles))


def edges_and_normals(range_m: Array, directions: Array, *, around: bool) -> tuple[Array, Array]:
    """The length of Sobel's gradient, metres, and unit normals towards the viewpoint, of a map of ranges.

    Both NaN where a neighbour has no range, and at the map's border.
    """
    edge, normal = _edges_and_normals(range_m, np.ascontiguousarray(np.moveaxis(directions, -1, 0)), around=around)
    return edge, np.moveaxis(normal, 0, -1)


def _edges_and_normals(range_m: Array, components: Array, *, around: bool) -> tuple[Array, Array]:
    """The same of directions `[3, height, width]`, with normals `[3, height, width]`."""
    edge, normal = np.empty(range_m.shape), np.empty(components.shape)
    _kernels.edges_and_normals(_bordered(range_m, around=around), components, edge, normal)
    return edge, normal


def _bordered(range_m: Array, *, around: bool) -> Array:
    """A map with its neighbours around it: the other side's columns where it goes around, else NaN."""
    height, width = range_m.shape
    bordered = np.full((height + 2, width + 2), np.nan)
    bordered[1:-1, 1:-1] = range_m
    if around:
        bordered[:, 0], bordered[:, -1] = bordered[:, -2], bordered[:, 1]
    return bordered


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
    angles, turned = np.zeros(3), np.zeros(len(NORMALS_DEG) + 1, dtype=np.int64)
    edges = np.zeros((len(EDGES_M) + 1, len(EDGES_M) + 1), dtype=np.int64)
    _kernels.compare(
        _bordered(shape.range_m + error, around=shape.around), shape.directions, shape.edge, shape.normal,
        shape.domain, shape.smooth, np.array(EDGES_M), np.array(NORMALS_DEG), edges, angles, turned,
    )  # fmt: skip
    in_both = [edges[i:, i:].sum() for i in range(1, len(edges))]
    in_truth, in_estimate = (np.cumsum(edges.sum(axis=axis)[:0:-1])[::-1] for axis in (1, 0))
    with np.errstate(invalid="ignore"):
        recall, precision = in_both / in_truth, in_both / in_estimate
        mean, mean_square = angles[1:] / angles[0]
        shares = np.cumsum(turned[:-1]) / angles[0]
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
