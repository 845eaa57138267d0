"""The pixels of a panorama around which a whole window fits, and the pixels to search for."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.epipolar import Curves
from harness.geometry.panorama import Panorama
from harness.matching.interface import Reason


def window_centres(panorama: Panorama, window_px: int) -> NDArray[np.bool_]:
    """Pixels whose whole window is valid. The seam at phi = ±pi is no border; the first and last row are."""
    return whole_windows(panorama.valid, window_px)


def whole_windows(valid: NDArray[np.bool_], window_px: int) -> NDArray[np.bool_]:
    """Pixels of a mask `[height, width]` whose whole window is set; see `window_centres`."""
    half = window_px // 2
    if valid.all():
        whole = np.ones(valid.shape, dtype=bool)
    else:
        whole = np.ascontiguousarray(ndimage.minimum_filter(valid, size=window_px, mode=("nearest", "wrap")))
    if half:
        whole[:half] = False
        whole[-half:] = False
    return whole


def searchable(curves: Curves, own_windows: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.uint8]]:
    """The pixels to search for, and the `Reason` of the others (meant only there); both `[height, width]`."""
    reason = np.full(curves.grid.shape, Reason.NO_SAMPLE, dtype=np.uint8)
    reason[~curves.defined] = Reason.NO_EPIPOLAR_PLANE
    reason[~own_windows] = Reason.WINDOW_LEAVES_IMAGE
    return own_windows & curves.defined & (curves.k_last >= curves.k_first), reason
