"""Images made smaller by the mean of squares of pixels, and the sensors that would have taken them."""

import numpy as np
from numpy.typing import NDArray

from harness.camera.models.ocam import OCam
from harness.camera.sensor import Sensor, used


def binned_sensor(sensor: Sensor, side: int) -> Sensor:
    """The sensor whose pixels are squares of `side` x `side` of this one's; rows and columns that are left over at the
    right and below are dropped. It has no mask: `binned` leaves out masked pixels.
    """
    if side == 1:
        return sensor
    camera, model = sensor.camera, sensor.model
    middle = (side - 1) / 2
    smaller = {
        "width_px": camera.width_px // side,
        "height_px": camera.height_px // side,
        "focal_px": camera.focal_px / side,
        "skew_px": camera.skew_px / side,
        "cx_px": (camera.cx_px - middle) / side,
        "cy_px": (camera.cy_px - middle) / side,
    }
    if isinstance(model, OCam):
        # a_k is in pixels to the power of 1 - k
        coefficients = tuple(a * float(side) ** (k - 1) for k, a in enumerate(model.coefficients))
        model = model.model_copy(update={"coefficients": coefficients})
        smaller = {key: value for key, value in smaller.items() if key not in model.unused}
    return sensor.model_copy(update={"camera": camera.model_copy(update=smaller), "model": model, "mask": None})


def binned(values: NDArray[np.floating], sensor: Sensor, side: int) -> NDArray[np.float32]:
    """Means over squares `[height // side, width // side, ...]`; NaN where one of the pixels is masked or NaN."""
    usable = used(sensor)
    if usable is not None:
        values = np.where(usable if values.ndim == 2 else usable[..., None], values, np.nan)
    rows, columns = (size // side for size in values.shape[:2])
    squares = values[: rows * side, : columns * side].reshape(rows, side, columns, side, *values.shape[2:])
    return np.asarray(squares.mean(axis=(1, 3)), dtype=np.float32)
