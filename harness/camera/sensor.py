"""The omnidirectional sensor: a camera model, its image, lens and field of view; `project` and `unproject`.

How a direction becomes a pixel is the model's affair (`harness.camera.models`). u runs right and v down; the centre of
pixel [v, u] is at the integers (u, v).
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AliasChoices, Field, model_validator

from harness.camera._field_kernels import FieldLimits
from harness.camera._mounted_kernels import MountedCamera
from harness.camera._projection_kernels import compiled_model, differentiate_all, project_all
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import AnyModel, Mirror
from harness.camera.mount import Looks, Mount, camera_from_sensor, edge_of
from harness.geometry.angles import Array
from harness.spec import Spec, load


class Sensor(Spec):
    """A single-viewpoint catadioptric sensor. The defaults are those of the shipped experiments."""

    model: AnyModel = Field(default=Mirror(), validation_alias=AliasChoices("model", "mirror"))
    """The camera model: what bends rays to the camera."""
    camera: Camera = Camera()
    """The perspective camera that looks up at it."""
    lens: Lens = Lens()
    """The distortion of the camera's lens."""
    field: FieldOfView = FieldOfView()
    """The directions that the sensor sees."""
    mount: Mount = Mount()
    """How the camera is mounted."""

    @property
    def looks(self) -> Looks:
        """Where the optical axis points before the sensor is tilted."""
        return self.mount.looks or self.model.looks

    @property
    def mirrored(self) -> bool:
        """Whether the image is a mirror image."""
        return self.model.mirrored if self.mount.mirrored is None else self.mount.mirrored

    @model_validator(mode="after")
    def _sees_its_field(self) -> "Sensor":
        self.model.check(self.camera, self.lens, edge_of(self.field, self.looks))
        return self


def load_sensor(path: Path) -> Sensor:
    """Read a sensor file (TOML).

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    return load(Sensor, path)


def project(sensor: Sensor, directions: ArrayLike) -> tuple[Array, np.ndarray]:
    """Pixel at which a direction from the effective viewpoint is seen.

    Parameters
    ----------
    directions
        `[..., 3]` in the sensor's frame (z up), of any length.

    Returns
    -------
    pixels
        `[..., 2]`, (u, v) in pixels. Also given outside the field as long as mirror and lens go on; NaN beyond.
    valid
        `[...]`, bool: inside the cone of the field, and on the image.
    """
    directions = np.asarray(directions, dtype=np.float64)
    pixels = np.empty((*directions.shape[:-1], 2))
    project_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), pixels.reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        return pixels, in_field(sensor, directions) & on_image(sensor, pixels)


def jacobian(sensor: Sensor, directions: ArrayLike) -> Array:
    """How the pixel at which a direction is seen moves with the direction.

    Parameters
    ----------
    directions
        `[..., 3]` in the sensor's frame, of any length.

    Returns
    -------
    Array
        `[..., 2, 3]`, derivatives of (u, v) by (x, y, z), pixels per unit of the directions.
    """
    directions = np.asarray(directions, dtype=np.float64)
    out = np.empty((*directions.shape[:-1], 2, 3))
    differentiate_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), out.reshape(-1, 2, 3))
    return out


def unproject(sensor: Sensor, pixels: ArrayLike) -> tuple[Array, np.ndarray]:
    """Direction from the effective viewpoint that a pixel sees.

    Closed form but for the lens, which Newton's method undoes within its fold (see `harness.camera._lens_kernels`).

    Parameters
    ----------
    pixels
        `[..., 2]`, (u, v), fractions allowed.

    Returns
    -------
    directions
        `[..., 3]`, unit length; NaN where the lens has no inverse. Outside the field they go on smoothly, even where
        the mirror does not.
    valid
        `[...]`, bool: inside the cone of the field (so neither beyond the rim nor in the blind disc), and on the image.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    flat = pixels.reshape(-1, 2)
    rays = rays_of(sensor, np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1]))
    with np.errstate(invalid="ignore"):
        directions = (rays / np.sqrt(np.sum(rays * rays, axis=0))).T.reshape(*pixels.shape[:-1], 3)
    return directions, in_field(sensor, directions) & on_image(sensor, pixels)


def rays_of(sensor: Sensor, u: Array, v: Array) -> Array:
    """Rays of many pixels, not of unit length, as three rows `[3, n]`: the quick form of `unproject`, no masks.

    Parameters
    ----------
    u, v
        `[n]`, contiguous float64.
    """
    rays = np.empty((3, u.size))
    parameters = parameters_of(sensor)
    compiled_model(type(parameters)).rays(u, v, parameters, rays[0], rays[1], rays[2])
    return rays


