"""Filling the unknown pixels of an image before it is filtered or interpolated, and padding it across its seam.

A spline's prefilter has infinite support: a black surround, or the pixels that a mask hides, would ring into the
image, and a single NaN would spread over all of it. An image of 360 degrees is padded across its left and right border.
"""

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.sensor import Sensor, masked_pixels, pixels_seen

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
S = TypeVar("S", bound=np.generic)

_LARGEST_KEPT = 2**20
"""Pixels of the largest mask whose nearest pixels are kept; they take 8 bytes each."""
Indices = tuple[NDArray[np.int32], NDArray[np.int32]]


def across_seam(values: NDArray[S], columns: int) -> NDArray[S]:
    """Values `[height, width, ...]` padded left and right by `columns` columns from the opposite side.

    The array itself if `columns` is 0. `harness.camera.sensor.seam_px` gives the number that a sensor needs.
    """
    return values if columns == 0 else np.concatenate([values[:, -columns:], values, values[:, :columns]], axis=1)


def nearest_known(known: NDArray[np.bool_]) -> Indices:
    """Row and column `[height, width]` of the nearest known pixel, for each pixel.

    `image[nearest_known(known)]` is the image with every other pixel set to the nearest known one. Read-only: images of
    a sensor know the same pixels, for which this is worked out once.
    """
    work = _nearest if known.size > _LARGEST_KEPT else _nearest_kept
    return work(known.shape, np.packbits(known).tobytes())


def _nearest(shape: tuple[int, ...], known_bits: bytes) -> Indices:
    """See `nearest_known`; the mask is packed, since the key of a cache has to be hashable."""
    known = np.unpackbits(np.frombuffer(known_bits, np.uint8), count=math.prod(shape)).astype(bool).reshape(shape)
    if known.any():
        indices = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    else:
        indices = np.indices(shape, dtype=np.int32)
    indices.flags.writeable = False
    return indices[0], indices[1]


_nearest_kept = lru_cache(maxsize=8)(_nearest)


def last_known(values: NDArray[S], axis: int) -> NDArray[S]:
    """The last known value up to each place along an axis, 0 or 1, `[height, width]`; what is not finite where there is
    none before it.
    """
    place = np.arange(values.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    last = np.maximum.accumulate(np.where(np.isfinite(values), place, 0), axis=axis)
    return np.take_along_axis(values, last, axis)


def without_gaps(image: Image, visible: Mask, hidden: Mask | None = None) -> tuple[Image, Mask]:
    """An image with its gaps filled, and the mask of known pixels (visible and not a gap), both `[height, width]`.

    A gap is a pixel that is not finite or is hidden. It gets the grey level of the nearest known pixel, for the sake of
    filters and splines only: it carries no information. An image without gaps is returned unchanged, with `visible`.

    Parameters
    ----------
    hidden
        Masked pixels; they must not be `visible` either.
    """
    finite = np.isfinite(image)
    if finite.all() and hidden is None:
        return image, visible
    known = visible & finite
    closed = np.where(finite if hidden is None else finite & ~hidden, image, image[nearest_known(known)])
    return np.where(np.isfinite(closed), closed, np.float32(0)), known


def closed_image(image: Image, sensor: Sensor, seam: int = 0) -> tuple[Image, Mask, Mask | None]:
    """A sensor's image with its gaps filled as by `without_gaps`, the mask of known pixels, and that of gaps or None.

    A gap is a pixel of the field that is not finite, or that the sensor's mask hides.

    Parameters
    ----------
    seam
        Columns by which all three are padded across the image's seam; see `across_seam`.
    """
    visible, masked = across_seam(pixels_seen(sensor), seam), masked_pixels(sensor)
    hidden = None if masked is None else across_seam(masked, seam)
    closed, known = without_gaps(across_seam(image, seam), visible, hidden)
    if known is visible:
        return closed, known, None
    gaps = visible & ~known
    return closed, known, gaps if hidden is None else gaps | hidden


def touches(gaps: Mask, coordinates: NDArray[np.float64], order: int) -> Mask:
    """Whether a gap contributes to the interpolation at `coordinates` (rows, columns) `[2, ...]`; order 1 or 3."""
    if order > 1:
        gaps = ndimage.maximum_filter(gaps, size=3)
    weight = ndimage.map_coordinates(gaps.astype(np.float32), coordinates, order=1, mode="nearest")
    return np.asarray(weight > 0)
