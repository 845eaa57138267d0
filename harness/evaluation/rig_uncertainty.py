"""The uncertainty of a rig: standard deviations of its parameters, and the covariances that propagation starts from."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor
from harness.evaluation.calibrated import Calibrated
from harness.evaluation.propagation import (
    MISALIGNMENT,
    MOTION,
    ODOMETRY,
    Parameter,
    calibration_parameters,
    diagonal,
)
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.spec import Spec

Deviation = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]

Misaligned = Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)]
"""Standard deviation of a misalignment, degrees or millimetres: ten of the largest exceed any possible mounting."""

Share = Annotated[float, Field(ge=0, le=0.1)]

ALIGNMENT = MISALIGNMENT[:5]
"""The misalignments without the turn about the mirror's axis, which is part of the believed rotation."""


class Odometry(Spec):
    """Standard deviations that grow with the motion between the views, as of wheels and gyroscopes; zero for exact."""

    along: Share = 0.0
    """Standard deviation of t along the path, as a share of |t|: 0.01 is 1 cm on a metre."""
    across: Share = 0.0
    """Standard deviation of t across the path, sideways and upwards each, as a share of |t|."""
    rotation_deg_per_m: Deviation = 0.0
    """Standard deviation of the rotation about each axis, degrees per metre of |t|."""
    rotation_per_turn: Share = 0.0
    """Standard deviation of the rotation about each axis, as a share of the angle that view 2 is turned by: radians per
    radian, so that 0.01 is 0.9 degrees on a turn of 90."""

    def sigmas(self, motion: Motion) -> dict[str, float]:
        """Standard deviations of `propagation.ODOMETRY`, by key, for a motion: independent parts add as variances."""
        turned = float(Rotation.from_matrix(motion.R_v2_from_v1).magnitude())
        rotation_deg = math.hypot(
            self.rotation_deg_per_m * motion.baseline_m, math.degrees(self.rotation_per_turn * turned)
        )
        t_deg = math.degrees(self.across)  # a t that is off by a share across points elsewhere by as many radians
        sigmas = (rotation_deg, rotation_deg, rotation_deg, t_deg, t_deg, self.along)
        return dict(zip((each.key for each in ODOMETRY), sigmas, strict=True))


class Uncertainty(Spec):
    """Standard deviations of the rig's believed parameters; zero for exact ones."""

    rotation_deg: Deviation = 0.0
    """Standard deviation of view 2's rotation about each axis, degrees."""
    t_direction_deg: Deviation = 0.0
    """Standard deviation of the baseline's direction, sideways and upwards each, degrees."""
    t_length: Share = 0.0
    """Standard deviation of the baseline's length, as a share of it: 0.01 is 1 %."""
    focal: Share = 0.0
    """Standard deviation of the focal length, as a share of it."""
    centre_px: Deviation = 0.0
    """Standard deviation of each coordinate of the principal point, pixels."""
    shape: Share = 0.0
    """Standard deviation of each number of the camera model: as a share of it for the lengths of a hyperboloid mirror,
    absolute for other models."""
    alignment_mm: Misaligned = 0.0
    """Standard deviation of each coordinate of the camera beside its mirror's focus, millimetres; for hyperboloid
    mirrors."""
    alignment_deg: Misaligned = 0.0
    """Standard deviation of the camera's tilt against its mirror about each axis, degrees."""
    odometry: Odometry = Odometry()
    """Uncertainty that grows with the motion between the views, in addition to the constant parts above."""
    calibration: Calibrated = None
    """Path of the JSON file that `omnirange calibrate` wrote: errors of the calibration are drawn from its covariance,
    beside those above."""


def covariances(sensor: Sensor, known: Uncertainty, motion: Motion) -> list[tuple[str, tuple[Parameter, ...], Array]]:
    """The causes of a rig's uncertainty, each with its parameters and their covariance.

    Parameters
    ----------
    sensor
        The sensor of both views.
    motion
        Between them, with which the odometry's errors grow.
    """
    calibration = calibration_parameters(sensor)
    of_part = {"camera.focal_px": known.focal, "camera.cx_px": known.centre_px, "camera.cy_px": known.centre_px}
    of_calibration = of_part | {each.key: known.shape for each in calibration if each.key.startswith("model.")}
    calibrated = () if known.calibration is None else known.calibration.parameters(sensor)
    aligned = ALIGNMENT if isinstance(sensor.model, Mirror) else ()
    of_alignment = {each.key: known.alignment_deg if "rotation" in each.key else known.alignment_mm for each in aligned}
    causes: list[tuple[str, tuple[Parameter, ...], dict[str, float]]] = [
        ("rotation", MOTION[:3], {each.key: known.rotation_deg for each in MOTION[:3]}),
        ("t direction", MOTION[3:5], {each.key: known.t_direction_deg for each in MOTION[3:5]}),
        ("t length", MOTION[5:], {"t_length": known.t_length}),
        ("odometry", ODOMETRY, known.odometry.sigmas(motion)),
        ("calibration", (*calibration, *calibrated), of_calibration | {each.key: 1.0 for each in calibrated}),
        ("alignment", aligned, of_alignment),
    ]
    return [(name, parameters, diagonal(parameters, sigmas)) for name, parameters, sigmas in causes]


def uncertain(sensor: Sensor, known: Uncertainty, motion: Motion) -> list[tuple[Parameter, float]]:
    """The parameters that are not exact, with their standard deviations."""
    return [
        (parameter, float(np.sqrt(variance)))
        for _, parameters, covariance in covariances(sensor, known, motion)
        for parameter, variance in zip(parameters, np.diag(covariance), strict=True)
        if variance
    ]
