"""Images continued where nothing is known: black beyond what a sensor sees would ring into the picture through a
spline's prefilter, as would what a mask hides, and a grey level that is not a number would spread without end. And
across the seam of images that go round.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.sensor import Sensor, masked_pixels, pixel_directions

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
S = TypeVar("S", bound=np.generic)
Indices = tuple[NDArray[np.int32], NDArray[np.int32]]


def across_seam(values: NDArray[S], columns: int) -> NDArray[S]:
    """Values `[height, width, ...]` with the last columns once more before the first, and the first after the last.

    With no columns the array itself. How many there are to be for a sensor: `harness.camera.sensor.seam_px`.
    """
    return values if columns == 0 else np.concatenate([values[:, -columns:], values, values[:, :columns]], axis=1)


def nearest_known(known: NDArray[np.bool_]) -> Indices:
    """Row and column `[height, width]` of the nearest known pixel, for each pixel.

    `image[nearest_known(known)]` is the image with every other pixel set to the nearest known one.
    """
    if not known.any():
        here = np.indices(known.shape, dtype=np.int32)
        return here[0], here[1]
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return rows, columns


def without_gaps(image: Image, visible: Mask, hidden: Mask | None = None) -> tuple[Image, Mask]:
    """An image whose gaps, pixels that are not finite or hidden, are closed, and which pixels are known: seen, no gap.

    A gap gets the grey level of the nearest known pixel, so that filters and splines have something to go on; nothing
    may be concluded from it. An image without gaps is returned as it is, with `visible` itself.

    Parameters
    ----------
    hidden
        Pixels that show something else, and are not `visible` either.
    """
    finite = np.isfinite(image)
    if finite.all() and hidden is None:
        return image, visible
    known = visible & finite
    closed = np.where(finite if hidden is None else finite & ~hidden, image, image[nearest_known(known)])
    return np.where(np.isfinite(closed), closed, np.float32(0)), known


def closed_image(image: Image, sensor: Sensor, seam: int = 0) -> tuple[Image, Mask, Mask | None]:
    """A sensor's image without its gaps, as `without_gaps`; which pixels are known; and which were gaps, or None.

    A gap is a pixel of the field that is not finite, or that the sensor's mask hides.

    Parameters
    ----------
    seam
        How many columns all of them go on for across the image's seam; see `across_seam`.
    """
    visible, masked = across_seam(pixel_directions(sensor)[1], seam), masked_pixels(sensor)
    hidden = None if masked is None else across_seam(masked, seam)
    closed, known = without_gaps(across_seam(image, seam), visible, hidden)
    if known is visible:
        return closed, known, None
    gaps = visible & ~known
    return closed, known, gaps if hidden is None else gaps | hidden


def touches(gaps: Mask, coordinates: NDArray[np.float64], order: int) -> Mask:
    """Whether an interpolation of an order, 1 or 3, at `coordinates` (rows, columns) `[2, ...]` weighs a gap."""
    if order > 1:
        gaps = ndimage.maximum_filter(gaps, size=3)
    weight = ndimage.map_coordinates(gaps.astype(np.float32), coordinates, order=1, mode="nearest")
    return np.asarray(weight > 0)
