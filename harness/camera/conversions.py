"""A hyperboloid mirror in the unified (Mei) model, and back: conversion to and from OpenCV's `ccalib.omnidir` and
Kalibr. The model itself is `harness.camera.models.unified`.

A direction on the unit sphere is projected by a pinhole at distance `xi` from the sphere's centre. A hyperboloid mirror
is exactly this with `eps = e/a`: `xi = 2 eps/(1 + eps²)` and focal length `gamma = f (eps² - 1)/(1 + eps²)`.

Frames. The functions here take directions in our frame. OpenCV and Kalibr look at the sphere along +Z, which is our -z;
X runs along u and Y along v, as ours do: (X, Y, Z) = (x, y, -z). One axis changes its sign, so this is a reflection and
not a rotation: their right-handed frame is left-handed in space, because the picture in a mirror is itself reversed.
`mirrored_frame` converts both ways. A pose becomes `R' = S R S`, `t' = S t` with S = diag(1, 1, -1), and R' is again a
proper rotation; ranges, angles and baselines do not change.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models.hyperboloid import HyperboloidCamera, Mirror
from harness.camera.models.unified import Unified, UnifiedCamera
from harness.camera.mount import camera_from_sensor
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.spec import LARGEST, Finite, Positive, Spec


class UnifiedParameters(Spec):
    """Parameters of the unified model."""

    xi: Annotated[float, Field(ge=0, le=LARGEST)]
    """Distance of the projection's centre from the sphere's, no unit."""
    gamma_u_px: Positive
    """Generalised focal length along u, pixels: OpenCV's K[0, 0]."""
    gamma_v_px: Positive
    """Generalised focal length along v, pixels: OpenCV's K[1, 1]."""
    skew_px: Finite = 0.0
    """OpenCV's K[0, 1], pixels."""
    cx_px: Finite
    """Principal point along u, pixels."""
    cy_px: Finite
    """Principal point along v, pixels."""


def to_unified(sensor: Sensor) -> UnifiedParameters:
    """The unified model with the sensor's projection. For a mirror the lens has to be rescaled: see `unified_lens`.

    Raises
    ------
    InputError
        When the sensor's camera model is neither a hyperboloid nor the unified model itself.
    """
    camera = _unified_or_hyperboloid(sensor)
    if isinstance(camera, UnifiedCamera):
        gamma_u, gamma_v, skew = camera.fu, camera.fv, camera.skew
    else:
        gamma_u, gamma_v, skew = camera.gamma_u, camera.gamma_v, camera.gamma_skew
    return UnifiedParameters(
        xi=camera.xi, gamma_u_px=gamma_u, gamma_v_px=gamma_v, skew_px=skew, cx_px=camera.cu, cy_px=camera.cv
    )


def unified_lens(sensor: Sensor) -> Lens:
    """The lens coefficients for the normalised plane of the unified model, which is larger by s = f/gamma.

    With m = s x, `x' = x (1 + k1 r²)` becomes `m' = m (1 + (k1/s²) |m|²)`; a tangential coefficient is divided by s.
    OpenCV's omnidir has no k3. The lens of a sensor of the unified model is returned unchanged.

    Raises
    ------
    InputError
        When the sensor's camera model is neither a hyperboloid nor the unified model itself.
    """
    camera = _unified_or_hyperboloid(sensor)
    if isinstance(camera, UnifiedCamera):
        return sensor.lens
    return Lens(
        k1=camera.k1_unified, k2=camera.k2_unified, p1=camera.p1_unified, p2=camera.p2_unified, k3=camera.k3_unified
    )


def _unified_or_hyperboloid(sensor: Sensor) -> UnifiedCamera | HyperboloidCamera:
    if not isinstance(sensor.model, Mirror | Unified):
        raise InputError(f"the {sensor.model.title} cannot be written in the unified model", key="sensor.model")
    return sensor.model.parameters(sensor.camera, sensor.lens)


def opencv_from_sensor(sensor: Sensor) -> Array:
    """`[3, 3]`, orthogonal: turns directions of the sensor's frame into OpenCV's, for the camera's mount.

    By default that is `mirrored_frame` for a mirror, and the identity for a lens, which looks up.
    """
    untilted = camera_from_sensor(sensor.looks, mirrored=sensor.mirrored)
    return untilted @ sensor.mount.R_sensor_from_untilted.T


def from_unified(
    unified: UnifiedParameters,
    width_px: int,
    height_px: int,
    *,
    a_m: float = 0.0281,
    lens: Lens | None = None,
    field: FieldOfView | None = None,
) -> Sensor:
    """The mirror sensor that a unified model describes.

    Parameters
    ----------
    a_m
        The mirror's size, metres. It does not follow from images: any value gives the same picture.
    lens
        Coefficients for the unified model's normalised plane (rescaled here); no distortion by default.

    Raises
    ------
    ValueError
        Unless 0 < xi < 1: xi = 1 is a paraboloid, above it no mirror.
    """
    if not 0 < unified.xi < 1:
        raise ValueError(f"xi = {unified.xi:g} is not a hyperboloid mirror: xi must be above 0 and below 1")
    eps = (1 + math.sqrt(1 - unified.xi**2)) / unified.xi
    s = (eps * eps + 1) / (eps * eps - 1)
    lens = lens or Lens()
    return Sensor(
        model=Mirror(a_m=a_m, b_m=a_m * math.sqrt(eps * eps - 1)),
        camera=Camera(
            width_px=width_px,
            height_px=height_px,
            focal_px=unified.gamma_u_px * s,
            aspect=unified.gamma_v_px / unified.gamma_u_px,
            skew_px=unified.skew_px * s,
            cx_px=unified.cx_px,
            cy_px=unified.cy_px,
        ),
        lens=Lens(k1=lens.k1 * s**2, k2=lens.k2 * s**4, p1=lens.p1 * s, p2=lens.p2 * s, k3=lens.k3 * s**6),
        field=field or FieldOfView(),
    )


def mirrored_frame(vectors: ArrayLike) -> Array:
    """Vectors `[..., 3]` of our frame in OpenCV's, or the reverse: `(x, y, -z)`."""
    return np.asarray(vectors, dtype=np.float64) * [1.0, 1.0, -1.0]
