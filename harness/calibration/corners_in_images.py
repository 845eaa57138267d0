"""Detection of boards in all images of one camera: first with a rough sensor, then with a calibrated one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from harness.calibration.circle import Circle, find_circle
from harness.calibration.corners import Board, Corners, corners_of
from harness.calibration.detect import Grey8, find_board, rough_sensor
from harness.calibration.sensor_calibration import calibrate_sensor
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.files import read_regular
from harness.geometry.angles import Array
from harness.images import LIMIT_BYTES, decode
from harness.opencv import opencv, threads

_ENOUGH = 3
"""Least number of boards from which a sensor is calibrated for the second pass."""
_LEAST_CORNERS = 3
"""Inner corners each way of the smallest board that OpenCV detects."""


@dataclass(frozen=True)
class Search:
    """The result of a search for boards."""

    corners: Corners
    circle: Circle | None
    without: tuple[str, ...]
    """Names of the images in which no board was detected."""


def find_corners(files: Sequence[Path], board: Board, tell: Callable[[str], None] = lambda _: None) -> Search:
    """Detect the corners of a board in images of one camera.

    Parameters
    ----------
    tell
        Called with a line for each image.

    Raises
    ------
    InputError
        When the board is too small to be detected, an image cannot be read or differs in size from the first, no image
        has a board, or OpenCV is not installed.
    """
    _check_detectable(board)
    cv2 = opencv("calibrate", "calibration")
    names = _names(files)
    images, circle = _read(files)
    height, width = images[0].shape
    sensor = rough_sensor(width, height, circle)
    corners_of_image: dict[int, Array] = {}
    with threads(cv2, 1):  # its own threads cost more than they gain on windows of this size
        for i, name in enumerate(names):
            _look(cv2, images, i, board, sensor, corners_of_image)
            tell(f"{name} ({i + 1} of {len(names)}): {_progress(corners_of_image, i, board)}")
        better = (
            _calibrated(corners_of_image, names, board, (width, height), circle)
            if len(corners_of_image) < len(names)
            else None
        )
        for i in (i for i in range(len(names)) if i not in corners_of_image and better is not None):
            assert better is not None
            _look(cv2, images, i, board, better, corners_of_image)
            tell(f"{names[i]}, second pass, calibrated from other images: {_progress(corners_of_image, i, board)}")
    if not corners_of_image:
        raise InputError(
            f"no board of {board.columns} x {board.rows} inner corners was found in any of {len(files)} images. Count "
            "the corners where four squares meet, not the squares; the whole board with a white margin must be in the "
            "image, sharp and evenly lit, its squares at least 10 pixels wide. Or give corners from elsewhere with "
            "--corners"
        )
    detections = [(names[i], board.points_m, corners_of_image[i]) for i in sorted(corners_of_image)]
    without = tuple(name for i, name in enumerate(names) if i not in corners_of_image)
    return Search(corners_of(detections, width, height), circle, without)


def _check_detectable(board: Board) -> None:
    """Refuse a board that OpenCV's detector has no pattern for: it needs three corners each way."""
    for key, count in (("columns", board.columns), ("rows", board.rows)):
        if count < _LEAST_CORNERS:
            problem = f"must be at least {_LEAST_CORNERS} to be found in images; found {count}"
            raise InputError(problem, file="board", key=key)


def _look(
    cv2: object, images: Sequence[Grey8], i: int, board: Board, sensor: Sensor, corners_of_image: dict[int, Array]
) -> None:
    pixels = find_board(cv2, images[i], board, sensor)
    if pixels is not None:
        corners_of_image[i] = pixels


def _progress(corners_of_image: dict[int, Array], i: int, board: Board) -> str:
    return f"{board.columns * board.rows} corners" if i in corners_of_image else "no board"


def _names(files: Sequence[Path]) -> list[str]:
    """The names of the files, with their folders if two are equal."""
    names = [each.name for each in files]
    return names if len(set(names)) == len(names) else [str(each) for each in files]


def _read(files: Sequence[Path]) -> tuple[list[Grey8], Circle | None]:
    """The images, and the image circle in their pixel-wise maximum."""
    images: list[Grey8] = []
    for file in files:
        grey = decode(read_regular(file, LIMIT_BYTES, "image"), file).grey()
        images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
        if images[-1].shape != images[0].shape:
            (rows, columns), (first_rows, first_columns) = images[-1].shape, images[0].shape
            raise InputError(
                f"has {columns} x {rows} pixels, the first image {first_columns} x {first_rows}: one camera must have "
                "taken all",
                file=file,
            )
    brightest = images[0].copy()
    for image in images[1:]:
        np.maximum(brightest, image, out=brightest)
    return images, find_circle(brightest)


def _calibrated(
    corners_of_image: dict[int, Array], names: Sequence[str], board: Board, size: tuple[int, int], circle: Circle | None
) -> Sensor | None:
    """A sensor calibrated from the boards detected so far; None if that fails."""
    if len(corners_of_image) < _ENOUGH:
        return None
    corners = corners_of([(names[i], board.points_m, corners_of_image[i]) for i in sorted(corners_of_image)], *size)
    try:
        return calibrate_sensor(corners, "unified", lens=(), circle=circle).sensor
    except InputError:
        return None
