"""The central sensor that fits a misaligned one best, as a good central calibration would: nearest in pixels."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from harness.camera.reflection import project_points
from harness.camera.sensor import Sensor, in_field, project
from harness.geometry.angles import Array

DISTANCE_M = 3.0
"""Distance of the points at which pixels are compared: the rays of a misaligned mirror meet in no viewpoint."""
_STEP_DEG = 6.0


class CentralFit(NamedTuple):
    """The best central sensor."""

    sensor: Sensor
    rms_px: float
    """RMS distance of its pixels from the true ones."""


@lru_cache(maxsize=256)
def nearest_central(sensor: Sensor, distance_m: float = DISTANCE_M) -> CentralFit:
    """The central sensor nearest to one whose camera and hyperboloid mirror are misaligned.

    Focal length, aspect, principal point and four lens terms are fitted by least squares to the pixels of points all
    over the field at one distance, as boards all around the sensor would determine them. The mirror's shape is held,
    since k1 does the same. The sensor's frame stays what it is: no rotation is fitted, as the motion between views is
    measured in it.

    Parameters
    ----------
    sensor
        With a hyperboloid mirror.
    distance_m
        From the inner focus.
    """
    if sensor.is_central:
        return CentralFit(sensor, 0.0)
    points = distance_m * _directions(sensor)
    pixels, valid = project_points(sensor, points)
    points, pixels = points[valid], pixels[valid]
    begin = sensor.aligned

    def residuals(vector: Array) -> Array:
        try:
            candidate = _sensor_at(begin, vector)
        except ValidationError:  # the lens folds within the field
            return np.full(pixels.size, 1e3)
        off = project(candidate, points)[0] - pixels
        return np.nan_to_num(off, nan=1e3).ravel()

    from scipy.optimize import least_squares

    fit = least_squares(residuals, np.zeros(8), x_scale=[1e-3, 1e-3, 1, 1, 1e-3, 1e-3, 1e-4, 1e-4], method="lm")
    return CentralFit(_sensor_at(begin, fit.x), float(np.sqrt(np.mean(np.sum(fit.fun.reshape(-1, 2) ** 2, axis=1)))))


def _directions(sensor: Sensor) -> Array:
    elevations = np.radians(np.arange(-84.0, 85.0, _STEP_DEG))
    azimuths = np.radians(np.arange(0.0, 360.0, _STEP_DEG))
    level, around = np.meshgrid(elevations, azimuths, indexing="ij")
    x = np.stack([np.cos(level) * np.cos(around), np.cos(level) * np.sin(around), np.sin(level)], axis=-1)
    return x[in_field(sensor, x)]


def _sensor_at(begin: Sensor, vector: Array) -> Sensor:
    """The sensor with changed parameters: relative changes of focal length and aspect, pixels, and lens terms."""
    focal, aspect, cx, cy, k1, k2, p1, p2 = vector.tolist()
    camera, lens = begin.camera, begin.lens
    changes = {
        "camera": camera.model_copy(
            update={
                "focal_px": camera.focal_px * (1 + focal),
                "aspect": camera.aspect * (1 + aspect),
                "cx_px": camera.cx_px + cx,
                "cy_px": camera.cy_px + cy,
            }
        ),
        "lens": lens.model_copy(
            update={"k1": lens.k1 + k1, "k2": lens.k2 + k2, "p1": lens.p1 + p1, "p2": lens.p2 + p2}
        ),
    }
    return begin.model_copy(update=changes)
