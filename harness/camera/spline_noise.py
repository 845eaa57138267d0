"""What interpolation leaves of an image's noise."""

from functools import lru_cache

import numpy as np
from scipy import ndimage


@lru_cache(maxsize=64)
def noise_through_spline(kernel: tuple[float, ...] = (1.0,)) -> tuple[float, float]:
    """Variance, along one axis, of unit-variance noise after cubic B-spline interpolation, and of its slope; means.

    The integrals over w of G² H² and of (w G H)², divided by that of G² from -pi to pi: H = 3 sinc(w/2)^4/(2 + cos w)
    is the frequency response of the spline, G that of the smoothing of noise that was white before.

    Parameters
    ----------
    kernel
        Weights of that smoothing along the axis, which is symmetric: of the pixel itself, of the next, and so on.
    """
    w = (np.arange(200_000) + 0.5) * (8 * np.pi / 200_000)  # beyond, H² is below 1e-8
    G = kernel[0] + 2 * sum((weight * np.cos(j * w) for j, weight in enumerate(kernel[1:], 1)), np.zeros(w.shape))
    H = 3 * np.sinc(w / (2 * np.pi)) ** 4 / (2 + np.cos(w))
    whole = np.sum(G[w < np.pi] ** 2)
    return float(np.sum((G * H) ** 2) / whole), float(np.sum((w * G * H) ** 2) / whole)


@lru_cache(maxsize=4)
def noise_after_blur(blur_px: float) -> tuple[float, float]:
    """`noise_through_spline` of noise that was smoothed by a Gaussian."""
    return noise_through_spline(_gaussian(blur_px))


def deviation_left(blur_px: float) -> float:
    """Standard deviation of white noise that was smoothed by a Gaussian along both axes, as a share of what it was."""
    middle, *beside = _gaussian(blur_px)
    return middle**2 + 2 * sum(each**2 for each in beside)


def _gaussian(blur_px: float) -> tuple[float, ...]:
    """Weights of a Gaussian along one axis, from its middle on; a single one without smoothing."""
    point = np.zeros(33)
    point[16] = 1.0
    kernel = ndimage.gaussian_filter1d(point, blur_px) if blur_px else point
    return tuple(kernel[16:].tolist())
