"""Checks, before rendering, that there is something to see and to match; the message names the key at fault."""

import warnings
from functools import lru_cache

import numpy as np

from harness.camera.lens import Lens
from harness.camera.reflection import seeing_pixels
from harness.camera.sensor import Sensor, field_of, in_field, pixels_seen, project
from harness.errors import InputError, Notice
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, cylinder
from harness.geometry.pose import Motion
from harness.pipeline.specification import Trial

LITTLE = 0.05
"""A share of pixels below which there is a notice: figures over so few pixels mean little."""

LITTLE_OF_FIELD = 0.25
"""Share of the panorama's pixels in a sensor's field that should be on its image: with fewer there is a notice."""

_CIRCLE = "camera.focal_px, camera.cx_px and camera.cy_px"
"""The keys that set the size and position of the mirror's circle on the image."""


def check_sight(trial: Trial, motion: Motion) -> None:
    """Refuse a trial in which nothing can be seen or matched, and give notice where hardly anything can.

    Parameters
    ----------
    motion
        The motion that the matcher assumes.

    Raises
    ------
    InputError
        When no pixel of a sensor sees anything, no pixel of the panorama is seen, or the matcher's samples cannot
        follow the epipolar curves. `error.key` is the key that helps.
    """
    (sensor, second), grid = trial.assumed_sensors, trial.panorama
    for each, key in zip(trial.sensors, ("trial.sensor", "trial.sensor_2"), strict=True):
        check_mirror(each, key)
    on_sensor, on_panorama = _shares(sensor, grid)
    if on_sensor == 0 or (on_panorama == 0 and _share_in_field(sensor, grid)):
        raise _blind(sensor, grid, "trial.sensor")
    if on_panorama == 0:
        raise InputError(
            f"the sensor sees no row of the panorama: its field is z from {_z(sensor)}; change z_min and z_max",
            key="trial.panorama.z_max",
        )
    sampling, _ = trial.matching.sampled(motion.t_v1)
    if sampling == "phi" and np.hypot(*motion.t_v1[:2]) <= 1e-9 * motion.baseline_m:
        raise InputError(
            "with a vertical baseline phi is constant along a curve, so it cannot be sampled in phi; "
            'use matching.kind = "window" with sampling = "alpha", or "sgm"',
            key="trial.matching.sampling",
        )
    _notice_if_little(sensor, grid, "trial.sensor")
    if second != sensor:
        check_sensor(second, grid, key="trial.sensor_2", R_sensor_from_panorama=motion.R_v2_from_v1)


def check_mirror(sensor: Sensor, key: str = "sensor") -> None:
    """Refuse a camera so far beside its mirror that it sees nothing in it.

    Raises
    ------
    InputError
        Names the key of the misalignment, or of the profile.
    """
    if not sensor.is_central and not seeing_pixels(sensor).any():
        raise InputError(
            "no pixel of the image sees the mirror: the camera is too far off or looks past it; "
            + ("use smaller values" if sensor.profile is None else "see profile, camera, field and misalignment"),
            key=f"{key}.misalignment" if sensor.profile is None else f"{key}.profile",
        )


def check_sensor(
    sensor: Sensor, grid: Grid, *, key: str = "sensor", R_sensor_from_panorama: Array | None = None
) -> None:
    """Refuse a sensor that sees nothing, and give notice where it sees hardly anything of its image or of a panorama.

    Parameters
    ----------
    grid
        The panorama.
    key
        The user's key for the sensor, for messages.
    R_sensor_from_panorama
        `[3, 3]`; turns a direction of the panorama's frame into the sensor's.

    Raises
    ------
    InputError
        When no pixel of the image sees anything. `error.key` is the key that helps.
    """
    if _shares(sensor, grid)[0] == 0:
        raise _blind(sensor, grid, key)
    _notice_if_little(sensor, grid, key, R_sensor_from_panorama)


