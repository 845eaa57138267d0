"""Reading and checking photographs from files or arrays."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor
from harness.errors import InputError
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
