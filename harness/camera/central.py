"""The central sensor that best agrees with a mirror without a viewpoint, as an approximation for users of its images.

Every pixel of the aligned camera sees the point at a stated distance from the sensor's origin on its true ray.
OCamCalib's polynomial Z(rho) is fitted to the directions of these points: least squares of the angles across the rays,
`(Z sin theta - rho cos theta)/hypot(Z, rho)`, which is linear in the coefficients but for the weights, taken from the
solution before.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from pydantic import ValidationError

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.models.ocam import OCam
from harness.camera.mount import Mount
from harness.camera.profile_reflection import profile_of
from harness.camera.reflection import reflected_pixels
from harness.camera.sensor import Sensor, field_of, in_field, lens_from_sensor, project, unproject
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array

DISTANCE_M = 3.0
"""Distance from the sensor's origin at which a central sensor is fitted, unless another is given."""

_DEGREES = (4, 6, 8, 10, 11)
_STEPS = 12
"""Iterations of the weights, which converge to ten digits."""
_ENOUGH = 0.9
"""A higher degree has to leave a smaller residual than this part of the one before."""
_INNER = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Radii, as parts of the largest, within which pixels are left out, in turn, until the residual is good."""
_GOOD_PX = 0.1
_COMPARED = 20_000
"""Approximate number of pixels compared."""


@dataclass(frozen=True, repr=False)
class BestCentral(OneLine):
    """The central sensor that fits best, and by how much its rays miss the points that the mirror's pixels see."""

    sensor: Sensor
    distance_m: float
    """Distance of the points from the sensor's origin, metres."""
    rms_px: float
    largest_px: float
    rms_deg: float
    largest_deg: float
    pixels: int
    """Number of pixels that were compared."""
    left_out: float
    """Share of the pixels, around the principal point, whose rays no polynomial has: of a cone's tip. They are outside
    the sensor's field."""

    def at(self, true: Sensor, distance_m: float) -> "BestCentral":
        """The same sensor, compared at another distance."""
        pixels, towards = _points(true, distance_m)
        inside = in_field(self.sensor, towards)
        return _compared(self.sensor, pixels[inside], towards[inside], distance_m, self.left_out)


def central_of(sensor: Sensor) -> Sensor:
    """The central sensor that users of the images assume, its camera and mirror aligned.

    The sensor itself if it is central, the aligned one of a hyperboloid, the best central one of a `[profile]`.
    """
    return sensor.aligned if sensor.profile is None else best_central(sensor).sensor


@lru_cache(maxsize=64)
def best_central(sensor: Sensor, distance_m: float = DISTANCE_M) -> BestCentral:
    """The central sensor of OCamCalib's model that is nearest to a mirror with a `[profile]`, its camera aligned.

    Parameters
    ----------
    distance_m
        Distance from the sensor's origin at which rays are to agree, metres.

    Raises
    ------
    InputError
        When no pixel sees anything, no polynomial has these rays, or the mirror is larger than the distance.
    """
    profile = profile_of(sensor)
    aligned = sensor.aligned.model_copy(update={"mask": None})
    pixels, towards = _points(aligned, distance_m)
    if not len(pixels):
        raise InputError("no pixel of the image sees anything in this mirror; see camera and field", key="profile")
    rho = _radii(aligned, pixels)
    best: BestCentral | None = None
    for inner in _INNER:
        outside = rho >= inner * rho.max()
        for degree in _DEGREES:
            central = _polynomial(aligned, pixels[outside], towards[outside], degree)
            if central is None:
                continue
            left_out = float(1 - outside.mean())
            compared = _compared(central, pixels[outside], towards[outside], distance_m, left_out)
            if math.isfinite(compared.rms_px) and (best is None or compared.rms_px < _ENOUGH * best.rms_px):
                best = compared
        if best is not None and best.rms_px < _GOOD_PX:
            break
    if best is None:
        raise InputError(f"no central camera approximates this {profile.title}", key="profile")
    if sensor.mask is not None:
        masked = best.sensor.model_copy(update={"mask": sensor.mask})
        best = BestCentral(**{**vars(best), "sensor": masked})
    return best


