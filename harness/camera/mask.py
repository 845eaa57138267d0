"""A mask: which pixels of a sensor's image are used, and which show the robot itself or the mirror's support."""

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, model_validator

from harness.errors import InputError
from harness.files import path_of, read_regular
from harness.images import LIMIT_BYTES, decode
from harness.spec import Spec

USED_FROM = 128
"""The least grey level of a pixel that is used: soft edges and lossy compression leave levels in between."""


class MaskImage(Spec):
    """An image file that marks the pixels in use. Two masks of equal contents are equal, wherever the files are."""

    file: str
    """Path of an 8-bit grey image of the sensor's size, white where pixels are used; relative to the sensor's file."""
    sha256: str | None = None
    """SHA-256 of the file's contents, hexadecimal. Computed from the file if not given; if given, a file with another
    hash is refused."""

    @model_validator(mode="before")
    @classmethod
    def _identified(cls, given: Any) -> Any:
        """Adds the absolute path and the hash. A sensor that is read back has both, and does not need the file."""
        if isinstance(given, Mapping) and isinstance(given.get("file"), str) and not given.get("sha256"):
            try:
                path = path_of(given["file"]).absolute()
                data = read_regular(path, LIMIT_BYTES, "image")
            except InputError as error:
                raise ValueError(f"'{given['file']}': {error.problem}") from error
            return {**given, "file": str(path), "sha256": hashlib.sha256(data).hexdigest()}
        return given

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MaskImage) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        return hash(self.sha256)


def _named(given: Any) -> Any:
    """A path as the table that names it."""
    if isinstance(given, str):
        return {"file": given}
    if given is None or isinstance(given, Mapping | MaskImage):
        return given
    raise ValueError(f"must be the path of an image, in quotes; found {given!r}")


Mask = Annotated[MaskImage | None, BeforeValidator(_named)]
"""A mask, given as the path of an image or a table with `file`; None for a sensor whose pixels are all used."""


@lru_cache(maxsize=8)
def used_pixels(mask: MaskImage, width_px: int, height_px: int) -> NDArray[np.bool_]:
    """`[height, width]`: the pixels that are used; read-only.

    Raises
    ------
    InputError
        When the file cannot be read, has changed since the mask was named, is no 8-bit grey image, or has another size.
    """
    data = read_regular(mask.file, LIMIT_BYTES, "image")
    if hashlib.sha256(data).hexdigest() != mask.sha256:
        raise InputError(
            "has changed since the sensor was read; read the sensor again, and leave sha256 out",
            file=mask.file,
        )
    levels = decode(
        data, mask.file, size=(width_px, height_px), size_hint=f"the masked sensor {width_px}x{height_px}"
    ).levels
    if levels.dtype != np.uint8 or levels.ndim != 2:
        unsuitable = "colours" if levels.ndim != 2 else "more than 8 bits"
        raise InputError(
            f"a mask must be an 8-bit grey image, white where pixels are used; this one has {unsuitable}",
            file=mask.file,
        )
    used = levels >= USED_FROM
    used.flags.writeable = False
    return used
