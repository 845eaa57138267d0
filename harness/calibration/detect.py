"""Chessboard detection in images that bend straight lines.

OpenCV's detector needs squares that look like squares, as few do in the image of a mirror or a fisheye. So the image is
also resampled to perspective windows in many directions, with a rough sensor: a stereographic one, which preserves
angles, over the image circle, or one that was calibrated from other images. Corners detected in a window are mapped
back and refined in the original image.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.calibration.circle import Circle
from harness.calibration.corners import Board
from harness.calibration.saddles import find_saddles, saddle_near
from harness.calibration.start import unified_sensor
from harness.camera._projection_kernels import project_all
from harness.camera.sensor import Sensor, parameters_of, unproject
from harness.geometry.angles import Array

Grey8 = NDArray[np.uint8]

_RIM_DEG = 105.0
"""Angle off the axis that a rough sensor has at the image circle: between a fisheye's 90 and a mirror's 115."""
_WINDOW_DEG = 100.0
_TURN_DEG = 30.0
_OFF_AXIS_DEG = (40.0, 70.0, 95.0)
"""Angles off the axis of the windows' centres."""
_BEND = 0.5
"""Largest offset of a corner from the midpoint of its two neighbours, as a share of the distance to them."""
_MIDDLE = 0.9
"""Share of a window's width within which saddle points count."""
_SADDLES = 0.6
"""Share of a board's corners that must be saddle points: some may be blurred."""
_MOST_PX, _LEAST_PX = 1200, 480
"""Sides of a window, pixels."""


@dataclass(frozen=True)
class Window:
    """A perspective window of `size` x `size` pixels, centred on the last row of `axes`."""

    axes: Array
    """`[3, 3]`: rows are the directions right, down and forward, in the sensor's frame."""
    size: int
    tangent: float
    """Tangent of half its field of view."""

    def directions(self, x: Array, y: Array) -> Array:
        """Directions `[..., 3]` of its pixels, in the sensor's frame."""
        scale = 2 * self.tangent / (self.size - 1)
        middle = (self.size - 1) / 2
        local = np.stack([(x - middle) * scale, (y - middle) * scale, np.ones_like(x)], axis=-1)
        return np.asarray(local @ self.axes)


def rough_sensor(width_px: int, height_px: int, circle: Circle | None) -> Sensor:
    """A stereographic sensor over the image circle, or over the whole image without one."""
    if circle is None:
        circle = Circle((width_px - 1) / 2, (height_px - 1) / 2, min(width_px, height_px) / 2)
    # r = f sin/(1 + cos) = f tan(theta/2).
    focal = circle.radius_px / math.tan(math.radians(_RIM_DEG) / 2)
    return unified_sensor(width_px, height_px, 1.0, focal, circle.u, circle.v)


def find_board(cv2: Any, image: Grey8, board: Board, sensor: Sensor) -> Array | None:
    """The pixels `[rows * columns, 2]` of a board's inner corners, in the order of `board.points_m`; None without one.

    The order is ambiguous: a chessboard looks the same after a rotation by 180° or a reflection that maps its squares
    to squares of the same colour, and any such order may be returned.

    Parameters
    ----------
    image
        `[height, width]`.
    sensor
        Rough or calibrated.
    """
    saddles = find_saddles(image)
    if len(saddles) < _SADDLES * board.columns * board.rows:
        return None
    whole = _detect(cv2, image, board)
    if whole is not None and _is_grid(whole, board):
        return refine(image, whole, board)
    for window in _likely_windows(saddles, board, sensor):
        x, y = np.meshgrid(np.arange(window.size, dtype=np.float64), np.arange(window.size, dtype=np.float64))
        at = _pixels(sensor, window.directions(x, y)).astype(np.float32)
        corners = _detect(cv2, cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0), board)
        if corners is None:
            continue
        pixels = _pixels(sensor, window.directions(corners[:, 0], corners[:, 1]))
        if _is_grid(pixels, board) and _is_inside(pixels, image):
            return refine(image, pixels, board)
    return None


