"""Gradients and aliasing of a texture in an image, as functions of a pixel's footprint on it."""

from functools import lru_cache

import numpy as np

from harness.geometry.angles import Array
from harness.simulation.texture import Texture, texels_of

_SIZES_M = np.geomspace(1e-5, 1e2, 281)
"""Sides of pixels on the surface, 40 a decade, between which is interpolated."""


def gradient_grey(texture: Texture, footprint_m: Array) -> Array:
    """RMS change of the grey level along one direction, grey levels per pixel, `[...]`.

    From the texture's spectrum: each wave below the pixels' Nyquist frequency counts with its slope, and with what the
    mean over a square pixel leaves of it.

    Parameters
    ----------
    footprint_m
        `[...]`: side of a pixel on the surface, metres.
    """
    return _interpolated(footprint_m, _spectrum(texture)[0])


def aliased_grey(texture: Texture, footprint_m: Array) -> Array:
    """RMS grey level of all waves beyond the pixels' Nyquist frequency, `[...]`.

    Two views show them differently, so that they are noise to a matcher which no draw changes.

    Parameters
    ----------
    footprint_m
        `[...]`: the longer side of a pixel on the surface, metres.
    """
    return _interpolated(footprint_m, _spectrum(texture)[1])


def _interpolated(footprint_m: Array, values: Array) -> Array:
    return np.exp(np.interp(np.log(footprint_m), np.log(_SIZES_M), np.log(np.maximum(values, 1e-9))))


@lru_cache(maxsize=16)
def _spectrum(texture: Texture) -> tuple[Array, Array]:
    texels = np.asarray(texels_of(texture), dtype=np.float64)
    height, width = texels.shape
    pitch_m = texture.tile_m / width
    power = np.abs(np.fft.fft2(texels - texels.mean())) ** 2 / texels.size**2
    f_y, f_x = (np.abs(np.fft.fftfreq(n, pitch_m)) for n in (height, width))
    of_slopes = power * f_x**2 + power * f_y[:, None] ** 2
    gradients, aliased = [], []
    for size_m in _SIZES_M:
        mean_x, mean_y = (np.sinc(f * size_m) ** 2 for f in (f_x, f_y))
        below_x, below_y = (np.where(f < 0.5 / size_m, mean, 0.0) for f, mean in ((f_x, mean_x), (f_y, mean_y)))
        slopes = below_y @ of_slopes @ below_x / 2
        gradients.append(2 * np.pi * size_m * np.sqrt(slopes))
        aliased.append(np.sqrt(max(mean_y @ power @ mean_x - below_y @ power @ below_x, 0.0)))
    return np.array(gradients), np.array(aliased)
