"""Reading and checking photographs from files or arrays."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from harness.camera.binning import binned
from harness.camera.fitting_panorama import fitting_grid
from harness.camera.sensor import Sensor, pixel_directions
from harness.camera.visible_rows import with_rows
from harness.display import brief
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion
from harness.images import Picture
from harness.pipeline.photographs import Photograph, read_photograph

Image = str | Path | NDArray[Any]
"""The path of an image file, or an array of grey levels `[height, width]` or colours `[height, width, 3]`."""


def photographs_of(
    left: Image, right: Image, sensors: tuple[Sensor, Sensor], bits: int | None
) -> tuple[Photograph, Photograph]:
    """Both views' photographs.

    Raises
    ------
    InputError
        Names the file or the argument and what would be right.
    """
    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray) and left.dtype != right.dtype:
        raise InputError(f"must be of one type; found {left.dtype} and {right.dtype}", key="left, right")
    return _photograph(left, sensors[0], "left", bits), _photograph(right, sensors[1], "right", bits)


def _photograph(image: Image, sensor: Sensor, name: str, bits: int | None) -> Photograph:
    """An image from a file, or from a checked array."""
    if isinstance(image, str | Path):
        option = "--sensor" if name == "left" else "--sensor-2"
        return read_photograph(Path(image), sensor, bits, option=option)
    if not isinstance(image, np.ndarray):
        raise InputError(f"must be a path or an array; found {type(image).__name__}", key=name)
    rows, columns = sensor.camera.height_px, sensor.camera.width_px
    if image.shape not in ((rows, columns), (rows, columns, 3)):
        raise InputError(
            f"must have the sensor's shape, ({rows}, {columns}) or ({rows}, {columns}, 3); found {image.shape}",
            key=name,
        )
    if image.dtype not in (np.uint8, np.uint16) and not np.issubdtype(image.dtype, np.floating):
        raise InputError(
            f"must be of type uint8, uint16, or floats of grey levels 0 .. 255; found {image.dtype}", key=name
        )
    white = 255.0 if image.dtype != np.uint16 else 65535.0 if bits is None else 2.0**bits - 1
    if not np.isfinite(image).all() or image.min() < 0 or image.max() > white:
        raise InputError(f"grey levels must be finite and lie within 0 .. {white:g}", key=name)
    if np.issubdtype(image.dtype, np.floating) and 0 < image.max() <= 1:
        raise InputError("grey levels must be 0 .. 255, but none is above 1; multiply by 255", key=name)
    picture = Picture(image, white, f"an array of {image.dtype}, white is {white:g}")
    grey_levels = picture.grey()
    grey_levels.flags.writeable = False
    return Photograph(Path(name), grey_levels, picture.colour(), picture.scale)


def side_of(scale: float, sensors: tuple[Sensor, Sensor]) -> int:
    """The number of pixels of an image, along each side, that become one pixel of the smaller image.

    Raises
    ------
    InputError
        When the scale is not the inverse of a whole number, or leaves fewer than 16 pixels.
    """
    if not 0 < scale <= 1 or abs(1 / scale - round(1 / scale)) > 0.05:
        raise InputError(
            f"must be 1, or one over a whole number, such as 0.5 or 0.25; found {brief(scale)}", key="scale"
        )
    side = round(1 / scale)
    shortest = min(min(each.camera.width_px, each.camera.height_px) for each in sensors)
    if shortest < 16 * side:
        raise InputError(f"leaves {shortest // side} pixels of {shortest}; must leave 16", key="scale")
    return side


def smaller(photograph: Photograph, sensor: Sensor, side: int) -> Photograph:
    """The photograph of means over squares of `side` x `side` pixels; grey is NaN where the sensor's mask hides one."""
    grey = binned(photograph.grey, sensor, side)
    grey.flags.writeable = False
    colour = binned(photograph.colour.astype(np.float32), sensor.model_copy(update={"mask": None}), side)
    levels = np.clip(np.rint(colour), 0, 255).astype(np.uint8)
    return replace(photograph, grey=grey, colour=levels)


def grid_of(grid: Grid | Literal["auto"] | None, sensors: tuple[Sensor, Sensor], motion: Motion) -> Grid:
    """The panorama, its rows in numbers.

    Raises
    ------
    InputError
        When it is to suit the sensors, and these see nothing in common.
    """
    try:
        if grid == "auto":
            if not all(pixel_directions(each)[1].any() for each in sensors):
                return Grid()  # the check of the sensors reports the error
            return fitting_grid(sensors, motion.R_v2_from_v1)
        if not isinstance(grid, Grid | None):
            raise InputError(f"must be a Grid, 'auto' or None; found {brief(grid)}", key="grid")
        return with_rows(grid or Grid(), sensors, motion.R_v2_from_v1)
    except ValueError as error:
        raise InputError(str(error), key="panorama") from error
