"""Sub-pixel steps: where between the samples of an epipolar curve the cost is least (section 6 of the paper)."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.stereo.matching import _kernels

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
    """The minimum of the least-squares parabola through each row of costs; see `refine` for shapes."""
    shape = costs.shape[:-1]
    offset, refined = np.zeros(shape), np.zeros(shape, dtype=bool)
    _kernels.parabola_minima(costs.reshape(-1, costs.shape[-1]), offset.reshape(-1), refined.reshape(-1))
    return offset, refined
