"""The image sensor, in terms of EMVA 1288: photons, electrons, grey levels."""

import io
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from pydantic import Field, model_validator

from harness.camera.reflection import seeing_pixels
from harness.camera.sensor import Sensor
from harness.geometry.angles import Array
from harness.spec import Spec

WHITE = 255.0
"""The grey level of a saturated pixel."""


class Chip(Spec):
    """The image sensor, by the linear model of EMVA 1288; by default an ideal one, which changes nothing.

    A rendered grey level stands for a mean number of photoelectrons, white (255) for `saturation_e`.
    """

    saturation_e: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """Saturation capacity, electrons at grey level 255; 0 for a chip without photon shot noise."""
    dark_noise_e: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Temporal dark noise (read noise), electrons, standard deviation; needs `saturation_e`."""
    bits: Annotated[int, Field(ge=0, le=16)] = 0
    """Bits of a grey level: values are clipped to 0 .. 255 and rounded to multiples of 255/(2^bits - 1); 0 for
    neither."""
    gamma: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """The grey level is 255 (light/255)^(1/gamma): 1 is linear, 2.2 is roughly what cameras store."""
    jpeg_quality: Annotated[int, Field(ge=0, le=100)] = 0
    """JPEG quality at which the image is stored, 1 to 100; 0 for no compression. Needs `bits = 8`."""

    @model_validator(mode="after")
    def _consistent(self) -> "Chip":
        if self.dark_noise_e and not self.saturation_e:
            raise ValueError("dark_noise_e needs saturation_e, which gives the electrons per grey level")
        if self.jpeg_quality and self.bits != 8:
            raise ValueError(f"jpeg_quality needs bits = 8, as JPEG has no other depth; found bits = {self.bits}")
        return self

    @property
    def is_ideal(self) -> bool:
        """Whether the chip leaves grey levels unchanged."""
        return self == Chip()

    @property
    def is_noisy(self) -> bool:
        """Whether the chip adds random noise."""
        return bool(self.saturation_e)

    @property
    def step_grey(self) -> float:
        """Distance of two grey levels after rounding; 0 where they are not rounded."""
        return WHITE / (2**self.bits - 1) if self.bits else 0.0


def captured(
    image: NDArray[np.float32],
    sensor: Sensor,
    chip: Chip,
    sigma_grey: float,
    shot: np.random.Generator,
    white: np.random.Generator,
) -> NDArray[np.float32]:
    """The image that a chip records: photons are counted, noise is added, and the result is encoded.

    Parameters
    ----------
    image
        `[sensor height, sensor width]`, grey levels in proportion to the light, or `[..., 3]`, colours. Each colour is
        counted, and its noise drawn, by itself; a JPEG is of all three.
    sigma_grey
        White Gaussian noise beside the chip's own, before gamma and rounding, grey levels.
    shot, white
        Draw the photoelectrons, and the Gaussian noise in units of its standard deviation.
    """
    if chip.is_ideal and not sigma_grey:
        return image
    light: Array = image.astype(np.float64)
    if chip.saturation_e:
        electrons = shot.poisson(np.clip(light, 0.0, None) * (chip.saturation_e / WHITE))
        light = np.asarray(electrons * (WHITE / chip.saturation_e))
    sigma = np.hypot(sigma_grey, _dark_noise_grey(chip))
    if sigma:
        light = light + sigma * white.standard_normal(image.shape, dtype=np.float32)
    known = seeing_pixels(sensor) if image.ndim == 2 else seeing_pixels(sensor)[..., None]
    grey = np.where(known, _rounded(_encoded(light, chip), chip), image)
    if chip.jpeg_quality:
        grey = np.where(known, _compressed(grey, chip.jpeg_quality), image)
    result = grey.astype(np.float32)
    result.flags.writeable = False
    return result


def expected_grey(light: NDArray[np.float32], chip: Chip) -> NDArray[np.float32]:
    """Grey levels of light without noise and before rounding; the light itself where the chip changes nothing."""
    return light if chip.is_ideal else _encoded(light.astype(np.float64), chip).astype(np.float32)


def _encoded(light: Array, chip: Chip) -> Array:
    if chip.bits or chip.gamma != 1:
        light = np.clip(light, 0.0, WHITE if chip.bits else None)
    return light if chip.gamma == 1 else WHITE * (light / WHITE) ** (1 / chip.gamma)


def grey_variance(light: NDArray[np.floating], chip: Chip, sigma_grey: float) -> Array:
    """Variance of each grey level, counted where it is stored: `sigma_y² = g'² (K² sigma_d² + K (y) + sigma²) + q²/12`.

    K is grey levels per electron, sigma_d the dark noise, sigma other white noise, g' the slope of the encoding, q the
    step of rounding (EMVA 1288, linear model, with the gamma after it). JPEG is not counted.

    Parameters
    ----------
    light
        `[height, width]`, grey levels in proportion to the light, without noise.
    """
    linear = np.clip(light.astype(np.float64), 0.0, None)
    variance = np.full(linear.shape, sigma_grey**2 + _dark_noise_grey(chip) ** 2)
    if chip.saturation_e:
        variance += linear * (WHITE / chip.saturation_e)
    if chip.gamma != 1:
        # The slope of a power below 1 is infinite in the dark; noise reaches over half a step there.
        share = np.maximum(linear, max(chip.step_grey / 2, 1e-3)) / WHITE
        variance *= (share ** (1 / chip.gamma - 1) / chip.gamma) ** 2
    return np.asarray(variance + chip.step_grey**2 / 12)


def _dark_noise_grey(chip: Chip) -> float:
    return chip.dark_noise_e * WHITE / chip.saturation_e if chip.dark_noise_e else 0.0


def _rounded(grey: Array, chip: Chip) -> Array:
    if not chip.bits:
        return grey
    return np.asarray(np.rint(np.clip(grey, 0.0, WHITE) / chip.step_grey) * chip.step_grey)


def _compressed(grey: Array, quality: int) -> Array:
    """Grey levels after JPEG compression and decompression at a quality 1 .. 100."""
    stream = io.BytesIO()
    Pictures.fromarray(np.rint(grey).astype(np.uint8)).save(stream, format="JPEG", quality=quality)
    return np.asarray(Pictures.open(stream), dtype=np.float64)
