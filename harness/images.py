"""Image files as grey levels 0 .. 255: the one reader of photographs, of textures, and of the images inside meshes.

The level that becomes 255, *white*, follows from the type of the file (255 for 8 bits, 65535 for 16 bits, 1 for
floating point) or is given. The contents never decide: a dark image stays dark, two views are scaled alike.
Colours become luma (ITU-R BT.601, 0.299 R + 0.587 G + 0.114 B, as in Pillow and OpenCV). The orientation that a camera
writes into its file (EXIF) is applied. Transparency is ignored.
"""

import ctypes
import io
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, _imaging
from PIL.PngImagePlugin import PngInfo

from harness.display import OneLine
from harness.errors import InputError

FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM", "JPEG2000", "GIF")
"""The formats of Pillow that are opened; some of its others start programs."""
LIMIT_BYTES = 2**29
"""The largest image file that is read."""
LIMIT_PX = 2**26
"""The largest number of pixels that is decoded, 8192 x 8192."""

_DIM = 1 / 8
"""A share of white: where no level reaches it, three bits or more may hold nothing, as in a file of 12 bits in 16."""

Weights = tuple[float, float, float]
"""Weights of red, green and blue in a band of an image."""
LUMA: Weights = (0.299, 0.587, 0.114)
"""Weights of the grey band, the luma."""
COLOURS: tuple[Weights, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Red, green and blue."""
_BLOCK_ROWS = 256
"""Rows that are converted at a time, so that a large image needs no second copy in double precision."""
_BITS_PER_SAMPLE = 258
"""A tag of TIFF."""
_QUIET = threading.Lock()


@dataclass(frozen=True, repr=False)
class Picture(OneLine):
    """An image file's pixels."""

    levels: NDArray[Any]
    """The levels in the file: `[height, width]`, or `[height, width, 3]` red, green, blue."""
    white: float
    """The level that is shown as 255."""
    scale: str
    """The conversion of levels to grey, and whether it follows from the file's type or the user's choice; in words."""

    def grey(
        self, factor: tuple[float, float, float] = (1.0, 1.0, 1.0), *, linear: bool = False, weights: Weights = LUMA
    ) -> NDArray[np.float32]:
        """Luma `[height, width]`, 0 .. 255, or another band.

        Parameters
        ----------
        factor
            What red, green and blue are multiplied by first.
        linear
            Multiply amounts of light rather than levels: the levels are taken as sRGB (IEC 61966-2-1).
        weights
            Of red, green and blue. Those of one colour alone give its own levels.
        """
        plain = factor == (1.0, 1.0, 1.0)
        grey = np.empty(self.levels.shape[:2], dtype=np.float32)
        for start in range(0, len(grey), _BLOCK_ROWS):
            rows = slice(start, start + _BLOCK_ROWS)
            levels = self.levels[rows].astype(np.float64) * (255 / self.white)
            if not plain:
                levels = tinted(levels if levels.ndim == 3 else levels[..., None], factor, linear=linear)
            grey[rows] = levels @ np.array(weights) if levels.ndim == 3 else levels
        return grey

    def colour(self) -> NDArray[np.uint8]:
        """Red, green and blue `[height, width, 3]`, rounded to 8 bits."""
        levels = self.levels
        if levels.dtype != np.uint8 or self.white != 255:
            levels = np.rint(levels * (255 / self.white)).astype(np.uint8)
        return np.asarray(levels if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=-1), dtype=np.uint8)


