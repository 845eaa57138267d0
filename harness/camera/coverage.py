"""A sensor's field of view and its use of the image: image circle, blind spot, pixels per degree."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.models.axial import AxialModel
from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor, in_field, jacobian, lens_from_sensor, on_image, pixel_directions, project
from harness.display import OneLine
from harness.geometry.angles import Array

_AROUND = 360
"""Directions all round the axis."""
_ANGLES = 361
"""Angles off the axis for the profile of resolution: half a degree apart at most."""
_NEAR_POLE = math.radians(5)
"""Near the poles of a panorama, within this angle, its tangential resolution diverges."""
HARDLY = 0.02
"""A ring with a smaller share on the image is not an image circle: the frame cuts it off on all sides."""
_SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True, repr=False)
class Ring(OneLine):
    """The image of a cone around the optical axis."""

    angle_rad: float
    """Angle off the optical axis."""
    pixels: Array
    """`[n, 2]`, (u, v), all round; NaN outside the model's domain."""
    centre_px: tuple[float, float]
    diameter_px: tuple[float, float]
    """The shortest and the longest diameter through the centre."""
    on_image: float
    """Share of the ring on the image, 0 .. 1."""
    sides: tuple[str, ...]
    """Sides on which it leaves the image: `left`, `right`, `top`, `bottom`."""


@dataclass(frozen=True, repr=False)
class Resolution(OneLine):
    """Pixels per degree against the angle off the optical axis; `[angles]`, NaN where no direction is on the image."""

    angle_rad: Array
    elevation_rad: Array
    """These angles as elevations, for a sensor that looks up or down; NaN for one that looks forward."""
    radial: Array
    """Along the angle off the axis; the median over azimuths around it."""
    tangential: Array
    """Around the axis; the median likewise."""
    radial_range: Array
    """`[angles, 2]`: minimum and maximum over azimuths."""
    tangential_range: Array


@dataclass(frozen=True, repr=False)
class Coverage(OneLine):
    """A sensor's field of view, and the share of the image that it uses."""

    sensor: Sensor
    axis_px: tuple[float, float]
    """The pixel (u, v) of the optical axis; NaN if it is outside the model's domain."""
    rim: Ring
    """The outer edge of the field."""
    blind: Ring | None
    """The inner edge, if the field excludes a cone around the axis."""
    elevation_deg: tuple[float, float]
    """The lowest and the highest elevation of any pixel in the field."""
    used: float
    """Share of the image's pixels that are in the field, 0 .. 1."""
    sphere: float
    """Share of the sphere of directions that is visible, 0 .. 1."""
    resolution: Resolution
    valid: NDArray[np.bool_]
    """`[height, width]`: the pixels that are in the field."""


def coverage(sensor: Sensor) -> Coverage:
    """The field of view of a sensor, and the share of its image that it uses.

    Raises
    ------
    ValueError
        When no pixel sees anything.
    """
    directions, valid = pixel_directions(sensor)
    if not valid.any():
        raise ValueError("no pixel sees anything")
    elevation = np.degrees(np.arcsin(np.clip(directions[..., 2][valid], -1, 1)))
    least, largest = _angles_of_field(sensor)
    axis = project(sensor, _axis_frame(sensor)[2])[0]
    return Coverage(
        sensor=sensor,
        axis_px=(float(axis[0]), float(axis[1])),
        rim=_ring(sensor, largest),
        blind=_ring(sensor, least) if least > 1e-6 else None,
        elevation_deg=(float(elevation.min()), float(elevation.max())),
        used=float(valid.mean()),
        sphere=_share_of_sphere(sensor),
        resolution=_resolution(sensor, least, largest),
        valid=valid,
    )


def has_circle(sensor: Sensor) -> bool:
    """Whether cones around the optical axis are rings in the image, as in all models but panoramas."""
    return isinstance(sensor.model, AxialModel | Mirror)


def _axis_frame(sensor: Sensor) -> Array:
    """`[3, 3]`: from the sensor's frame to one whose z is the optical axis, or the vertical in a panorama."""
    return lens_from_sensor(sensor) if has_circle(sensor) else sensor.mount.R_sensor_from_untilted.T


