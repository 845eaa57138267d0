"""The omnidirectional sensor: mirror, camera, lens and field of view; `project` and `unproject`.

The image of direction d: the mirror point P (see `mirror`), seen from F1 at the normalised coordinates
(P_x, P_y)/(P_z + 2e), bent by the lens, scaled to pixels. u runs right and v down; the centre of pixel [v, u] is at
the integers (u, v).
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from harness.camera._unproject_kernels import rays_of_pixels
from harness.camera.lens import Lens, distort, fold_radius
from harness.camera.mirror import Mirror, point_on_mirror
from harness.geometry.angles import Array
from harness.spec import Finite, Positive, Spec, load

Pixels = Annotated[int, Field(ge=8, le=16384)]


class Camera(Spec):
    """The perspective camera behind the mirror: 640x480 as in the paper, +20° of elevation 238 px from the centre."""

    width_px: Pixels = 640
    """Width of the image, pixels."""
    height_px: Pixels = 480
    """Height of the image, pixels."""
    focal_px: Positive = 614.12
    """Focal length along u, pixels."""
    aspect: Positive = 1.0
    """Focal length along v divided by that along u, no unit."""
    cx_px: Finite = 319.5
    """Principal point along u, pixels; the centre of the first pixel is 0."""
    cy_px: Finite = 239.5
    """Principal point along v, pixels; the centre of the first pixel is 0."""

    @model_validator(mode="after")
    def _looks_at_its_mirror(self) -> "Camera":
        for key, at, size in (("cx_px", self.cx_px, self.width_px), ("cy_px", self.cy_px, self.height_px)):
            if not -0.5 <= at <= size - 0.5:
                middle = (size - 1) / 2
                raise ValueError(f"{key} = {at:g} is not on an image of {size} pixels; its middle is {middle:g}")
        return self


class FieldOfView(Spec):
    """The cone of directions that the sensor sees."""

    elevation_min_deg: Finite = -75.0
    """Lowest elevation seen, degrees. Below it the camera sees itself: one of 20 mm radius at F1, 73 mm below F0,
    hides what is under -75°."""
    elevation_max_deg: Finite = 20.0
    """Elevation at which the mirror ends, degrees: +20° puts its rim 238 px from the centre, just inside 480 rows."""

    @model_validator(mode="after")
    def _ordered(self) -> "FieldOfView":
        if not -90 <= self.elevation_min_deg < self.elevation_max_deg <= 90:
            raise ValueError("elevation_min_deg must be below elevation_max_deg, both within -90 .. 90")
        return self


class Sensor(Spec):
    """A single-viewpoint catadioptric sensor. The defaults are those of the shipped experiments."""

    mirror: Mirror = Mirror()
    """The hyperboloid mirror."""
    camera: Camera = Camera()
    """The perspective camera that looks up at it."""
    lens: Lens = Lens()
    """The distortion of the camera's lens."""
    field: FieldOfView = FieldOfView()
    """The cone of directions that the sensor sees."""

    @model_validator(mode="after")
    def _sees_its_field(self) -> "Sensor":
        asymptote = math.degrees(self.mirror.asymptote_rad)
        if self.field.elevation_max_deg >= asymptote - 0.01:
            raise ValueError(
                f"field.elevation_max_deg = {self.field.elevation_max_deg:g} is beyond the mirror's asymptote, "
                f"asin(a/e) = {asymptote:.2f} deg; lower it or use a mirror with a larger a_m / b_m"
            )
        rim, fold = rim_radius(self), fold_radius(self.lens)
        # Two pixels more than the rim: the corners of the outermost pixels are unprojected too.
        if rim + 2 / self.camera.focal_px >= fold:
            raise ValueError(
                f"lens: the distortion folds the image over at radius {fold:.3f} of the undistorted image, inside "
                f"the mirror's rim at {rim:.3f}; use weaker coefficients or a lower field.elevation_max_deg"
            )
        return self


def load_sensor(path: Path) -> Sensor:
    """Read a sensor file (TOML).

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    return load(Sensor, path)


def rim_radius(sensor: Sensor) -> float:
    """Undistorted radius of the mirror's rim in normalised image coordinates, `r/(z + 2e)`."""
    elevation = math.radians(sensor.field.elevation_max_deg)
    x, _, z = point_on_mirror(sensor.mirror, [math.cos(elevation), 0.0, math.sin(elevation)])
    return float(x / (z + 2 * sensor.mirror.e_m))


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
    camera = sensor.camera
    p = point_on_mirror(sensor.mirror, directions)
    with np.errstate(invalid="ignore"):
        normalised = p[..., :2] / (p[..., 2:] + 2 * sensor.mirror.e_m)
        inside_fold = np.hypot(normalised[..., 0], normalised[..., 1]) <= fold_radius(sensor.lens)
        bent = distort(sensor.lens, normalised)
        scale = [camera.focal_px, camera.focal_px * camera.aspect]
        pixels = np.where(inside_fold[..., None], bent * scale + [camera.cx_px, camera.cy_px], np.nan)
        valid = in_field(sensor, directions) & on_image(sensor, pixels)
    return pixels, valid


def unproject(sensor: Sensor, pixels: ArrayLike) -> tuple[Array, np.ndarray]:
    """Direction from the effective viewpoint that a pixel sees.

    Closed form but for the lens, which Newton's method undoes within its fold (see `_kernels`).

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
    rays_of_pixels(u, v, _parameters(sensor), rays[0], rays[1], rays[2])
    return rays


def in_field(sensor: Sensor, directions: ArrayLike) -> np.ndarray:
    """Whether directions `[..., 3]` (any length) lie in the cone that the sensor sees."""
    directions = np.asarray(directions, dtype=np.float64)
    lowest, highest = np.sin(np.radians([sensor.field.elevation_min_deg, sensor.field.elevation_max_deg]))
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = directions[..., 2] / np.linalg.norm(directions, axis=-1)
        return (sine >= lowest) & (sine <= highest)


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


@lru_cache(maxsize=64)
def _parameters(sensor: Sensor) -> tuple[float, ...]:
    camera, mirror, lens = sensor.camera, sensor.mirror, sensor.lens
    return (
        camera.focal_px,
        camera.focal_px * camera.aspect,
        camera.cx_px,
        camera.cy_px,
        mirror.a_m,
        mirror.b_m,
        mirror.e_m,
        lens.k1,
        lens.k2,
        lens.p1,
        lens.p2,
        lens.k3,
        fold_radius(lens),
    )