def tinted(
    levels: NDArray[np.float64], factor: tuple[float, float, float], *, linear: bool = False
) -> NDArray[np.float64]:
    """Levels 0 .. 255 of red, green and blue `[..., 3]`, or of grey `[..., 1]`, times a factor; see `Picture.grey`."""
    if not linear:
        return np.asarray(levels * factor)
    share = levels / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4) * factor
    return np.asarray(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def luma(levels: NDArray[np.float64], weights: Weights = LUMA) -> NDArray[np.float64]:
    """Luma `[...]` of red, green and blue `[..., 3]`, or another band."""
    return np.asarray(levels @ np.array(weights))


def decode(
    data: bytes,
    file: str | Path,
    *,
    white: float | None = None,
    key: str = "white",
    size: tuple[int, int] | None = None,
    size_hint: str = "",
) -> Picture:
    """The picture in an image file's bytes.

    Parameters
    ----------
    file
        Where the bytes come from, for messages.
    white
        The level that becomes 255; the file's type decides when None.
    key
        What `white` is called where the user gives it, for messages.
    size
        Width and height that the image must have, pixels.
    size_hint
        What to do when it has another size, for messages.

    Raises
    ------
    InputError
        When it is no image, is too large, has another size, or has levels that are not within 0 .. white.
    """
    with _opened(data, file) as image:
        width, height = image.size
        if width * height > LIMIT_PX:
            raise InputError(
                f"has {width} x {height} pixels; at most {LIMIT_PX / 1e6:.0f} million are read: make it smaller",
                file=file,
            )
        most, kind = _type_of(image, file)
        if white is not None and image.format == "PPM":
            raise InputError(f"states which level is white; leave {key} out", file=file)
        if image.format != "TIFF" and _turned(image):  # of a TIFF, Pillow has swapped them; of a PNG it decodes here
            width, height = height, width
        if size is not None and (width, height) != size:
            raise InputError(f"the image is {width}x{height} pixels, {size_hint}", file=file)
        image.load()
        upright = ImageOps.exif_transpose(image)
        levels = np.array(upright if upright.mode in _GREY_MODES else upright.convert("RGB"))
    if levels.shape[:2] != (height, width) or not levels.size:
        raise InputError("cannot be read as an image; it has no pixels", file=file)
    if levels.dtype == np.bool_:
        levels = levels.astype(np.uint8) * np.uint8(255)
    return _scaled(levels, most, kind, white, file=file, key=key)


_GREY_MODES = ("1", "L", "I", "F", "I;16", "I;16L", "I;16B", "I;16N")


def _scaled(
    levels: NDArray[Any], most: float | None, kind: str, white: float | None, *, file: str | Path, key: str
) -> Picture:
    """The picture with its white decided and its levels checked."""
    if white is None and most is None:
        raise InputError(f"has {kind}, which do not state what is white; give {key}", file=file)
    chosen = white if white is not None else most
    assert chosen is not None
    if white is not None and most is not None and levels.dtype.kind != "f" and white > most:
        raise InputError(f"has {kind}, so that no level reaches {key} ({white:g}); at most {most:g}", file=file)
    low, high = float(levels.min()), float(levels.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError("has levels that are not finite numbers; repair the image", file=file)
    if low < 0 or high > chosen:
        raise InputError(
            f"has levels {low:g} .. {high:g}, outside 0 .. {chosen:g}; {key} says which level is white", file=file
        )
    origin = f"as {key} says" if white is not None else "by the file's type"
    if white is None and levels.dtype.kind != "f" and chosen > 255 and high <= _DIM * chosen:
        origin += f"; no level is above {high:g}: if white is less than {chosen:g}, give {key}"
    return Picture(levels, float(chosen), f"{kind}, white is {chosen:g} ({origin})")


def _type_of(image: Image.Image, file: str | Path) -> tuple[float | None, str]:
    """The largest level that the file's type holds (None if it says nothing of white), and its name for people."""
    raw = "".join(str(each) for tile in getattr(image, "tile", ()) for each in tile[3:])
    if image.mode.startswith("I;16"):
        bits = 16
        if image.format == "TIFF":
            tag = getattr(image, "tag_v2", {}).get(_BITS_PER_SAMPLE, (16,))
            bits = int(tag[0] if isinstance(tag, tuple) else tag)
        return float(2**bits - 1), f"{bits} bits"
    if image.mode == "I":
        # Pillow brings a PGM to 16 bits by the maximum that the file itself declares.
        return (65535.0, "16 bits") if image.format == "PPM" else (None, "whole numbers of 32 bits")
    if image.mode == "F":
        return 1.0, "floating point"
    if ";16" in raw:
        raise InputError("has 16 bits a colour, which are not read; save it as 16-bit grey or 8-bit colour", file=file)
    return 255.0, "8 bits"


def _turned(image: Image.Image) -> bool:
    """Whether the orientation in the file swaps width and height."""
    return image.getexif().get(0x0112, 1) in {5, 6, 7, 8}


@cache
def _silence_libtiff() -> None:
    """Keep libtiff from writing about damaged files to stderr: this program reports the error, once.

    Pillow has no setting for it. Where its library cannot be reached, as on Windows, libtiff keeps printing.
    """
    with suppress(OSError, AttributeError):
        # Symbols are looked up in the libraries that this one needs, too.
        libtiff = ctypes.CDLL(_imaging.__file__)
        for kind in ("Error", "Warning"):
            function = libtiff[f"TIFFSet{kind}Handler"]
            function.argtypes, function.restype = [ctypes.c_void_p], ctypes.c_void_p
            function(None)


@contextmanager
def _opened(data: bytes, file: str | Path) -> Iterator[Image.Image]:
    """A Pillow image whose failures, then and later, are the user's to mend. It prints no warnings."""
    names = "PNG, JPEG or TIFF"
    _silence_libtiff()
    try:
        with _QUIET, warnings.catch_warnings():  # a filter belongs to the whole process: one thread at a time
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                yield image
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"has more than the {LIMIT_PX / 1e6:.0f} million pixels that are read", file=file) from error
    except Exception as error:  # Pillow's readers raise exceptions of any class
        raise InputError(f"cannot be read as an image; give a {names} file", file=file) from error


def png_note() -> PngInfo:
    """What says in a PNG file that this program wrote it, `harness.files.PICTURE_MARK`, for Pillow's `pnginfo`."""
    note = PngInfo()
    note.add_text("Software", "omnirange")
    return note
