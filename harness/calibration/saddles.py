"""Saddle points of grey levels: the corners of a chessboard, whether its edges are straight or not."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array

_SIGMA_PX = 1.5
_LEAST_STEP = 12.0
"""Least contrast between a board's squares, grey levels."""


def find_saddles(image: NDArray[np.uint8]) -> Array:
    """The saddle points of an image to the nearest pixel, `[n, 2]` as (u, v).

    Where four squares meet, smoothed by a Gaussian of standard deviation sigma, the mixed second derivative in the
    directions of the edges is `contrast/(pi sigma²)` and the others vanish: the square root of minus the Hessian's
    determinant gives the contrast for any orientation of the board.
    """
    levels = image.astype(np.float32)
    xx, xy, yy = (ndimage.gaussian_filter(levels, _SIGMA_PX, order=order) for order in ((0, 2), (1, 1), (2, 0)))
    strength = xy * xy - xx * yy
    least = (_LEAST_STEP / (np.pi * _SIGMA_PX**2)) ** 2
    peaks = (strength > least) & (strength == ndimage.maximum_filter(strength, size=5))
    v, u = np.nonzero(peaks)
    return np.stack([u, v], axis=-1).astype(np.float64)


def saddle_near(levels: Array, start: Array, half: int) -> Array:
    """The saddle point near a pixel (u, v); NaN without one."""
    height, width = levels.shape
    at = start.copy()
    for _ in range(10):
        u, v = (round(each) for each in at.tolist())
        if not (half <= u < width - half and half <= v < height - half):
            return np.full(2, np.nan)
        window = levels[v - half : v + half + 1, u - half : u + half + 1]
        y, x = np.mgrid[v - half : v + half + 1, u - half : u + half + 1]
        x, y = (x - at[0]).ravel(), (y - at[1]).ravel()
        weight = np.exp(-(x * x + y * y) / (0.5 * half * half))
        terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
        xx, xy, yy, gx, gy, _ = np.linalg.lstsq(terms * weight[:, None], window.ravel() * weight, rcond=None)[
            0
        ].tolist()
        determinant = 4 * xx * yy - xy * xy
        if not determinant < 0:  # a maximum or a minimum
            return np.full(2, np.nan)
        step = np.array([xy * gy - 2 * yy * gx, xy * gx - 2 * xx * gy]) / determinant
        at = at + np.clip(step, -1, 1)
        if np.abs(step).max() < 1e-4:
            break
    return at
