"""Pixels that show objects which move with the camera: its own robot, arm or holder.

They look the same at the same place of both images, where everything else has moved. Only what surely is so counts: a
window with contrast that correlates with itself, where no point of the scene within the limits of the search would have
stayed. A plain black arm is not found, since it has no match either, nor is what lies in the direction of t.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.sensor import Sensor, pixel_directions, project
from harness.geometry.angles import Array
from harness.geometry.pose import Motion

WINDOW_PX = 11
LEAST_CORRELATION = 0.9
LEAST_CONTRAST = 3.0
"""Standard deviation of a window's grey levels: far above the noise of a photograph."""
LEAST_MOVED_PX = 3.0
"""Least shift, pixels, of any point of the scene on the image for a pixel to be judged."""
_RANGES = 6
_BODY_PX = 9
_BODY_SHARE = 1 / 60
"""Side of the smallest thing that is found: that many pixels, and this share of the image's height."""
_AROUND_PX = 9
"""Pixels by which the regions found are widened: half a window, and soft edges."""

Image = NDArray[np.float32]


def static_pixels(
    images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], motion: Motion, d_min_m: float, d_max_m: float
) -> NDArray[np.bool_]:
    """Pixels `[height, width]` of both images that show objects which move with the camera.

    Parameters
    ----------
    d_min_m, d_max_m
        Between these ranges lies the scene.

    Raises
    ------
    ValueError
        When the images differ in size.
    """
    if images[0].shape != images[1].shape:
        raise ValueError("both images must have the same size")
    similar = _are_similar(images) & _would_move(sensors, motion, d_min_m, d_max_m)
    side = max(_BODY_PX, round(_BODY_SHARE * images[0].shape[0]))
    body = ndimage.binary_opening(similar, np.ones((side, side), bool))
    reach = np.hypot(*np.indices((2 * _AROUND_PX + 1,) * 2) - _AROUND_PX) <= _AROUND_PX
    return np.asarray(ndimage.binary_dilation(body, reach)) if body.any() else body


def _are_similar(images: tuple[Image, Image]) -> NDArray[np.bool_]:
    """Whether the windows about pixels correlate at the same place of both images, and have contrast."""
    first, second = (each.astype(np.float64) for each in images)
    finite = np.isfinite(first) & np.isfinite(second)
    first, second = np.where(finite, first, 0.0), np.where(finite, second, 0.0)

    def mean(values: Array) -> Array:
        return np.asarray(ndimage.uniform_filter(values, WINDOW_PX))

    m_1, m_2 = mean(first), mean(second)
    v_1, v_2, v_12 = mean(first**2) - m_1**2, mean(second**2) - m_2**2, mean(first * second) - m_1 * m_2
    contrast = np.minimum(v_1, v_2) > LEAST_CONTRAST**2
    whole = ndimage.uniform_filter(finite.astype(np.float64), WINDOW_PX) > 1 - 1e-9
    return np.asarray(contrast & whole & (v_12 > LEAST_CORRELATION * np.sqrt(np.maximum(v_1 * v_2, 0.0))))


def _would_move(sensors: tuple[Sensor, Sensor], motion: Motion, d_min_m: float, d_max_m: float) -> NDArray[np.bool_]:
    """Whether every point of the scene that a pixel of view 1 may show is elsewhere on view 2's image."""
    x, valid = pixel_directions(sensors[0])
    rows, columns = np.nonzero(valid)
    least = np.full(rows.size, np.inf)
    for d in np.geomspace(d_min_m, d_max_m, _RANGES):
        pixels, _ = project(sensors[1], motion.apply(d * x[rows, columns]))
        with np.errstate(invalid="ignore"):
            least = np.fmin(least, np.hypot(pixels[:, 0] - columns, pixels[:, 1] - rows))
    moves = np.zeros(valid.shape, dtype=bool)
    moves[rows, columns] = least >= LEAST_MOVED_PX
    return moves
