"""Errors per pixel, and the pixels on which they count."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.evaluation import _grouping_kernels as _kernels
from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves
from harness.simulation.truth import Truth

MIN_SINE_ALPHA_1 = 0.5
"""Directions nearer than 30° to the baseline are left out: the range is over twice as sensitive to the angle there."""

_WALL = 0.5
"""A surface is a wall when its normal is more than 60° from the vertical."""


@dataclass(frozen=True, repr=False)
class Reference(OneLine):
    """The truth in the matcher's terms, on view 1's panorama `[height, width]`."""

    domain: NDArray[np.bool_]
    """Pixels that figures are computed over: the truth is visible in both views and sin(alpha_1) >= 0.5."""
    sideways: NDArray[np.bool_]
    """Pixels with sin(alpha_1) >= 0.5, whether or not anything is seen there."""
    wall: NDArray[np.bool_]
    """Pixels on steep surfaces; the rest of the domain is floor or ceiling."""
    range_m: Array
    alpha_1: Array
    alpha_2: Array
    """True angles to t in the epipolar plane, radians."""
    law: Array
    """|∂d_1/∂alpha_2| at the true angles, metres per radian."""
    half_step: Array
    """Half the distance in alpha_2 between neighbouring samples of the pixel's curve at the true match, radians."""


@dataclass(frozen=True, repr=False)
class Errors(OneLine):
    """Estimate minus truth on view 1's panorama; NaN where there is no estimate or no truth."""

    alpha_2: Array
    """Radians."""
    disparity_px: Array
    """Errors of alpha_2 in pixels of `2 pi / width`."""
    range_m: Array


def reference(truth: Truth, directions_v1: Array, curves: Curves) -> Reference:
    """The truth that matches are compared with, in the matcher's terms.

    With the point known, so is p = d_1 x_1 - t, and all follows without another angle: alpha_2 between p and t (eq. 6),
    the law |p|²/(|t| sin alpha_1) (eq. 11), and the step of alpha_2 with phi, see `epipolar.angular_step`, where
    1 - u_z² = (p_x² + p_y²)/|p|².

    Parameters
    ----------
    truth
        On view 1's panorama.
    directions_v1
        `[height, width, 3]`, unit vectors of the same pixels.
    """
    shape = truth.range_m.shape
    alpha_2, law, half_step = np.empty((3, *shape))
    sideways = np.empty(shape, dtype=bool)
    _kernels.true_angles(
        truth.range_m.ravel(),
        directions_v1.reshape(-1, 3),
        curves.alpha_1.ravel(),
        curves.step.ravel(),
        curves.n[..., 2].ravel(),
        curves.t,
        curves.sampling == "phi",
        MIN_SINE_ALPHA_1,
        sideways.reshape(-1),
        alpha_2.reshape(-1),
        law.reshape(-1),
        half_step.reshape(-1),
    )
    return Reference(
        domain=truth.visible & sideways,
        sideways=sideways,
        wall=np.abs(np.nan_to_num(truth.normal[..., 2], nan=1.0)) < _WALL,
        range_m=truth.range_m,
        alpha_1=curves.alpha_1,
        alpha_2=alpha_2,
        law=law,
        half_step=half_step,
    )


def errors(alpha_2: Array, range_m: Array, truth: Reference, phi_pitch: float) -> Errors:
    """Errors of estimated angles and ranges; `phi_pitch` is one pixel of disparity in radians."""
    angle = alpha_2 - truth.alpha_2
    return Errors(alpha_2=angle, disparity_px=angle / phi_pitch, range_m=range_m - truth.range_m)
