"""Noise of the camera: white, Gaussian, the same for all matchers."""

import hashlib

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, pixel_directions


def generator(seed: int, *purpose: str) -> np.random.Generator:
    """A random generator for one purpose: a hash of the seed and of the words that name it.

    Two purposes never share draws, and a purpose's draws depend on nothing else: not on the order of trials, on
    workers, or on settings that are not named.
    """
    words = "\0".join((str(seed), *purpose))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(words.encode()).digest()[:16], "little"))


def with_noise(
    image: NDArray[np.float32], sensor: Sensor, sigma_grey: float, draws: np.random.Generator
) -> NDArray[np.float32]:
    """A mirror image with white Gaussian noise on every pixel that the sensor sees.

    Neither clipped nor rounded: the noise stays Gaussian at both ends of the grey scale, as the bounds on
    accuracy assume.

    Parameters
    ----------
    image
        `[height, width]`, grey levels.
    sigma_grey
        Standard deviation in grey levels; 0 returns the image itself. Another sigma scales the same draws.
    """
    if sigma_grey == 0:
        return image
    unit = draws.standard_normal(image.shape, dtype=np.float32)
    noisy = np.where(pixel_directions(sensor)[1], image + np.float32(sigma_grey) * unit, image)
    noisy.flags.writeable = False
    return noisy
