"""Chessboards in images that bend straight lines.

OpenCV's detector wants squares that look like squares. A mirror or a fisheye leaves few boards that do, so an image is
also looked at through perspective windows in many directions, made with a rough sensor: a stereographic one, which
keeps angles, over the image circle, or one that was calibrated from other images. What is found there is brought back
and refined in the image itself.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.calibration.circle import Circle
from harness.calibration.corners import Board
from harness.calibration.start import unified_sensor
from harness.camera._projection_kernels import project_all
from harness.camera.sensor import Sensor, parameters_of, unproject
from harness.geometry.angles import Array

Grey8 = NDArray[np.uint8]

_RIM_DEG = 105.0
"""Angle off the axis that a rough sensor has at the image circle: between a fisheye's 90 and a mirror's 115."""
_WINDOW_DEG = 100.0
_TURN_DEG = 30.0
_OFF_AXIS_DEG = (70.0, 40.0, 95.0)
"""How far off the axis windows look, the most likely first."""
_MOST_PX, _LEAST_PX = 1200, 480
"""Sides of a window, pixels."""


@dataclass(frozen=True)
class Window:
    """A perspective view: a square of `size` pixels that looks along the last row of `axes`."""

    axes: Array
    """`[3, 3]`: its right, its down and its viewing direction in the sensor's frame."""
    size: int
    tangent: float
    """Of half its angle."""

    def directions(self, x: Array, y: Array) -> Array:
        """Directions `[..., 3]` in the sensor's frame of its pixels."""
        scale = 2 * self.tangent / (self.size - 1)
        middle = (self.size - 1) / 2
        local = np.stack([(x - middle) * scale, (y - middle) * scale, np.ones_like(x)], axis=-1)
        return np.asarray(local @ self.axes)


def rough_sensor(width_px: int, height_px: int, circle: Circle | None) -> Sensor:
    """A stereographic sensor over the image circle, or over the whole image where there is none."""
    if circle is None:
        circle = Circle((width_px - 1) / 2, (height_px - 1) / 2, min(width_px, height_px) / 2)
    # r = f sin/(1 + cos) = f tan(theta/2).
    focal = circle.radius_px / math.tan(math.radians(_RIM_DEG) / 2)
    return unified_sensor(width_px, height_px, 1.0, focal, circle.u, circle.v)


def find_board(cv2: Any, image: Grey8, board: Board, sensor: Sensor) -> Array | None:
    """The pixels `[rows * columns, 2]` of a board's inner corners, in the order of `board.points_m`; None without one.

    Of a chessboard nobody can tell which way round it is: the first corner may be any that a turn by 180°, or a mirror,
    leaves the board's squares in place.

    Parameters
    ----------
    image
        `[height, width]`.
    sensor
        Rough or calibrated.
    """
    whole = _detect(cv2, image, board)
    if whole is not None and _is_grid(whole, board):
        return refine(cv2, image, whole, board)
    for window in _windows(sensor):
        x, y = np.meshgrid(np.arange(window.size, dtype=np.float64), np.arange(window.size, dtype=np.float64))
        at = _pixels(sensor, window.directions(x, y))
        patch = cv2.remap(
            image, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR, borderValue=0
        )
        found = _detect(cv2, patch, board)
        if found is None:
            continue
        pixels = _pixels(sensor, window.directions(found[:, 0], found[:, 1]))
        if _is_grid(pixels, board) and _is_inside(pixels, image):
            return refine(cv2, image, pixels, board)
    return None


def _detect(cv2: Any, image: Grey8, board: Board) -> Array | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2) if found else None


def _pixels(sensor: Sensor, directions: Array) -> Array:
    """Where directions `[..., 3]` are seen, whatever the sensor's field is; far off the image where they are not."""
    out = np.empty((*directions.shape[:-1], 2))
    project_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), out.reshape(-1, 2))
    return np.nan_to_num(out, nan=-1e4)


def _windows(sensor: Sensor) -> Iterator[Window]:
    """Around the axis in steps of `_TURN_DEG`, at several angles off it, and one along it."""
    camera = sensor.camera
    u, v = camera.cx_px, camera.cy_px
    axis, right, down = unproject(sensor, [[u, v], [u + 1, v], [u, v + 1]])[0]
    right, down = (each - (each @ axis) * axis for each in (right, down))
    right = right / np.linalg.norm(right)
    down = down - (down @ right) * right
    down = down / np.linalg.norm(down)
    tangent = math.tan(math.radians(_WINDOW_DEG) / 2)
    for off_axis in (*_OFF_AXIS_DEG, 0.0):
        theta = math.radians(off_axis)
        for azimuth in np.radians(np.arange(0, 360 if off_axis else _TURN_DEG, _TURN_DEG)).tolist():
            outward = math.cos(azimuth) * right + math.sin(azimuth) * down
            across = -math.sin(azimuth) * right + math.cos(azimuth) * down
            ahead = math.cos(theta) * axis + math.sin(theta) * outward
            beyond = -math.sin(theta) * axis + math.cos(theta) * outward
            size = int(np.clip(2 * tangent * _pixels_per_radian(sensor, ahead), _LEAST_PX, _MOST_PX))
            yield Window(np.stack([across, beyond, ahead]), size, tangent)


def _pixels_per_radian(sensor: Sensor, direction: Array) -> float:
    """The finest scale of the image in a direction; a small one where it is not seen."""
    step = 1e-3
    sides = np.eye(3) - direction[:, None] * direction[None, :]
    at = _pixels(sensor, np.concatenate([direction[None], direction + step * sides]))
    moved = np.linalg.norm(at[1:] - at[0], axis=-1) / np.maximum(step * np.linalg.norm(sides, axis=-1), 1e-9)
    return float(np.max(moved))


def _is_inside(pixels: Array, image: Grey8) -> bool:
    height, width = image.shape
    return bool(((pixels > 1) & (pixels < [width - 2, height - 2])).all())


def _is_grid(pixels: Array, board: Board) -> bool:
    """Whether no square of the board is folded over, or narrower than three pixels."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    along, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    area = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    return bool((np.abs(np.sign(area).sum()) == area.size) and spacing(pixels, board) > 3)


def spacing(pixels: Array, board: Board) -> float:
    """The shortest distance between neighbouring corners, pixels."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    return float(min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)))


def refine(cv2: Any, image: Grey8, pixels: Array, board: Board) -> Array:
    """Corners to a fraction of a pixel: the points to which the gradients around them are at right angles.

    Each has a window of its own, so that no other corner is in it.
    """
    grid = pixels.reshape(board.rows, board.columns, 2)
    nearest = np.full((board.rows, board.columns), np.inf)
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        before = [(0, 0), (0, 0)]
        before[axis] = (1, 0)
        after = [(0, 0), (0, 0)]
        after[axis] = (0, 1)
        for side in (before, after):
            nearest = np.minimum(nearest, np.pad(length, side, constant_values=np.inf))
    half = np.clip(np.floor(0.45 * nearest), 2, 10).astype(int).ravel()
    out = pixels.copy()
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    for size in np.unique(half).tolist():
        own = half == size
        start = np.ascontiguousarray(pixels[own], dtype=np.float32).reshape(-1, 1, 2)
        out[own] = cv2.cornerSubPix(image, start, (size, size), (-1, -1), stop).reshape(-1, 2)
    moved = np.linalg.norm(out - pixels, axis=-1)
    return np.where((moved < np.maximum(0.3 * nearest.ravel(), 1.0))[:, None], out, pixels)
