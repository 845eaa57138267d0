"""Arrays and tables from a data set's files, which may be anybody's: read within limits and without trust."""

import io
import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from harness.errors import InputError
from harness.files import read_regular
from harness.images import LIMIT_PX, luma

LIMIT_BYTES = 2**30
"""The largest file of a map or an image."""


def read_array(file: Path) -> NDArray[Any]:
    """The array in an NPY file, the only one in an NPZ file, or the levels of a PNG or TIFF file, as they stand there.

    Raises
    ------
    InputError
        When the file is missing, cut off or none of these.
    """
    data = read_regular(file, LIMIT_BYTES, "map")
    kind = file.suffix.lower()
    if kind in (".npy", ".npz"):
        return _of_numpy(data, file)
    if kind in (".png", ".tif", ".tiff"):
        return read_levels(data, file)
    raise InputError("is no map that can be read; give NPY, NPZ, PNG of 16 bits or TIFF", file=file)


def _of_numpy(data: bytes, file: Path) -> NDArray[Any]:
    try:
        loaded = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded
        names = loaded.files
        named = next((name for name in ("range_m", "range", "disparity", "arr_0") if name in names), None)
        if named is None and len(names) != 1:
            raise InputError(f"has the arrays {', '.join(names)}; name one of them range_m", file=file)
        return np.asarray(loaded[named or names[0]])
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError("cannot be read as an array of NumPy's; it may be cut off", file=file) from error


def read_levels(data: bytes, file: Path) -> NDArray[Any]:
    """The levels `[height, width]` or `[height, width, bands]` of an image's bytes, neither scaled nor turned.

    Raises
    ------
    InputError
        When it is no image, or is cut off.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=("PNG", "TIFF", "JPEG")) as image:
                if image.width * image.height <= LIMIT_PX:
                    return np.array(image)
    except Exception as error:  # Pillow's readers raise exceptions of any class
        raise InputError("cannot be read as an image; it may be cut off", file=file) from error
    raise InputError(f"has more than the {LIMIT_PX / 1e6:.0f} million pixels that are read", file=file)


def read_grey(file: Path) -> NDArray[np.float32]:
    """An image `[height, width]` in grey levels, as luma if it is in colour."""
    levels = read_levels(read_regular(file, LIMIT_BYTES, "image"), file).astype(np.float32)
    if levels.ndim == 2:
        return levels
    bands = levels[..., : min(levels.shape[2], 3)]
    return luma(bands.astype(np.float64)).astype(np.float32) if bands.shape[2] == 3 else bands[..., 0]


def read_json(file: Path) -> dict[str, Any]:
    """The table in a JSON file.

    Raises
    ------
    InputError
        When it is no table in JSON.
    """
    try:
        table = json.loads(read_regular(file, LIMIT_BYTES).decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"cannot be read as JSON: {error}", file=file) from error
    if not isinstance(table, dict):
        raise InputError("must be a table in JSON", file=file)
    return table


def known(values: NDArray[Any], invalid: float | None = None) -> NDArray[np.float64]:
    """Values as float64, with NaN where they equal the number that stands for nothing."""
    out = values.astype(np.float64)
    if invalid is not None:
        out[values == invalid] = np.nan
    return out


def numbers_of(table: dict[str, Any], key: str, shape: tuple[int, ...], file: Path) -> NDArray[np.float64]:
    """An array of a shape out of a table of a file.

    Raises
    ------
    InputError
        When the array is missing, or has another shape or a number that is not finite.
    """
    try:
        values = np.asarray(table[key], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        values = np.empty(0)
    if values.shape != shape or not np.isfinite(values).all():
        raise InputError(f"must be numbers, {' x '.join(map(str, shape)) or 'one'} of them", file=file, key=key)
    return values
