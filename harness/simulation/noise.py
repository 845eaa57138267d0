"""Camera noise: white, Gaussian, and the same for all matchers."""

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

from harness.camera.models import Mirror
from harness.camera.reflection import seeing_pixels
from harness.camera.sensor import Sensor
from harness.spec import Spec


def generator(seed: int, *purpose: str) -> np.random.Generator:
    """A random generator for one purpose, seeded by a hash of the seed and of the words that name the purpose.

    Two purposes never share draws, and the draws of a purpose depend on nothing else: not on the order of trials,
    workers, or settings that are not named.
    """
    words = "\0".join((str(seed), *purpose))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(words.encode()).digest()[:16], "little"))


_NAMED = {
    "model": ("a_m", "b_m"),
    "camera": ("width_px", "height_px", "focal_px", "aspect", "cx_px", "cy_px"),
    "lens": ("k1", "k2", "p1", "p2", "k3"),
    "field": ("elevation_min_deg", "elevation_max_deg"),
}
"""The keys of a sensor that seed its noise: fixed, so that later keys with their defaults change no image."""


def words_of(sensor: Sensor) -> str:
    """The words that name a sensor among the purposes of `generator`.

    For sensors that earlier versions could describe the words, and so the draws, never change: newer keys are included
    only if they are not at their default, and the model has its original name.
    """
    words: dict[str, Any] = {}
    for name, part in sensor:
        if name == "mask":  # it hides pixels, and changes no others
            continue
        if not isinstance(part, Spec):
            if part != type(sensor).model_fields[name].default:
                words[name] = part
            continue
        table = part.model_dump(mode="json")
        always = _NAMED.get(name, ()) if name != "model" or isinstance(part, Mirror) else tuple(table)
        given = {
            key: value
            for key, value in table.items()
            if key in always or getattr(part, key) != type(part).model_fields[key].default
        }
        if given:
            words["mirror" if name == "model" else name] = given
    return to_json(words).decode()


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
    noisy = np.where(seeing_pixels(sensor), image + np.float32(sigma_grey) * unit, image)
    noisy.flags.writeable = False
    return noisy
