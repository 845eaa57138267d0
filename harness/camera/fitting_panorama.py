"""The panorama that suits two sensors: the rows that both see, in square pixels that are little larger than theirs."""

import math

import numpy as np

from harness.camera.sensor import Sensor, jacobian, project
from harness.camera.visible_rows import with_rows
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid

SHARE = 0.7
"""Panorama pixels per image pixel, along the row nearest the horizon: the default sensor's 1027 columns make 720."""
WIDTHS_PX = 360, 2160
"""Least and largest width."""
STEP_PX = 40
"""Widths are multiples of this."""
HIGHEST_PX = 1200
"""Most rows; the rows farthest from the horizon are left out beyond."""
_AZIMUTHS = 360


def fitting_grid(sensors: tuple[Sensor, ...], R_v2_from_v1: Array | None = None) -> Grid:
    """The panorama that suits sensors: what all of them see, at nearly their resolution.

    Rows are those of `with_rows`. The width is 0.7 times the number of image pixels around the row nearest the
    horizon (the median over azimuths and sensors of the tangential resolution, pixels per radian, times 2 pi), as a
    multiple of 40 within 360 .. 2160. Pixels are square at the horizon: a row is 2 pi/width high. There are at most
    1200 rows; of more, those farthest from the horizon are left out.

    Parameters
    ----------
    sensors
        The sensors of view 1, or of both views.
    R_v2_from_v1
        `[3, 3]`; turns directions of view 1, whose panorama it is, into view 2's. The identity when None.

    Raises
    ------
    ValueError
        When no direction within 75 degrees of the horizon is seen by all of them.
    """
    rows = with_rows(Grid(z_min="auto", z_max="auto"), sensors, R_v2_from_v1)
    z_min, z_max = float(rows.z_min), float(rows.z_max)
    wanted = SHARE * _pixels_around(sensors, R_v2_from_v1, min(max(0.0, z_min), z_max))
    width = min(max(STEP_PX * round(wanted / STEP_PX), WIDTHS_PX[0]), WIDTHS_PX[1])
    pitch = 2 * math.pi / width
    height = min(max(3, math.floor((z_max - z_min) / pitch + 1e-9)), HIGHEST_PX)
    # Whole rows within the field: the remainder of a row is cut off at the end farther from the horizon.
    if z_max >= -z_min:
        low = max(z_min, min(-height * pitch / 2, z_max - height * pitch))
        return Grid(width_px=width, height_px=height, z_min=low, z_max=low + height * pitch)
    high = min(z_max, max(height * pitch / 2, z_min + height * pitch))
    return Grid(width_px=width, height_px=height, z_min=high - height * pitch, z_max=high)


def _pixels_around(sensors: tuple[Sensor, ...], R_v2_from_v1: Array | None, z: float) -> float:
    """Image pixels around the row z of view 1's panorama, if all of it were seen as its median azimuth is."""
    phi = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    length = math.hypot(1, z)
    rays = np.stack([np.cos(phi), np.sin(phi), np.full_like(phi, z)], axis=-1) / length
    # The derivative of a direction by its azimuth.
    along = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1) / length
    densities = []
    for sensor, R in zip(sensors, (np.eye(3), R_v2_from_v1), strict=False):
        turned, moves = (each if R is None else each @ R.T for each in (rays, along))
        visible = project(sensor, turned)[1]
        if visible.any():
            slopes = jacobian(sensor, turned[visible])
            densities.append(np.linalg.norm(np.einsum("nij,nj->ni", slopes, moves[visible]), axis=-1))
    return 2 * math.pi * float(np.median(np.concatenate(densities))) if densities else 0.0
