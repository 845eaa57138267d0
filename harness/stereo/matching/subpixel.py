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

    Solves the 3x3 normal equations by Cramer's rule, with missing samples left out.
    """
    reach = costs.shape[-1] // 2
    x = np.arange(-reach, reach + 1, dtype=np.float64)
    given = np.isfinite(costs)
    y = np.where(given, costs, 0.0)
    s0, s1, s2, s3, s4 = (given @ x**power for power in range(5))
    t0, t1, t2 = (y @ x**power for power in range(3))
    # c = a x² + b x + const; the determinant that a and b share cancels in -b / 2a, and is positive for 3 points or more.
    determinant = s4 * (s2 * s0 - s1 * s1) - s3 * (s3 * s0 - s1 * s2) + s2 * (s3 * s1 - s2 * s2)
    a = t2 * (s2 * s0 - s1 * s1) - s3 * (t1 * s0 - s1 * t0) + s2 * (t1 * s1 - s2 * t0)
    b = s4 * (t1 * s0 - s1 * t0) - t2 * (s3 * s0 - s1 * s2) + s2 * (s3 * t0 - s2 * t1)
    first = np.where(given, x, np.inf).min(axis=-1)
    last = np.where(given, x, -np.inf).max(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -b / (2 * a)
        refined = (determinant > 0.5) & (a > 0) & (offset >= first) & (offset <= last)
    return np.where(refined, offset, 0.0), refined
