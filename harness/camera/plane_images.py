"""The image of a plane through the viewpoint, such as an epipolar plane."""

import numpy as np
from numpy.typing import ArrayLike

from harness.camera.equivalents import equivalent
from harness.camera.mount import camera_from_sensor
from harness.camera.optics import optics_of
from harness.camera.sensor import Sensor, project
from harness.geometry.angles import Array, normalise
from harness.geometry.conics import Conic, epipolar_conic


def plane_conic(sensor: Sensor, normal: ArrayLike) -> Conic | None:
    """The conic, in pixels, on which the directions of a plane are projected.

    Parameters
    ----------
    normal
        `[3]`, of the plane, in the sensor's frame: of view 1's epipolar plane `t × x_1`, of view 2's that turned by R.

    Returns
    -------
    Conic or None
        None where the image of a plane is no conic: the camera model is not a unified one, or has lens distortion.
    """
    unified = equivalent(optics_of(sensor), "unified")
    if unified is None or not unified.lens.is_pinhole:
        return None
    xi: float = getattr(unified.model, "xi")  # noqa: B009 - any class of settings with this key
    lens_from_sensor = (
        camera_from_sensor(sensor.looks, mirrored=sensor.mirrored) @ sensor.mount.R_sensor_from_untilted.T
    )
    camera = unified.camera
    K = [
        [camera.focal_px, camera.skew_px, camera.cx_px],
        [0.0, camera.focal_px * camera.aspect, camera.cy_px],
        [0.0, 0.0, 1.0],
    ]
    return epipolar_conic(lens_from_sensor @ np.asarray(normal, dtype=np.float64), xi).in_image(K)


def plane_points(sensor: Sensor, normal: ArrayLike, count: int = 720) -> Array:
    """Pixels `[count, 2]` of directions all round a plane, for any camera model; NaN outside the sensor's field.

    Parameters
    ----------
    normal
        As in `plane_conic`.
    """
    normal = normalise(normal)
    other = np.eye(3)[np.argmin(np.abs(normal))]
    first = normalise(np.cross(normal, other))
    angle = 2 * np.pi * np.arange(count)[:, None] / count
    pixels, visible = project(sensor, np.cos(angle) * first + np.sin(angle) * np.cross(normal, first))
    return np.where(visible[:, None], pixels, np.nan)
