"""How well a rig is known: standard deviations of its numbers, and the covariances that errors are propagated from."""

from typing import Annotated

import numpy as np
from pydantic import Field

from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor
from harness.evaluation.propagation import MISALIGNMENT, MOTION, Parameter, calibration_parameters, diagonal
from harness.geometry.angles import Array
from harness.spec import Spec

Deviation = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]

Misaligned = Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)]
"""Ten sigmas of 10 degrees are past what a camera beside a mirror's focus can be; so are 10 mm for most mirrors."""

Share = Annotated[float, Field(ge=0, le=0.1)]

ALIGNMENT = MISALIGNMENT[:5]
"""Without the turn about the mirror's axis, which is the believed rotation's."""


class Uncertainty(Spec):
    """Standard deviations of what is believed of the rig; zero for what is exact."""

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


def covariances(sensor: Sensor, known: Uncertainty) -> list[tuple[str, tuple[Parameter, ...], Array]]:
    """What is uncertain of a rig: causes, with their parameters and the covariance of these.

    Parameters
    ----------
    sensor
        Of both views.
    """
    calibration = calibration_parameters(sensor)
    of_part = {"camera.focal_px": known.focal, "camera.cx_px": known.centre_px, "camera.cy_px": known.centre_px}
    of_calibration = of_part | {each.key: known.shape for each in calibration if each.key.startswith("model.")}
    aligned = ALIGNMENT if isinstance(sensor.model, Mirror) else ()
    of_alignment = {each.key: known.alignment_deg if "rotation" in each.key else known.alignment_mm for each in aligned}
    causes: list[tuple[str, tuple[Parameter, ...], dict[str, float]]] = [
        ("rotation", MOTION[:3], {each.key: known.rotation_deg for each in MOTION[:3]}),
        ("t direction", MOTION[3:5], {each.key: known.t_direction_deg for each in MOTION[3:5]}),
        ("t length", MOTION[5:], {"t_length": known.t_length}),
        ("calibration", calibration, of_calibration),
        ("alignment", aligned, of_alignment),
    ]
    return [(name, parameters, diagonal(parameters, sigmas)) for name, parameters, sigmas in causes]


def uncertain(sensor: Sensor, known: Uncertainty) -> list[tuple[Parameter, float]]:
    """The parameters that are not exact, with their standard deviations."""
    return [
        (parameter, float(np.sqrt(variance)))
        for _, parameters, covariance in covariances(sensor, known)
        for parameter, variance in zip(parameters, np.diag(covariance), strict=True)
        if variance
    ]
