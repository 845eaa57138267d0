"""A mask: which pixels of a sensor's image are used, and which show the robot's own body or what holds the mirror."""

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
    """An image file that says which pixels are used. Two of equal contents are equal, wherever they lie."""

    file: str
    """Path of an 8-bit grey image of the sensor's size, white where pixels are used; relative to the sensor's file."""
    sha256: str | None = None
    """Hash of the file's contents, hexadecimal. Worked out from the file where it is not given; where it is, contents
    of another hash are refused."""

    @model_validator(mode="before")
    @classmethod
    def _identified(cls, given: Any) -> Any:
        """Whoever builds a sensor says which contents are meant; whoever reads one back need not have the file."""
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
    """A path stands for the image that it names."""
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
            "is not the mask that it was when the sensor was read: its contents have changed; read the sensor again, "
            "and leave sha256 out",
            file=mask.file,
        )
    levels = decode(
        data, mask.file, size=(width_px, height_px), size_hint=f"the sensor that it masks {width_px}x{height_px}"
    ).levels
    if levels.dtype != np.uint8 or levels.ndim != 2:
        unsuitable = "colours" if levels.ndim != 2 else "more than 8 bits"
        raise InputError(
            f"a mask must be an 8-bit grey image, white where pixels are used; it has {unsuitable}", file=mask.file
        )
    used = levels >= USED_FROM
    used.flags.writeable = False
    return used
