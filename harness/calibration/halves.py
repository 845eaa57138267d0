"""Cross-validation: calibrations from half of the images each, compared with each other and on the other half."""

from dataclasses import dataclass

import numpy as np

from harness.calibration.adjust import Adjusted, adjust
from harness.calibration.corners import Corners
from harness.calibration.poses import BoardPoses, refine_poses
from harness.calibration.uncertainty import RayGrid, ray_difference
from harness.display import OneLine
from harness.geometry.angles import Array

LEAST_IMAGES = 4


@dataclass(frozen=True, repr=False, eq=False)
class Halves(OneLine):
    """Two halves of the images, each calibrated and compared with the other."""

    images: tuple[tuple[str, ...], tuple[str, ...]]
    rms_px: tuple[float, float]
    """RMS residual of each half's own corners, pixels."""
    other_rms_px: tuple[float, float]
    """RMS residual of the other half's corners, pixels; only their boards' poses are estimated again."""
    difference_px: Array
    """`[k]`: distance between the pixels to which both project the rays of a grid, up to a rotation of the sensor; NaN
    outside the domain of one of them."""


def compare_halves(adjusted: Adjusted, corners: Corners, grid: RayGrid) -> Halves | None:
    """Calibrate from every other image, and from the rest.

    None with fewer than four images, or when one of the adjustments does not converge.
    """
    count = len(corners.images)
    if count < LEAST_IMAGES:
        return None
    chosen = [list(range(begin, count, 2)) for begin in (0, 1)]
    halves = [corners.of(each) for each in chosen]
    fits: list[Adjusted] = []
    for half, own in zip(halves, chosen, strict=True):
        poses = BoardPoses(adjusted.poses.R[own], adjusted.poses.t[own])
        one = adjust(adjusted.parameters, half, adjusted.vector, poses)
        if one is None or not one.converged:
            return None
        fits.append(one)
    other_rms = []
    for one, other, own in ((fits[0], halves[1], chosen[1]), (fits[1], halves[0], chosen[0])):
        poses = BoardPoses(adjusted.poses.R[own], adjusted.poses.t[own])
        cost = refine_poses(one.parameters.compiled(one.vector), other, poses)[1]
        other_rms.append(float(np.sqrt(cost.sum() / len(other.image))))
    first, second = (each.parameters.sensor_at(each.vector) for each in fits)
    return Halves(
        images=(halves[0].images, halves[1].images),
        rms_px=(_rms(fits[0]), _rms(fits[1])),
        other_rms_px=(other_rms[0], other_rms[1]),
        difference_px=np.linalg.norm(ray_difference(first, second, grid), axis=-1),
    )


def _rms(adjusted: Adjusted) -> float:
    return float(np.sqrt(np.mean(np.sum(adjusted.residuals**2, axis=-1))))
