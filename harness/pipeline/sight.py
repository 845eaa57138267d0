"""Whether there is anything to see and to match, before it is rendered: what cannot come out is refused by its key."""

import warnings
from functools import lru_cache

import numpy as np

from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, in_field, pixel_directions, project
from harness.errors import InputError, Notice
from harness.geometry.panorama import Grid, cylinder
from harness.geometry.pose import Motion
from harness.pipeline.specification import Trial

LITTLE = 0.05
"""A share of pixels below which there is a notice: figures of so few say little."""

_CIRCLE = "camera.focal_px, camera.cx_px and camera.cy_px"
"""The keys that say how large the mirror's circle is and where it lies on the image."""


def check_sight(trial: Trial, motion: Motion) -> None:
    """Refuse a trial in which nothing can be seen or matched, and give notice where it is next to nothing.

    Parameters
    ----------
    motion
        The motion that the matcher assumes.

    Raises
    ------
    InputError
        When no pixel of the sensor sees anything, no pixel of the panorama is seen, or the matcher's samples cannot
        follow the epipolar curves. `error.key` is the key that helps.
    """
    on_sensor, on_panorama = _shares(trial.sensor, trial.panorama)
    if on_sensor == 0 or (on_panorama == 0 and _share_in_field(trial.sensor, trial.panorama)):
        raise _blind(trial.sensor, trial.panorama, "trial.")
    if on_panorama == 0:
        raise InputError(
            f"the sensor sees no row of the panorama: it sees z from {_z(trial.sensor)}; change z_min and z_max",
            key="trial.panorama.z_max",
        )
    sampling, _ = trial.matching.sampled(motion.t_v1)
    if sampling == "phi" and np.hypot(*motion.t_v1[:2]) <= 1e-9 * motion.baseline_m:
        raise InputError(
            "along a vertical baseline phi stays the same, so there are no samples in phi; "
            'use matching.kind = "window" with sampling = "alpha", or "sgm"',
            key="trial.matching.sampling",
        )
    _say_little(trial.sensor, trial.panorama, "trial.")


def check_sensor(sensor: Sensor, grid: Grid) -> None:
    """Refuse a sensor that sees nothing, and give notice where it sees next to nothing of its image or of a panorama.

    Parameters
    ----------
    grid
        The panorama.

    Raises
    ------
    InputError
        When no pixel of the image sees anything. `error.key` is the key that helps.
    """
    if _shares(sensor, grid)[0] == 0:
        raise _blind(sensor, grid, "")
    _say_little(sensor, grid, "")


def _say_little(sensor: Sensor, grid: Grid, stem: str) -> None:
    """Give notice where next to nothing of the image or of the panorama is seen; `stem` precedes the user's keys."""
    on_sensor, on_panorama = _shares(sensor, grid)
    if on_sensor < LITTLE:
        _notice(f"only {on_sensor:.1%} of the image's pixels see the mirror; see {stem}sensor.{_CIRCLE}")
    if on_panorama < LITTLE:
        if _share_in_field(sensor, grid) >= LITTLE:
            _notice(f"only {on_panorama:.1%} of the panorama is on the image; see {stem}sensor.{_CIRCLE}")
        else:
            _notice(
                f"only {on_panorama:.1%} of the panorama is seen: z from {_z(sensor)}; "
                f"see {stem}panorama.z_min and z_max"
            )


def _blind(sensor: Sensor, grid: Grid, stem: str) -> InputError:
    remedy = _remedy(sensor, grid) or f"change sensor.{_CIRCLE}, or sensor.field"
    return InputError(f"no pixel of the image sees what the panorama shows; {remedy}", key=f"{stem}sensor")


def _z(sensor: Sensor) -> str:
    """What the sensor's field spans on the cylinder."""
    field = sensor.field
    return " .. ".join(
        f"{np.tan(np.radians(np.clip(each, -89.9, 89.9))):.2f}"
        for each in (field.elevation_min_deg, field.elevation_max_deg)
    )


def _share_in_field(sensor: Sensor, grid: Grid) -> float:
    """The share of the panorama's pixels in the cone that the sensor would see on an image without borders."""
    return float(in_field(sensor, cylinder(grid)).mean())


def _notice(text: str) -> None:
    warnings.warn(text, Notice, stacklevel=1)


@lru_cache(maxsize=8)
def _shares(sensor: Sensor, grid: Grid) -> tuple[float, float]:
    """The shares of the image's pixels, and of the panorama's, that see something."""
    return float(pixel_directions(sensor)[1].mean()), float(project(sensor, cylinder(grid))[1].mean())


def _remedy(sensor: Sensor, grid: Grid) -> str:
    """The key to blame: the first one without which something would be seen; empty when there is none."""
    plain = sensor.model_copy(update={"lens": Lens()})
    if plain != sensor and _shares(plain, grid)[1] > LITTLE:
        return "its lens bends the picture away; use weaker coefficients in sensor.lens"
    square = plain.model_copy(update={"camera": plain.camera.model_copy(update={"aspect": 1.0})})
    if square != plain and _shares(square, grid)[1] > LITTLE:
        return f"sensor.camera.aspect = {sensor.camera.aspect:g} stretches the picture off the image; it is about 1"
    return ""
