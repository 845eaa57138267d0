"""The field of view of a calibrated sensor: the part that the boards covered, and a little more."""

import math

import numpy as np

from harness.calibration.circle import Circle
from harness.calibration.corners import Corners
from harness.calibration.uncertainty import angles_off_axis
from harness.camera.intrinsics import FieldOfView
from harness.camera.sensor import Sensor

_BEYOND_DEG = 1.0
"""Margin of the field beyond the outermost corner if no image circle was detected."""
_MOST_BEYOND_DEG = 3.0
"""The most that the field extends towards the image circle: farther out a model extrapolates."""
_INWARD_DEG = 3.0
"""Margin of the field inside the innermost corner, for mirrors, in the middle of which the camera sees itself."""


def covered_field(sensor: Sensor, corners: Corners, circle: Circle | None) -> FieldOfView:
    """The widest cone about the optical axis, in tenths of a degree, that the corners support and the model allows.

    For a sensor that looks up or down it is written as elevations, otherwise as an angle off the axis.

    Parameters
    ----------
    sensor
        Its own field is ignored.
    """
    off_axis = np.degrees(angles_off_axis(sensor, corners.pixels))
    outermost, innermost = float(np.nanmax(off_axis)), float(np.nanmin(off_axis))
    widest = outermost + _BEYOND_DEG
    if circle is not None:
        widest = min(max(_circle_angle_deg(sensor, circle), outermost), outermost + _MOST_BEYOND_DEG)
    narrowest = max(0.0, innermost - _INWARD_DEG) if sensor.mirrored else 0.0
    angle = math.floor(10 * widest) / 10
    while angle > narrowest + 1 and not _can_have(sensor, _cone(sensor, narrowest, angle)):
        angle -= 0.1
    return _cone(sensor, narrowest, angle)


def _cone(sensor: Sensor, narrowest_deg: float, widest_deg: float) -> FieldOfView:
    inner, outer = math.floor(10 * narrowest_deg) / 10, round(widest_deg, 1)
    if sensor.looks == "up":
        return FieldOfView(elevation_min_deg=max(round(90 - outer, 1), -90), elevation_max_deg=90 - inner)
    if sensor.looks == "down":
        return FieldOfView(elevation_min_deg=inner - 90, elevation_max_deg=min(round(outer - 90, 1), 90))
    return FieldOfView(elevation_min_deg=-90, elevation_max_deg=90, angle_max_deg=outer)


def _can_have(sensor: Sensor, field: FieldOfView) -> bool:
    try:
        Sensor.model_validate(dict(sensor.model_copy(update={"field": field})))
    except ValueError:
        return False
    return True


def _circle_angle_deg(sensor: Sensor, circle: Circle) -> float:
    """The smallest angle off the axis along the image circle; 0 if no point of it has a ray."""
    around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = np.stack(
        [circle.u + circle.radius_px * np.cos(around), circle.v + circle.radius_px * np.sin(around)], axis=-1
    )
    angles = np.degrees(angles_off_axis(sensor, rim))
    return float(np.nanmin(angles)) if np.isfinite(angles).any() else 0.0
