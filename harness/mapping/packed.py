"""States of cells as a short text: rows are stored as JSON."""

import base64
import zlib

import numpy as np
from numpy.typing import NDArray


def packed(state: NDArray[np.uint8]) -> str:
    """The states, row by row, compressed, in base64."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(state).tobytes(), 9)).decode()


def unpacked(text: str, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """The states `[rows, columns]` that `packed` made a text of."""
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8).reshape(shape)
