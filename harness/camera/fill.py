"""Images continued beyond what a sensor sees: black there would ring into the picture through a spline's prefilter."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Indices = tuple[NDArray[np.int32], NDArray[np.int32]]


def nearest_known(known: NDArray[np.bool_]) -> Indices:
    """Row and column `[height, width]` of the nearest known pixel, for each pixel.

    `image[nearest_known(known)]` is the image with every other pixel set to the nearest known one.
    """
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return rows, columns