def _detect(cv2: Any, image: Grey8, board: Board) -> Array | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    success, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2) if success else None


def _pixels(sensor: Sensor, directions: Array) -> Array:
    """The pixels of directions `[..., 3]`, in the field or not; far off the image outside the model's domain."""
    out = np.empty((*directions.shape[:-1], 2))
    project_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), out.reshape(-1, 2))
    return np.nan_to_num(out, nan=-1e4)


def _likely_windows(saddles: Array, board: Board, sensor: Sensor) -> list[Window]:
    """The windows with enough saddle points for a board in their middle, those with the most first.

    The others are skipped because the detector is slowest where there is no board.
    """
    directions = unproject(sensor, saddles)[0]
    directions = directions[np.isfinite(directions).all(axis=-1)]
    counted = []
    for window in _windows(sensor):
        local = directions @ window.axes.T
        reach = _MIDDLE * window.tangent * local[:, 2]
        count = np.count_nonzero((np.abs(local[:, :2]) < reach[:, None]).all(axis=-1))
        if count >= _SADDLES * board.columns * board.rows:
            counted.append((count, window))
    return [window for _, window in sorted(counted, key=lambda each: -each[0])]


def _windows(sensor: Sensor) -> Iterator[Window]:
    """Windows around the axis in steps of `_TURN_DEG`, at several angles off it, and one along it."""
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
    """The finest scale of the image in a direction, pixels per radian; a small one outside the model's domain."""
    step = 1e-3
    sides = np.eye(3) - direction[:, None] * direction[None, :]
    at = _pixels(sensor, np.concatenate([direction[None], direction + step * sides]))
    moved = np.linalg.norm(at[1:] - at[0], axis=-1) / np.maximum(step * np.linalg.norm(sides, axis=-1), 1e-9)
    return float(np.max(moved))


def _is_inside(pixels: Array, image: Grey8) -> bool:
    height, width = image.shape
    return bool(((pixels > 1) & (pixels < [width - 2, height - 2])).all())


def _is_grid(pixels: Array, board: Board) -> bool:
    """Whether no square is inverted or below three pixels, and every corner is about midway between its neighbours."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    along, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    area = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    if np.abs(np.sign(area).sum()) < area.size or _nearest(pixels, board).min() <= 3:
        return False
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        longer = np.maximum(np.delete(step, 0, axis=axis), np.delete(step, -1, axis=axis))
        if (np.linalg.norm(np.diff(grid, n=2, axis=axis), axis=-1) > _BEND * longer).any():
            return False
    return True


def refine(image: Grey8, pixels: Array, board: Board) -> Array:
    """Corners refined to a fraction of a pixel: the saddle points of the grey levels around them, `[n, 2]`.

    A quadratic is fitted to the grey levels within a window, with the weights of a Gaussian of half its size, and the
    window is moved to where the gradient vanishes, until it stops moving. The size of the window is chosen for each
    corner so that it contains no other one. On exact corners of rendered mirror images the error is half that of
    `cv2.cornerSubPix`, which assumes straight edges.
    """
    levels = image.astype(np.float64)
    nearest = _nearest(pixels, board)
    half = np.clip(np.floor(0.3 * nearest), 2, 10).astype(int)
    out = np.array([saddle_near(levels, each, size) for each, size in zip(pixels, half.tolist(), strict=True)])
    moved = np.linalg.norm(out - pixels, axis=-1)
    return np.where((moved < np.maximum(0.3 * nearest, 1.0))[:, None], out, pixels)


def _nearest(pixels: Array, board: Board) -> Array:
    """The distance `[n]` from each corner to its nearest neighbour, pixels."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    nearest = np.full((board.rows, board.columns), np.inf)
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        for side in ((1, 0), (0, 1)):
            padding = [(0, 0), (0, 0)]
            padding[axis] = side
            nearest = np.minimum(nearest, np.pad(length, padding, constant_values=np.inf))
    return nearest.ravel()
