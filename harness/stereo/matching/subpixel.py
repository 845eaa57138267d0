"""Sub-pixel steps: where between the samples of an epipolar curve the cost is least (section 6 of the paper)."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array

Subpixel = Literal["none", "parabola"]


def refine(costs: Array, method: Subpixel) -> tuple[Array, NDArray[np.bool_]]:
    """Offset of the minimum from the middle sample.

    Parameters
    ----------
    costs
        `[..., 2 n + 1]`, costs of consecutive samples around the best one; NaN where there is none.
    method
        `none`, or `parabola`: least squares over all given samples, the paper's.

    Returns
    -------
    offset
        `[...]`, in samples; 0 where not refined.
    refined
        `[...]`, bool: the fit has a minimum among the samples it was made from. A parabola that opens downwards, or
        whose minimum lies farther out, says nothing about where the cost is least; the whole sample then stands.
    """
    if method == "none":
        return np.zeros(costs.shape[:-1]), np.zeros(costs.shape[:-1], dtype=bool)
    return parabola_minimum(costs)


def parabola_minimum(costs: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The minimum of the least-squares parabola through each row of costs; see `refine` for shapes.

    With all samples given, odd and even powers of the offset are orthogonal, and slope and curvature are two weighted
    sums of the costs. Rows with a sample missing solve the normal equations.
    """
    reach = costs.shape[-1] // 2
    rows = costs.reshape(-1, costs.shape[-1])
    x = np.arange(-reach, reach + 1, dtype=np.float64)
    n, s2, s4 = x.size, np.sum(x**2), np.sum(x**4)
    # Not by BLAS, whose threads get in each other's way where several trials run at a time.
    slope, curvature = (np.einsum("ij,j->i", rows, weights) for weights in (x / s2, (n * x**2 - s2) / (n * s4 - s2**2)))
    # A missing sample has made both sums NaN, so the comparisons are false.
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -slope / (2 * curvature)
        refined = (curvature > 0) & (np.abs(offset) <= reach)
    partial = np.flatnonzero(np.isnan(slope) & (np.count_nonzero(np.isfinite(rows), axis=-1) >= 3))
    offset[partial], refined[partial] = _parabola_through_some(rows[partial], x)
    return np.where(refined, offset, 0.0).reshape(costs.shape[:-1]), refined.reshape(costs.shape[:-1])


def _parabola_through_some(costs: Array, x: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The same through at least three finite samples of each row `[n, samples]`, by Cramer's rule."""
    given = np.isfinite(costs)
    y = np.where(given, costs, 0.0)
    s0, s1, s2, s3, s4 = (given @ x**power for power in range(5))
    t0, t1, t2 = (y @ x**power for power in range(3))
    # Of c = a x² + b x + const; the determinant that a and b share is positive and cancels in -b / 2a.
    a = t2 * (s2 * s0 - s1 * s1) - s3 * (t1 * s0 - s1 * t0) + s2 * (t1 * s1 - s2 * t0)
    b = s4 * (t1 * s0 - s1 * t0) - t2 * (s3 * s0 - s1 * s2) + s2 * (s3 * t0 - s2 * t1)
    first = np.where(given, x, np.inf).min(axis=-1, initial=np.inf)
    last = np.where(given, x, -np.inf).max(axis=-1, initial=-np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -b / (2 * a)
        return offset, (a > 0) & (offset >= first) & (offset <= last)
