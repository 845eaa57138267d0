"""A sensor's projection as a table, for the page: it serves every camera model, those from elsewhere too.

Directions are given by the angle off an axis and the azimuth around it. Between the nodes pixels are interpolated by
cubic polynomials through four nodes along each angle; at the ends of an angle these are the last four.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, lens_from_sensor, project
from harness.geometry.angles import Array

STEP_PX = 1 / 1024
"""Pixels are rounded to this."""
_GOOD_PX = 0.05
"""Error below which a table is accepted, pixels: a mark on the page is a hundred times as large."""
_SIZES = ((32, 48), (64, 96), (128, 192))
"""Intervals of the angle off the axis and of the azimuth, tried in turn."""
_HAIR = 1e-6
"""The axis itself has no azimuth, and a seam has two sides: nodes are so far off them, radians."""
_LOOK_DEG = 2
"""Distance of the directions that are sampled to find the extent of a sensor's field."""


@dataclass(frozen=True)
class ProjectionTable:
    """Pixels of directions at regular angles."""

    frame: Array
    """`[3, 3]`: turns directions of the sensor's frame into the table's, whose axis is z."""
    theta_max: float
    """Angle off the axis of the last row, radians; that of the first one is 0."""
    pixels: Array
    """`[rows, columns, 2]`, (u, v); the columns' azimuths go from -pi to pi, both included."""
    error_px: float
    """The largest error of interpolated pixels, between nodes, in the sensor's field."""

    def project(self, directions: Array) -> Array:
        """Pixels `[..., 2]` of directions `[..., 3]`, interpolated as on the page."""
        x, y, z = np.moveaxis(directions @ self.frame.T, -1, 0)
        rows, columns, _ = self.pixels.shape
        i, down = _taps(np.arctan2(np.hypot(x, y), z) / self.theta_max * (rows - 1), rows)
        j, across = _taps((np.arctan2(y, x) + np.pi) / (2 * np.pi) * (columns - 1), columns)
        out = np.zeros((*x.shape, 2))
        for k in range(4):
            for m in range(4):
                out += (down[k] * across[m])[..., None] * self.pixels[i + k, j + m]
        return out


def projection_table(sensor: Sensor) -> ProjectionTable:
    """The smallest table that is good enough, or else the best one.

    Around the optical axis a lens or a mirror is smooth everywhere; around the vertical one an image is that has its
    azimuth along its rows, with its seam at the borders.
    """
    around_lens, upright = lens_from_sensor(sensor), sensor.mount.R_sensor_from_untilted.T
    best: ProjectionTable | None = None
    for size in _SIZES:
        for frame in (around_lens, upright):
            table = _table(sensor, frame, *size)
            if best is None or table.error_px < best.error_px:
                best = table
            if best.error_px <= _GOOD_PX:
                return best
    assert best is not None
    return best


def _table(sensor: Sensor, frame: Array, rows: int, columns: int) -> ProjectionTable:
    theta_max = _edge(sensor, frame)
    theta, phi = np.linspace(0, theta_max, rows + 1), np.linspace(-np.pi, np.pi, columns + 1)
    ends = np.clip(theta, _HAIR, np.pi - _HAIR), np.clip(phi, _HAIR - np.pi, np.pi - _HAIR)
    pixels = project(sensor, _directions(*ends) @ frame)[0]
    if not np.isfinite(pixels).all():
        return ProjectionTable(frame, theta_max, np.nan_to_num(pixels), np.inf)
    table = ProjectionTable(frame, theta_max, np.rint(pixels / STEP_PX) * STEP_PX, 0.0)
    between = _directions((theta[1:] + theta[:-1]) / 2, (phi[1:] + phi[:-1]) / 2) @ frame
    expected, visible = project(sensor, between)
    error = np.linalg.norm(table.project(between) - expected, axis=-1)[visible]
    return ProjectionTable(frame, theta_max, table.pixels, float(error.max(initial=0.0)))


def _edge(sensor: Sensor, frame: Array) -> float:
    """The largest angle off the axis at which the sensor sees something, radians; a little more where that is known."""
    coarse, step = np.radians(np.arange(0, 180 + _LOOK_DEG, _LOOK_DEG)), np.radians(_LOOK_DEG)
    phi = np.radians(np.arange(-180, 180, 2 * _LOOK_DEG))
    visible = project(sensor, _directions(coarse, phi) @ frame)[1].any(axis=1)
    if not visible.any():
        return float(np.pi)
    for more in (1.0, 0.0):
        theta = min(np.pi, coarse[visible].max() + more * step)
        if np.isfinite(project(sensor, _directions(np.array([theta]), phi) @ frame)[0]).all():
            break
    return float(theta)


def _directions(theta: Array, phi: Array) -> Array:
    """Unit vectors `[theta, phi, 3]` in the table's frame."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(cosine, (theta.size, phi.size))], axis=-1)


def _taps(position: Array, count: int) -> tuple[NDArray[np.intp], tuple[Array, ...]]:
    """The first of four nodes around each position, and the nodes' weights: the polynomials of Lagrange."""
    first = np.clip(np.floor(position).astype(np.intp) - 1, 0, count - 4)
    s = position - first
    weights = (
        -(s - 1) * (s - 2) * (s - 3) / 6,
        s * (s - 2) * (s - 3) / 2,
        -s * (s - 1) * (s - 3) / 2,
        s * (s - 1) * (s - 2) / 6,
    )
    return first, weights