def in_field(sensor: Sensor, directions: ArrayLike) -> np.ndarray:
    """Whether directions `[..., 3]` (any length) lie in the cone that the sensor sees."""
    directions = np.asarray(directions, dtype=np.float64)
    field = field_of(sensor)
    with np.errstate(invalid="ignore", divide="ignore"):
        norm = np.linalg.norm(directions, axis=-1)
        sine = _along(directions, field.up_x, field.up_y, field.up_z) / norm
        seen = (sine >= field.lowest) & (sine <= field.highest)
        if field.nearest > -1:
            seen &= _along(directions, field.axis_x, field.axis_y, field.axis_z) / norm >= field.nearest
        return seen


def _along(directions: Array, x: float, y: float, z: float) -> Array:
    return directions[..., 2] if (x, y, z) == (0, 0, 1) else directions @ np.array([x, y, z])


def on_image(sensor: Sensor, pixels: ArrayLike) -> np.ndarray:
    """Whether pixel coordinates `[..., 2]` lie on the image, which spans -0.5 .. width - 0.5."""
    pixels = np.asarray(pixels, dtype=np.float64)
    u, v = pixels[..., 0], pixels[..., 1]
    return (u >= -0.5) & (u <= sensor.camera.width_px - 0.5) & (v >= -0.5) & (v <= sensor.camera.height_px - 0.5)


@lru_cache(maxsize=8)
def pixel_directions(sensor: Sensor) -> tuple[Array, np.ndarray]:
    """Unit direction `[height, width, 3]` and validity `[height, width]` of every pixel centre; read-only, kept."""
    camera = sensor.camera
    u, v = np.meshgrid(np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px, dtype=np.float64))
    directions, valid = unproject(sensor, np.stack([u, v], axis=-1))
    directions.flags.writeable = False
    valid.flags.writeable = False
    return directions, valid


def seam_px(sensor: Sensor, reach_px: int = 32) -> int:
    """How many columns of an image to repeat beyond its left and right borders, for what reaches `reach_px` pixels.

    0 unless the image goes round: neighbours are on the image then, or there are none. 32 are enough for a spline's
    prefilter, which lets 1e-12 of what is beyond through.
    """
    return min(reach_px, sensor.camera.width_px) if sensor.model.goes_round(sensor.camera) else 0


@lru_cache(maxsize=64)
def parameters_of(sensor: Sensor) -> Any:
    """What the compiled projection is given: the camera model's named tuple, or that of a `MountedCamera` around it."""
    model = sensor.model.parameters(sensor.camera, sensor.lens)
    R = model_from_sensor(sensor)
    return model if np.array_equal(R, np.eye(3)) else MountedCamera(*(*R.ravel().tolist(), model))


def model_from_sensor(sensor: Sensor) -> Array:
    """`[3, 3]`, orthogonal: turns directions of the sensor's frame into the camera model's own."""
    model = sensor.model
    return (
        camera_from_sensor(model.looks, mirrored=model.mirrored).T
        @ camera_from_sensor(sensor.looks, mirrored=sensor.mirrored)
        @ sensor.mount.R_sensor_from_untilted.T
    )


@lru_cache(maxsize=64)
def field_of(sensor: Sensor, margin_rad: float = 0.0) -> FieldLimits:
    """The field of view as compiled loops take it.

    Parameters
    ----------
    margin_rad
        By how much it is widened to all sides.
    """
    field, margin_deg = sensor.field, math.degrees(margin_rad)
    lowest, highest = field.elevation_min_deg - margin_deg, field.elevation_max_deg + margin_deg
    nearest = field.angle_max_deg + margin_deg
    up = sensor.mount.R_sensor_from_untilted[:, 2]
    axis = sensor.mount.R_sensor_from_untilted @ camera_from_sensor(sensor.looks, mirrored=sensor.mirrored)[2]
    return FieldLimits(
        # Straight up and down, a rounding may make the sine larger than 1.
        float(np.sin(np.radians(lowest))) if lowest > -90 else -2.0,
        float(np.sin(np.radians(highest))) if highest < 90 else 2.0,
        float(np.cos(np.radians(nearest))) if nearest < 180 else -2.0,
        *up.tolist(),
        *axis.tolist(),
    )
