"""What the images' noise does to fits of tiles: it hides, adds to gradients, and is alike in neighbouring pixels."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.image_noise import noise_of
from harness.camera.sensor import Sensor, pixels_seen
from harness.camera.spline_noise import deviation_left, noise_after_blur
from harness.geometry.angles import Array
from harness.motion.tiles import Image

_LEAST_SIGNAL = 0.1
"""Least share of a tile's squared gradients, across, that is texture: with less, the noise is known too poorly."""
_REACH_PX = 4
"""Distance of pixels, along rows and columns, up to which residuals are taken to be correlated."""
_LEAST_PIXELS = 30
"""Pixels in which a tile's correlation is found, at least."""


class TileNoise(NamedTuple):
    """The standard deviation of both images' noise, grey levels, after smoothing."""

    of_1: float
    of_2: float
    blur_px: float = 0.0
    """Standard deviation of the Gaussian with which both images were smoothed, pixels."""

    @property
    def least_contrast(self) -> float:
        """Standard deviation of view 1's grey levels at which texture is as large as the noise: with less, tiles would
        often not look alike where they match.
        """
        return math.hypot(self.of_1, max(self.of_1, self.of_2))

    def smoothed(self, blur_px: float) -> "TileNoise":
        """That of images which are smoothed by a Gaussian, if it is white."""
        left = deviation_left(blur_px)
        return TileNoise(self.of_1 * left, self.of_2 * left, blur_px)

    def in_residuals(self, gain: Array) -> Array:
        """Variance `[n]` of I_1 - a I_2, which is interpolated."""
        value = noise_after_blur(self.blur_px)[0]
        return np.asarray(self.of_1**2 + (gain * value * self.of_2) ** 2)

    def of_2_in_residuals(self, gain: Array) -> Array:
        """The variance `[n]` of view 2's noise per variance of what the fits of tiles leave.

        That of the tile itself is white or not, while `of_2` misses most of a noise that neighbouring pixels share.
        """
        some = self if max(self.of_1, self.of_2) > 0 else self._replace(of_1=1.0, of_2=1.0)
        return np.asarray(some.of_2**2 / some.in_residuals(gain))

    def leave(self, H: Array, squares: Array, variance_2: Array | float) -> tuple[Array, Array, Array]:
        """Take the noise's part, which tells nothing, out of the information on the angle across, `H[:, 0, 0]`.

        Parameters
        ----------
        H
            `[n, 6, 6]`, normal equations; changed in place.
        squares
            `[n]`: the sum over the tile's pixels of the squared movement, pixels, of I_2 by the angle.
        variance_2
            Of view 2's noise, in all tiles or `[n]`.

        Returns
        -------
        H
            What is left; at least a tenth of the information, and positive definite.
        variance
            `[n]`, of the angle, per variance of the residual; infinite where less than a tenth is left.
        share
            `[n]`, of the texture in the information.
        """
        value, slope = noise_after_blur(self.blur_px)
        information = 1 / np.linalg.inv(H)[:, 0, 0]
        share = 1 - value * slope * variance_2 * squares / information
        signal = np.maximum(share, _LEAST_SIGNAL)
        H[:, 0, 0] -= (1 - signal) * information
        return H, np.where(share > _LEAST_SIGNAL, np.linalg.inv(H)[:, 0, 0] / signal, np.inf), share

    def correlation(self, sums: Array, gain: Array) -> Array:
        """The squared correlation `[n]` of both views without noise, from sums over pixels `[n, 4]`: their number, that
        of squared residuals, of I_1 and of I_1². Expected values of the noise's squares are subtracted.
        """
        pixels = np.maximum(sums[:, 0], 1.0)
        texture = sums[:, 3] - sums[:, 2] ** 2 / pixels - pixels * self.of_1**2
        unlike = sums[:, 1] - pixels * self.in_residuals(gain)
        return np.asarray(1 - unlike / np.maximum(texture, 1e-9))


def noise_in(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor]) -> TileNoise:
    """The noise of two images, measured where they have least texture."""
    return TileNoise(*(noise_of(image, pixels_seen(each)) for image, each in zip(images, sensors, strict=True)))


def by_correlation(parts: Array, residuals: Array) -> Array:
    """By how much the variance `[n]` of `sum(parts * residuals)` over each tile is larger than if neighbouring pixels
    were independent; at least 1.

    Noise that is alike in neighbouring pixels, as after smoothing, demosaicing, denoising, or compression, moves a tile
    of smooth texture up to three times as far as its residual says if pixels are taken to be independent. How alike is
    the median over all tiles, whose 289 pixels each say little, and which do not all show a plane.

    Parameters
    ----------
    parts, residuals
        `[n, side, side]`; 0 in pixels that do not count.
    """
    if not len(parts):
        return np.ones(0)
    near = ndimage.correlate(parts, autocorrelation(residuals)[None], mode="constant")
    squares = np.sum(parts**2, axis=(1, 2))
    return np.maximum(np.sum(parts * near, axis=(1, 2)) / np.maximum(squares, 1e-300), 1.0)


def autocorrelation(residuals: Array) -> NDArray[np.float64]:
    """The correlation `[9, 9]` of residuals `[n, side, side]` with those up to 4 pixels away: the median over tiles."""
    counted = (residuals != 0).astype(np.float64)
    size = 2 * _REACH_PX + 1
    correlation = np.zeros((size, size))
    correlation[_REACH_PX, _REACH_PX] = 1.0
    variance = np.sum(residuals**2, axis=(1, 2)) / np.maximum(np.sum(counted, axis=(1, 2)), 1.0)
    for down in range(_REACH_PX + 1):
        for right in range(-_REACH_PX, _REACH_PX + 1):
            if (down, right) <= (0, 0):
                continue
            product, pixels = (
                np.sum(_from(each, down, right) * _from(each, -down, -right), axis=(1, 2))
                for each in (residuals, counted)
            )
            enough = (pixels > _LEAST_PIXELS) & (variance > 0)
            alike = float(np.median(product[enough] / (pixels * variance)[enough])) if enough.any() else 0.0
            correlation[_REACH_PX + down, _REACH_PX + right] = alike
            correlation[_REACH_PX - down, _REACH_PX - right] = alike
    return correlation


def _from(values: Array, down: int, right: int) -> Array:
    """The part of tiles that a step down and to the right leads to from another pixel of the tile."""
    height, width = values.shape[1:]
    return values[:, max(down, 0) : height + min(down, 0), max(right, 0) : width + min(right, 0)]
