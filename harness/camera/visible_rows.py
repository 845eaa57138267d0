"""The rows of a panorama that the sensors see: the values of `z_min` and `z_max` when they are "auto"."""

from functools import lru_cache

import numpy as np

from harness.camera.sensor import Sensor
from harness.camera.unwrap import can_be_sampled
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.spec import given_of, remember

STEP_DEG = 0.1
"""Step between the elevations that are tried, degrees."""
STEEPEST_DEG = 75.0
"""The steepest elevation that is tried: towards the poles, the rows of a cylinder cover ever smaller angles."""
AZIMUTHS = 120
MOSTLY = 0.8
"""An elevation counts where both sensors see at least this share of the azimuths that they see at a typical one. The
best one would not do: of two cameras that look to different sides the zenith alone is seen all around."""


def is_open(grid: Grid) -> bool:
    """Whether `z_min` or `z_max` is "auto", and so has to be computed for each pair of sensors."""
    return "auto" in (grid.z_min, grid.z_max, *given_of(grid).values())


def with_rows(grid: Grid, sensors: tuple[Sensor, ...], R_v2_from_v1: Array | None = None) -> Grid:
    """A panorama whose `z_min` and `z_max` are numbers: where they are "auto", the rows that all sensors see.

    Elevations are tried every 0.1 degrees from -75 to 75, at 120 azimuths. A direction counts if every image can be
    sampled there, with all taps of the cubic interpolation visible; an elevation counts if at least four fifths as many
    of its directions count as at a typical elevation, the median over the solid angle of what counts. `z_min` and
    `z_max` are the tangents of the ends of the longest unbroken run of such elevations.

    Parameters
    ----------
    sensors
        The sensors of view 1, or of both views.
    R_v2_from_v1
        `[3, 3]`; turns directions of the panorama's frame, which is view 1's, into view 2's.

    Raises
    ------
    ValueError
        When no direction is seen by all of them, or `z_min` is not below `z_max`.
    """
    if not is_open(grid):
        return grid
    words = {key: "auto" for key in ("z_min", "z_max") if "auto" in (getattr(grid, key), given_of(grid).get(key))}
    rotation = np.eye(3) if R_v2_from_v1 is None else np.asarray(R_v2_from_v1, dtype=np.float64)
    rows = _rows(sensors, rotation.tobytes())
    if rows is None:
        raise ValueError('"auto": no direction within 75 deg of the horizon is seen; give z_min and z_max as numbers')
    z = {key: value for key, value in zip(("z_min", "z_max"), rows, strict=True) if key in words}
    return remember(Grid(**grid.model_dump() | z), words)


@lru_cache(maxsize=64)
def _rows(sensors: tuple[Sensor, ...], rotation: bytes) -> tuple[float, float] | None:
    """The z of the lowest and the highest elevation; None when nothing is visible."""
    count = round(STEEPEST_DEG / STEP_DEG)
    elevations = np.radians(STEP_DEG * np.arange(-count, count + 1))
    azimuths = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    level = np.cos(elevations)[:, None]
    x, y = level * np.cos(azimuths), level * np.sin(azimuths)
    around = np.stack([x, y, np.broadcast_to(np.sin(elevations)[:, None], x.shape)], axis=-1)
    visible = np.ones(x.shape, dtype=bool)
    for sensor, turn in zip(sensors, (None, np.frombuffer(rotation).reshape(3, 3)), strict=False):
        visible &= can_be_sampled(sensor, around if turn is None else around @ turn.T)
    visible_azimuths = visible.sum(axis=1)
    if not visible_azimuths.any():
        return None
    seen = visible_azimuths * level[:, 0]  # in proportion to the solid angle
    typical = np.quantile(visible_azimuths, 0.5, weights=seen, method="inverted_cdf")
    counts = visible_azimuths >= MOSTLY * typical
    edges = np.flatnonzero(np.diff(np.concatenate([[False], counts, [False]])))
    first, end = edges[0::2], edges[1::2]
    longest = np.argmax(end - first)
    return float(np.tan(elevations[first[longest]])), float(np.tan(elevations[end[longest] - 1]))
