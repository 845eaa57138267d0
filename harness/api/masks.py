"""Masks of objects that move with the camera."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from harness.api.loading import load_sensor
from harness.api.photographs import Image, photographs_of
from harness.camera.sensor import Sensor, used
from harness.files import PICTURE_MARK, OwnFiles, write
from harness.geometry.pose import Motion
from harness.images import png_note
from harness.pipeline.static_pixels import static_pixels

OF_A_MASK = OwnFiles("mask of what moves with the camera", {"mask.png": None}, {"mask.png": PICTURE_MARK})
"""The mask that `omnirange range --mask auto` writes into its folder."""


def find_mask(
    left: Image,
    right: Image,
    sensor: str | Path | Mapping[str, Any] | Sensor,
    motion: Motion,
    *,
    d_min_m: float = 1.0,
    d_max_m: float = 10.0,
    bits: int | None = None,
) -> NDArray[np.bool_]:
    """Find the pixels that show objects which move with the camera, such as the robot itself, and leave them out.

    Parameters
    ----------
    left, right
        Two images of one sensor, as in `estimate_range`.
    motion
        From view 1 to view 2.
    d_min_m, d_max_m
        Between these ranges lies the scene.
    bits
        White is 2^bits - 1; see `estimate_range`.

    Returns
    -------
    array
        `[height, width]`, bool: the pixels in use, less those that the sensor's own mask hides.

    Raises
    ------
    InputError
        One line that names the argument or the file and what would be right.
    """
    loaded = load_sensor(sensor)
    first, second = photographs_of(left, right, (loaded, loaded), bits)
    static = static_pixels((first.grey, second.grey), (loaded, loaded), motion, d_min_m, d_max_m)
    own = used(loaded)
    return ~static if own is None else own & ~static


def write_mask(mask: NDArray[np.bool_], path: str | Path) -> None:
    """Write a mask as an 8-bit image, white where pixels are used, for `sensor.mask`.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    stream = io.BytesIO()
    Pillow.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(stream, format="PNG", pnginfo=png_note())
    write(Path(path), stream.getvalue())