def _angles_of_field(sensor: Sensor) -> tuple[float, float]:
    """The least and the largest angle off the axis of a direction in the field that has a pixel, on the image or not.

    Searched in steps of a quarter of a degree, then refined by bisection to rounding.
    """
    R = _axis_frame(sensor)

    def are_visible(angles_rad: list[float]) -> list[bool]:
        rays = np.stack([_cone(each, 72)[0] for each in angles_rad]) @ R
        inside = in_field(sensor, rays) & np.isfinite(project(sensor, rays)[0]).all(axis=-1)
        return [bool(each) for each in np.atleast_1d(inside.any(axis=-1))]

    angles = np.linspace(0, math.pi, 721).tolist()
    visible = are_visible(angles)
    first, last = visible.index(True), len(visible) - 1 - visible[::-1].index(True)

    def edge(outside: int, inside: int) -> float:
        if not 0 <= outside < len(angles):
            return angles[inside]
        out, into = angles[outside], angles[inside]
        for _ in range(48):
            middle = (out + into) / 2
            out, into = (out, middle) if are_visible([middle])[0] else (middle, into)
        return into

    return edge(first - 1, first), edge(last + 1, last)


def _cone(angle_rad: float, count: int = _AROUND) -> tuple[Array, Array, Array]:
    """Unit directions `[n, 3]` at an angle off the axis z, and their tangents outwards and around."""
    around = np.arange(count) * (2 * math.pi / count)
    c, s, zero = np.cos(around), np.sin(around), np.zeros(count)
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    rays = np.stack([sine * c, sine * s, zero + cosine], axis=-1)
    outwards = np.stack([cosine * c, cosine * s, zero - sine], axis=-1)
    return rays, outwards, np.stack([-s, c, zero], axis=-1)


def _ring(sensor: Sensor, angle_rad: float) -> Ring:
    pixels = project(sensor, _cone(angle_rad)[0] @ _axis_frame(sensor))[0]
    half = len(pixels) // 2
    across = np.linalg.norm(pixels[:half] - pixels[half:], axis=-1)
    known = np.isfinite(pixels).all(axis=-1)
    with np.errstate(invalid="ignore"):
        inside = on_image(sensor, pixels)
    camera = sensor.camera
    u, v = pixels[known].T if known.any() else np.empty((2, 0))
    beyond = (u < -0.5, u > camera.width_px - 0.5, v < -0.5, v > camera.height_px - 0.5)
    middle = np.nanmean(pixels, axis=0) if known.any() else (math.nan, math.nan)
    has_diameter = bool(np.isfinite(across).any())
    return Ring(
        angle_rad=angle_rad,
        pixels=pixels,
        centre_px=(float(middle[0]), float(middle[1])),
        diameter_px=(float(np.nanmin(across)), float(np.nanmax(across))) if has_diameter else (math.nan, math.nan),
        on_image=float(inside.mean()),
        sides=tuple(side for side, is_beyond in zip(_SIDES, beyond, strict=True) if is_beyond.any()),
    )


def _share_of_sphere(sensor: Sensor) -> float:
    """The share of all directions that is visible, to 1e-3, from 20,000 directions of a Fibonacci spiral."""
    count = 20_000
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    phi = index * math.pi * (1 + math.sqrt(5))
    across = np.sqrt(1 - z * z)
    _, valid = project(sensor, np.stack([across * np.cos(phi), across * np.sin(phi), z], axis=-1))
    return float(valid.mean())


def _resolution(sensor: Sensor, least: float, largest: float) -> Resolution:
    # Not at the axis itself, where "outwards" is every direction, nor at the poles of a panorama.
    nearest = 1e-4 if has_circle(sensor) else _NEAR_POLE
    angles = np.linspace(max(least, nearest), min(largest, math.pi - nearest), _ANGLES)
    R = _axis_frame(sensor)
    resolution = np.full((2, 3, len(angles)), np.nan)
    for i, angle in enumerate(angles):
        rays, *moves = (each @ R for each in _cone(angle, 72))
        visible = project(sensor, rays)[1]
        if not visible.any():
            continue
        slopes = jacobian(sensor, rays[visible])
        for j, move in enumerate(moves):
            per_degree = np.linalg.norm(np.einsum("nij,nj->ni", slopes, move[visible]), axis=-1) * (math.pi / 180)
            resolution[j, :, i] = np.median(per_degree), per_degree.min(), per_degree.max()
    axis_up = float(R[2, 2])  # the optical axis's z in the sensor's frame
    vertical = abs(axis_up) > 1 - 1e-9
    return Resolution(
        angle_rad=angles,
        elevation_rad=math.copysign(1, axis_up) * (math.pi / 2 - angles) if vertical else np.full_like(angles, np.nan),
        radial=resolution[0, 0],
        tangential=resolution[1, 0],
        radial_range=resolution[0, 1:].T,
        tangential_range=resolution[1, 1:].T,
    )
