"""Errors of the motion and the calibration that the matcher is given."""

from typing import Annotated, Literal

from pydantic import Field

from harness.camera.central import central_of
from harness.camera.central_fit import nearest_central
from harness.camera.misalignment import Misalignment
from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.evaluation.propagation import MOTION, ODOMETRY, Parameter, Rig, calibration_parameters
from harness.evaluation.rig_uncertainty import Uncertainty, uncertain
from harness.geometry.pose import Motion
from harness.simulation.noise import generator
from harness.spec import Spec, parse

Error = Annotated[float, Field(ge=-1000, le=1000)]


class Believed(Spec):
    """Errors of the rig that the matcher is given, believed less true: fixed ones, and ones that the seed draws.

    Images come from the true rig. Ranges are those that the matcher finds with the motion and the calibration that it
    believes; they are compared with the truth along the directions that it believes.
    """

    rotation_x_deg: Error = 0.0
    """View 2 is believed to be turned too far about x of view 1's frame, degrees."""
    rotation_y_deg: Error = 0.0
    """View 2 is believed to be turned too far about y of view 1's frame, degrees."""
    rotation_z_deg: Error = 0.0
    """View 2 is believed to be turned too far about z of view 1's frame, degrees."""
    t_azimuth_deg: Error = 0.0
    """The baseline is believed to point too far to the side, degrees."""
    t_elevation_deg: Error = 0.0
    """The baseline is believed to point too far up, degrees."""
    t_length: Annotated[float, Field(gt=-1, le=10)] = 0.0
    """The baseline is believed to be too long, as a share of it: 0.01 is 1 %."""
    focal: Annotated[float, Field(gt=-1, le=10)] = 0.0
    """The focal length is believed to be too long, as a share of it."""
    cx_px: Error = 0.0
    """The principal point is believed to be too far right, pixels."""
    cy_px: Error = 0.0
    """The principal point is believed to be too far down, pixels."""
    shape: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """Error of the first number of the camera model: a share of a hyperboloid mirror's `a_m`, absolute for others."""
    alignment: Literal["nominal", "central"] = "nominal"
    """The believed sensor of a misaligned mirror: `nominal`, an aligned one; `central`, the best calibration of a
    central sensor."""
    sigma: Uncertainty = Uncertainty()
    """Standard deviations of errors that are drawn by the seed, beside the fixed ones. Those of the alignment belong to
    the true mirror, which is believed to be aligned."""

    @property
    def is_true(self) -> bool:
        """Whether the believed rig is the true one."""
        return self == Believed()


def draws_of(sensor: Sensor, sigma: Uncertainty, motion: Motion, seed: int) -> dict[str, float]:
    """The errors that a seed draws, by the key of `propagation.Parameter`, in proportion to the standard deviations.

    Parameters
    ----------
    motion
        The true one, with which the odometry's errors grow.
    """
    errors = {}
    for parameter, deviation in uncertain(sensor, sigma, motion):
        unit = generator(seed, "believed", parameter.key).standard_normal()
        errors[parameter.key] = deviation * float(unit)
    return errors


def misaligned(sensor: Sensor, draws: dict[str, float]) -> Sensor:
    """The sensor as it truly is: with the misalignment that was drawn beside its own.

    Raises
    ------
    InputError
        If the standard deviations are so large that the draw is no valid misalignment.
    """
    drawn = {key.partition(".")[2]: error for key, error in draws.items() if key.startswith("misalignment.")}
    if not drawn or not isinstance(sensor.model, Mirror):
        return sensor
    added = {name: getattr(sensor.misalignment, name) + error for name, error in drawn.items()}
    table = sensor.misalignment.model_dump() | added
    return sensor.model_copy(
        update={"misalignment": parse(Misalignment, table, key="trial.believed.sigma, as drawn: misalignment")}
    )


def believed_rig(true: Rig, believed: Believed, draws: dict[str, float]) -> Rig:
    """The rig that the matcher is given.

    Parameters
    ----------
    true
        With central sensors.
    draws
        From `draws_of`.
    """
    rig = true
    calibration = believed.sigma.calibration
    calibrated = () if calibration is None else calibration.parameters(true.sensors[0])
    for parameter in (*MOTION, *ODOMETRY, *calibration_parameters(true.sensors[0]), *calibrated):
        error = _fixed(believed, parameter, true.sensors[0]) + draws.get(parameter.key, 0.0)
        if error:
            rig = parameter.changed(rig, error)
    return rig


def calibrated(true: Rig, believed: Believed) -> Rig:
    """The rig with central sensors in place of misaligned ones."""
    if believed.alignment == "nominal":
        first, second = (central_of(each) for each in true.sensors)
    else:
        first, second = (_best_of(each) for each in true.sensors)
    return Rig((first, second), true.motion)


def _best_of(sensor: Sensor) -> Sensor:
    if sensor.profile is None:
        return nearest_central(sensor).sensor
    if not sensor.misalignment.is_zero:
        raise InputError(
            f'"central" is for hyperboloid mirrors, not for a misaligned {sensor.profile.title}; use "nominal"',
            key="trial.believed.alignment",
        )
    return central_of(sensor)


def _fixed(believed: Believed, parameter: Parameter, sensor: Sensor) -> float:
    part, dot, name = parameter.key.rpartition(".")
    if part == "model":
        first = next(each for each in calibration_parameters(sensor) if each.key.startswith("model."))
        return believed.shape if parameter.key == first.key else 0.0
    name = {"focal_px": "focal"}.get(name, name)
    return float(getattr(believed, name, 0.0)) if part in ("", "camera") or not dot else 0.0