def _points(sensor: Sensor, distance_m: float) -> tuple[Array, Array]:
    """Pixels `[n, 2]`, and the unit directions `[n, 3]` of the points that they see at a distance from the origin."""
    origins, directions, valid = reflected_pixels(sensor)
    every = max(1, math.isqrt(int(valid.sum()) // _COMPARED))
    rows, columns = np.nonzero(valid[::every, ::every])
    rows, columns = rows * every, columns * every
    p, r = origins[rows, columns], directions[rows, columns]
    reach = float(np.max(np.linalg.norm(p, axis=-1), initial=0.0))
    if reach >= distance_m:
        raise InputError(
            f"the mirror reaches {reach:.3g} m from its origin, and a central camera is fitted at {distance_m:g} m",
            key="profile",
        )
    along = np.sum(p * r, axis=-1)
    s = np.sqrt(distance_m**2 - np.sum(p * p, axis=-1) + along**2) - along
    return np.stack([columns, rows], axis=-1).astype(np.float64), (p + s[:, None] * r) / distance_m


def _polynomial(sensor: Sensor, pixels: Array, towards: Array, degree: int) -> Sensor | None:
    """The sensor with the polynomial of a degree; None if that is no camera over the whole field."""
    camera = sensor.camera
    c, e = camera.aspect, camera.skew_px / camera.focal_px
    rho = _radii(sensor, pixels)
    z = (towards @ lens_from_sensor(sensor).T)[:, 2]
    sine = np.sqrt(np.maximum(1 - z * z, 0))  # z is rounded
    reach = float(rho.max())
    powers = [0, *range(2, degree + 1)]
    columns = np.stack([(rho / reach) ** i for i in powers], axis=-1) * reach
    weight = sine / np.maximum(rho, 1.0)  # as if every pixel had its true Z
    for _ in range(_STEPS):
        terms = np.linalg.lstsq(columns * (sine * weight)[:, None], rho * z * weight, rcond=None)[0]
        weight = 1 / np.maximum(np.hypot(columns @ terms, rho), 1e-9)
    coefficients = [0.0] * (degree + 1)
    for i, term in zip(powers, terms.tolist(), strict=True):
        coefficients[i] = -term * reach ** (1 - i)
    try:
        return Sensor(
            model=OCam(coefficients=tuple(coefficients), c=c, e=e),
            camera=Camera(width_px=camera.width_px, height_px=camera.height_px, cx_px=camera.cx_px, cy_px=camera.cy_px),
            field=_field(sensor, towards, z),
            mount=Mount.model_validate(dict(sensor.mount) | {"looks": sensor.looks, "mirrored": sensor.mirrored}),
        )
    except ValidationError:
        return None


def _radii(sensor: Sensor, pixels: Array) -> Array:
    """Radii `[n]` of pixels in the ideal image, where u and v have one focal length and are at right angles."""
    camera = sensor.camera
    p = (pixels[:, 1] - camera.cy_px) / camera.aspect
    return np.hypot(p, pixels[:, 0] - camera.cx_px - camera.skew_px / camera.focal_px * p)


def _field(sensor: Sensor, towards: Array, z: Array) -> FieldOfView:
    """The sensor's field of view, narrowed to directions that some pixel sees."""
    limits, field = field_of(sensor), sensor.field
    elevation = np.degrees(np.arcsin(np.clip(towards @ [limits.up_x, limits.up_y, limits.up_z], -1, 1)))
    return FieldOfView(
        elevation_min_deg=max(field.elevation_min_deg, math.floor(100 * elevation.min()) / 100),
        elevation_max_deg=min(field.elevation_max_deg, math.ceil(100 * elevation.max()) / 100),
        angle_max_deg=min(field.angle_max_deg, math.ceil(100 * np.degrees(np.arccos(z.min()))) / 100),
    )


def _compared(central: Sensor, pixels: Array, towards: Array, distance_m: float, left_out: float) -> BestCentral:
    unprojected, _ = unproject(central, pixels)
    apart_deg = np.degrees(2 * np.arcsin(np.minimum(0.5 * np.linalg.norm(unprojected - towards, axis=-1), 1.0)))
    apart_px = np.linalg.norm(project(central, towards)[0] - pixels, axis=-1)
    return BestCentral(
        sensor=central,
        distance_m=distance_m,
        rms_px=float(np.sqrt(np.mean(apart_px**2))),
        largest_px=float(apart_px.max()),
        rms_deg=float(np.sqrt(np.mean(apart_deg**2))),
        largest_deg=float(apart_deg.max()),
        pixels=len(pixels),
        left_out=left_out,
    )
