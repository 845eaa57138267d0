"""A different exposure of the second camera, to which a matcher should be insensitive."""

import numpy as np
from numpy.typing import NDArray

from harness.camera.reflection import seeing_pixels
from harness.camera.sensor import Sensor


def with_exposure(image: NDArray[np.float32], sensor: Sensor, gain: float, offset_grey: float) -> NDArray[np.float32]:
    """`gain image + offset`, grey levels, where the sensor sees; neither clipped nor rounded, as noise is not."""
    if gain == 1 and offset_grey == 0:
        return image
    valid = seeing_pixels(sensor) if image.ndim == 2 else seeing_pixels(sensor)[..., None]
    changed = np.where(valid, np.float32(gain) * image + np.float32(offset_grey), image)
    changed.flags.writeable = False
    return changed
