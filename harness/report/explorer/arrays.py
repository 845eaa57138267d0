"""Maps as text inside a page: whole numbers, as differences along rows and columns, in planes of bytes, deflated.

Numbers are rounded to a stated step first, so that the page's values are known to that step. `scripts/arrays.js` reads
them back.
"""

import zlib
from base64 import b64encode
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.camera.fill import last_known

_LEVEL = 6
_LARGEST = 2**30
"""Whole numbers are within this, and so in 32 bits."""


@dataclass(frozen=True)
class Packed:
    """A map of whole numbers, `[rows, columns]`, as text."""

    rows: int
    columns: int
    planes: int
    """Bytes of a number."""
    text: str
    """Base64."""


def pack(values: ArrayLike) -> Packed:
    """Whole numbers `[rows, columns]` as text; larger ones than 2^30 become that.

    Each differs from the plane through the three pixels left of it and above by a number that is counted 0, -1, 1, -2,
    2 ..., so that small ones have no upper bytes. All is modulo 2^32.
    """
    numbers = np.clip(values, -_LARGEST, _LARGEST).astype(np.int32)
    step = np.diff(np.diff(numbers, axis=1, prepend=np.int32(0)), axis=0, prepend=np.int32(0))
    counted = ((step << 1) ^ (step >> 31)).view(np.uint32)
    planes = max(1, (int(counted.max(initial=0)).bit_length() + 7) // 8)
    data = counted.astype("<u4").reshape(-1, 1).view(np.uint8)[:, :planes]
    text = b64encode(zlib.compress(np.ascontiguousarray(data.T).tobytes(), _LEVEL)).decode()
    rows, columns = numbers.shape
    return Packed(rows, columns, planes, text)


def in_steps(values: NDArray[np.floating], step: float) -> NDArray[np.floating]:
    """Values as whole numbers of steps; a missing one repeats its predecessor in the row, which takes no space."""
    return np.rint(np.nan_to_num(last_known(values, 1), posinf=0.0, neginf=0.0) / step)


def on_scale(values: NDArray[np.floating], unit: float, octave: int) -> NDArray[np.floating]:
    """Positive values on a scale of so many steps in each factor of two, 1 at `unit` and below; 0 for none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = np.rint(octave * np.log2(values / unit)) + 1
    return np.where(np.isfinite(values), np.maximum(np.nan_to_num(steps), 1), 0)