def _notice_if_little(sensor: Sensor, grid: Grid, key: str, R_sensor_from_panorama: Array | None = None) -> None:
    """Give notice where hardly anything of the image or of the panorama is seen."""
    rotation = _IDENTITY if R_sensor_from_panorama is None else np.asarray(R_sensor_from_panorama, np.float64).tobytes()
    on_sensor, on_panorama = _shares(sensor, grid, rotation)
    masked = f"{key}.mask, " if sensor.mask is not None else ""
    if on_sensor < LITTLE:
        _notice(f"only {on_sensor:.1%} of the image's pixels see the mirror; see {masked}{key}.{_CIRCLE}")
    in_field_of_it = _share_in_field(sensor, grid, rotation)
    if on_panorama < max(LITTLE, LITTLE_OF_FIELD * in_field_of_it):
        if in_field_of_it >= LITTLE:
            _notice(f"only {on_panorama:.1%} of the panorama is on the image; see {masked}{key}.{_CIRCLE}")
        else:
            stem, dot, _ = key.rpartition(".")
            _notice(
                f"only {on_panorama:.1%} of the panorama is seen: z from {_z(sensor)}; "
                f"see {stem}{dot}panorama.z_min and z_max"
            )


def _blind(sensor: Sensor, grid: Grid, key: str) -> InputError:
    name = key.rpartition(".")[2]
    remedy = _remedy(sensor, grid, name) or f"change {name}.{_CIRCLE}, or {name}.field"
    return InputError(f"no pixel of the image falls on the panorama; {remedy}", key=key)


def _z(sensor: Sensor) -> str:
    """The interval of z, as text, that the sensor's field spans on the cylinder."""
    lowest, highest = sensor.field.elevation_min_deg, sensor.field.elevation_max_deg
    limits = field_of(sensor)
    if limits.up_z != 1 or limits.nearest > -1:  # tilted, or a cone: every half degree of elevation, 5 of azimuth
        elevations, azimuths = np.radians(np.arange(-90, 90.5, 0.5))[:, None], np.radians(np.arange(0, 360, 5))
        x, y = np.cos(elevations) * np.cos(azimuths), np.cos(elevations) * np.sin(azimuths)
        around = np.stack([x, y, np.broadcast_to(np.sin(elevations), x.shape)], axis=-1)
        visible_deg = np.degrees(elevations[in_field(sensor, around).any(axis=1), 0])
        lowest, highest = (float(visible_deg.min()), float(visible_deg.max())) if visible_deg.size else (0.0, 0.0)
    return " .. ".join(f"{np.tan(np.radians(np.clip(each, -89.9, 89.9))):.2f}" for each in (lowest, highest))


_IDENTITY = np.eye(3).tobytes()


def _directions(grid: Grid, rotation: bytes) -> Array:
    """The directions of the panorama's pixels in the sensor's frame, `[height, width, 3]`."""
    return cylinder(grid) if rotation == _IDENTITY else cylinder(grid) @ np.frombuffer(rotation).reshape(3, 3).T


@lru_cache(maxsize=8)
def _share_in_field(sensor: Sensor, grid: Grid, rotation: bytes = _IDENTITY) -> float:
    """The share of the panorama's pixels in the cone that the sensor would see on an image without borders."""
    return float(in_field(sensor, _directions(grid, rotation)).mean())


def _notice(text: str) -> None:
    warnings.warn(text, Notice, stacklevel=1)


@lru_cache(maxsize=8)
def _shares(sensor: Sensor, grid: Grid, rotation: bytes = _IDENTITY) -> tuple[float, float]:
    """The shares of the image's pixels, and of the panorama's, that see something."""
    return float(pixels_seen(sensor).mean()), float(project(sensor, _directions(grid, rotation))[1].mean())


def _remedy(sensor: Sensor, grid: Grid, name: str) -> str:
    """The key to blame: the first one without which something would be visible; empty if there is no such key."""
    if sensor.mask is not None:
        sensor = sensor.model_copy(update={"mask": None})
        if _shares(sensor, grid)[1] > LITTLE:
            return f"{name}.mask hides it all: pixels in use must be white in it"
    plain = sensor.model_copy(update={"lens": Lens()})
    if plain != sensor and _shares(plain, grid)[1] > LITTLE:
        return f"the lens distortion moves the picture off the image; use weaker coefficients in {name}.lens"
    square = plain.model_copy(update={"camera": plain.camera.model_copy(update={"aspect": 1.0})})
    if square != plain and _shares(square, grid)[1] > LITTLE:
        return f"{name}.camera.aspect = {sensor.camera.aspect:g} stretches the picture off the image; it is about 1"
    return ""
