"""Effects of a real lens on the image before the chip: vignetting, defocus and motion blur."""

import math
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import fft, ndimage

from harness.camera.fill import across_seam, nearest_known
from harness.camera.reflection import seeing_pixels
from harness.camera.sensor import Sensor, seam_px
from harness.geometry.angles import Array
from harness.spec import Finite, Spec

Image = NDArray[np.float32]

_LEVELS = 12
"""Gaussians between which a defocus that grows towards the edge is mixed."""
_REACH = 4.0
"""Reach of the Gaussians, standard deviations: 6e-5 of their sum lies beyond."""


class Optics(Spec):
    """A lens that is not ideal. Blur is a kernel on the mirror image, on top of the pixels' own footprint."""

    vignetting: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the light that is lost at the pixel in use farthest from the principal point; it grows with the squared
    distance."""
    defocus_px: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Standard deviation of the Gaussian point spread function at the principal point, pixels of the mirror image."""
    defocus_edge_px: Annotated[float, Field(ge=0, le=50)] | None = None
    """Standard deviation of the Gaussian at the pixel in use farthest from the principal point, pixels; in between, the
    variance changes with the squared distance. By default `defocus_px` all over the image."""
    motion_px: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Length of the path that the image moves along during the exposure, pixels."""
    motion_deg: Finite = 0.0
    """Direction of that path in the image, degrees from u towards v."""

    @property
    def is_ideal(self) -> bool:
        """Whether the image stays unchanged."""
        return not (self.vignetting or self.defocus_px or self.defocus_edge_px or self.motion_px)


def with_optics(image: Image, sensor: Sensor, optics: Optics) -> Image:
    """The image through a lens.

    Beyond the field the image is continued by the nearest pixel inside, so that the black there does not bleed in.

    Parameters
    ----------
    image
        `[sensor height, sensor width]`, grey levels, or `[..., 3]`: each colour through the same lens.
    """
    if optics.is_ideal:
        return image
    if image.ndim == 3:
        return np.stack([with_optics(image[..., i], sensor, optics) for i in range(image.shape[2])], axis=-1)
    known = seeing_pixels(sensor)
    values = image[nearest_known(known)].astype(np.float64)
    reach = math.ceil(_REACH * max(optics.defocus_px, optics.defocus_edge_px or 0.0) + optics.motion_px)
    seam = min(seam_px(sensor) + reach, sensor.camera.width_px) if seam_px(sensor) else 0
    values = across_seam(values, seam)
    radius_2 = across_seam(_squared_radius(sensor), seam)
    values = _defocused(values, optics, radius_2)
    if optics.motion_px:
        values = _moved(values, optics.motion_px, math.radians(optics.motion_deg))
    values *= 1 - optics.vignetting * radius_2
    own = values[:, seam : values.shape[1] - seam] if seam else values
    result = np.where(known, own, image).astype(np.float32)
    result.flags.writeable = False
    return result


@lru_cache(maxsize=4)
def _squared_radius(sensor: Sensor) -> Array:
    """Squared distance from the principal point, 1 at the farthest pixel in use."""
    camera = sensor.camera
    u, v = np.arange(camera.width_px) - camera.cx_px, np.arange(camera.height_px) - camera.cy_px
    radius_2 = u[None, :] ** 2 + v[:, None] ** 2
    farthest = radius_2[seeing_pixels(sensor)].max(initial=0.0)
    return np.asarray(np.minimum(radius_2 / farthest, 1.0) if farthest else np.zeros_like(radius_2))


def _defocused(values: Array, optics: Optics, radius_2: Array) -> Array:
    """Blurred by a Gaussian whose variance goes from one value at the centre to another at the edge.

    Where they differ, each pixel is the mean of the two nearest of a few blurred images, weighted so that the variance
    of its point spread function is the right one.
    """
    centre = optics.defocus_px**2
    edge = centre if optics.defocus_edge_px is None else optics.defocus_edge_px**2
    if edge == centre:
        return _gaussian(values, math.sqrt(centre))
    levels = np.linspace(centre, edge, _LEVELS)
    position = radius_2 * (_LEVELS - 1)
    result = np.zeros_like(values)
    for i, variance in enumerate(levels):
        weight = np.maximum(1 - np.abs(position - i), 0.0)
        result += weight * _gaussian(values, math.sqrt(variance))
    return result


def _gaussian(values: Array, sigma_px: float) -> Array:
    if not sigma_px:
        return values
    return np.asarray(ndimage.gaussian_filter(values, sigma_px, mode="nearest", truncate=_REACH))


def _moved(values: Array, length_px: float, angle_rad: float) -> Array:
    """The mean over a straight path, centred: a product with `sinc` in the frequency domain, so for any length."""
    pad = math.ceil(length_px) + 16
    padded = np.pad(values, pad, mode="symmetric")
    rows, columns = (fft.next_fast_len(size, real=True) for size in padded.shape)
    f_v, f_u = fft.fftfreq(rows)[:, None], fft.rfftfreq(columns)[None, :]
    response = np.sinc(length_px * (math.cos(angle_rad) * f_u + math.sin(angle_rad) * f_v))
    filled = np.pad(padded, ((0, rows - padded.shape[0]), (0, columns - padded.shape[1])), mode="symmetric")
    blurred = fft.irfft2(fft.rfft2(filled) * response, s=(rows, columns))
    height, width = values.shape
    return np.asarray(blurred[pad : pad + height, pad : pad + width])
