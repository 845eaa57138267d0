"""Sub-pixel steps: the position of the least cost between samples of an epipolar curve (section 6 of the paper)."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.window import _window_kernels

Subpixel = Literal["none", "parabola", "parabola3", "v", "shimizu-okutomi", "images"]

FROM_COSTS = ("none", "parabola", "parabola3", "v")
"""The steps that need the costs of whole samples alone."""


def refine(costs: Array, method: Subpixel) -> tuple[Array, NDArray[np.bool_]]:
    """Offset of the minimum from the middle sample.

    Parameters
    ----------
    costs
        `[..., 2 n + 1]`, costs of consecutive samples around the best one; NaN for a missing cost.
    method
        One of `FROM_COSTS`: `none`; `parabola`, least squares over all given samples, the paper's; `parabola3`, through
        the three in the middle; `v`, two lines of opposite slopes through these three.

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
    if method == "parabola":
        return parabola_minimum(costs)
    if method not in FROM_COSTS:
        raise ValueError(f"{method} needs more than the costs of whole samples")
    offset, refined = _nothing(costs)
    shape = {"parabola3": _window_kernels.PARABOLA, "v": _window_kernels.EQUIANGULAR}[method]
    _window_kernels.three_point_minima(shape, _rows(costs), offset.reshape(-1), refined.reshape(-1))
    return offset, refined


def parabola_minimum(costs: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The minimum of the least-squares parabola through each row of costs; see `refine` for shapes."""
    offset, refined = _nothing(costs)
    _window_kernels.parabola_minima(_rows(costs), offset.reshape(-1), refined.reshape(-1))
    return offset, refined


def cancelled_minimum(costs: Array, *, equiangular: bool) -> tuple[Array, NDArray[np.bool_]]:
    """Estimation error cancellation (Shimizu and Okutomi 2001, 2005).

    A fit through three samples errs by an odd function of the true offset, with the period of a sample: it pulls
    towards, or away from, whole samples. A second fit, to costs half a sample off, errs the other way, and the mean of
    both is off by far less.

    Parameters
    ----------
    costs
        `[..., 7]`, costs at -1.5, -1, ... 1.5 samples from the best one; NaN for a missing cost.
    equiangular
        Which fit: two lines, right for SAD and Hamming distances, or a parabola.

    Returns
    -------
    offset, refined
        As `refine`.
    """
    offset, refined = _nothing(costs)
    shape = _window_kernels.EQUIANGULAR if equiangular else _window_kernels.PARABOLA
    _window_kernels.cancelled_minima(shape, _rows(costs), offset.reshape(-1), refined.reshape(-1))
    return offset, refined


def _nothing(costs: Array) -> tuple[Array, NDArray[np.bool_]]:
    return np.zeros(costs.shape[:-1]), np.zeros(costs.shape[:-1], dtype=bool)


def _rows(costs: Array) -> Array:
    return np.ascontiguousarray(costs).reshape(-1, costs.shape[-1])
