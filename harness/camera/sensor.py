"""The omnidirectional sensor: a camera model, its image, lens and field of view; `project` and `unproject`.

The camera model (`harness.camera.models`) maps directions to pixels. u runs right and v down; the centre of pixel
[v, u] is at integer (u, v).
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AliasChoices, Field, model_validator

from harness.camera._field_kernels import FieldLimits
from harness.camera._mounted_kernels import MountedCamera
from harness.camera._projection_kernels import compiled_model, differentiate_all, project_all
from harness.camera.focal_fit import fitted_focal_px
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.mask import Mask, used_pixels
from harness.camera.misalignment import Misalignment
from harness.camera.models import AnyModel, Mirror
from harness.camera.models.hyperboloid import encloses
from harness.camera.mount import Looks, Mount, camera_from_sensor, edge_of
from harness.camera.profile import AnyProfile, Profile
from harness.errors import InputError, with_article
from harness.files import path_of
from harness.geometry.angles import Array, lengths
from harness.renamed import Renaming, give_notice
from harness.spec import Spec, as_given, given_of, parse, remember

_LARGE_PX = 2_000_000
"""Pixels of an image that count as many; the directions of no more are worked out at a time."""


class Sensor(Spec):
    """An omnidirectional sensor, with one viewpoint unless its mirror is misaligned or has a profile of its own.

    The defaults are those of the shipped experiments.
    """

    model: AnyModel = Field(default=Mirror(), validation_alias=AliasChoices("model", "mirror"))
    """The camera model."""
    camera: Camera = Camera()
    """The image size and the camera matrix."""
    lens: Lens = Lens()
    """The camera's lens distortion."""
    field: FieldOfView = FieldOfView()
    """The directions that the sensor sees."""
    mount: Mount = Mount()
    """How the camera is mounted."""
    misalignment: Misalignment = Misalignment()
    """How the camera is displaced and turned against its mirror."""
    profile: AnyProfile | None = None
    """A mirror of another shape instead of the camera model: its rays follow from the law of reflection, and meet in no
    point. None for the camera model."""
    mask: Mask = None
    """Which pixels are used: the path of an 8-bit grey image of the sensor's size, white where they are; relative to
    the sensor's file. Mask the pixels that show the robot itself or the mirror's support."""

    @model_validator(mode="before")
    @classmethod
    def _notices_former_names(cls, given: Any) -> Any:
        """Warn of former names of keys in Python calls; in tables they have been replaced before."""
        if isinstance(given, Mapping) and "mirror" in given:
            give_notice([Renaming("Sensor", "mirror", "model")])
        return given

    @property
    def looks(self) -> Looks:
        """Direction of the optical axis before the sensor is tilted."""
        return self.mount.looks or self.model.looks

    @property
    def mirrored(self) -> bool:
        """Whether the image is a mirror image."""
        return self.model.mirrored if self.mount.mirrored is None else self.mount.mirrored

    @property
    def is_central(self) -> bool:
        """Whether all rays meet in one viewpoint: camera and mirror are aligned, and no profile replaces the model."""
        return self.misalignment.is_zero and self.profile is None

    @property
    def aligned(self) -> "Sensor":
        """The same sensor without its misalignment: a central one, unless its mirror has a profile."""
        return self if self.misalignment.is_zero else self.model_copy(update={"misalignment": Misalignment()})

    @model_validator(mode="after")
    def _sees_its_field(self) -> "Sensor":
        """Fill in missing values: the model's default limits of the field, and a focal length to be fitted."""
        looks = self.looks
        if self.profile is not None:
            self._check_profile(self.profile)
        if self.camera.is_open:
            self.model.refuse_unused(self.camera, self.lens)
        self.__dict__["field"] = field = self.model.filled_in(self.field, self.camera, self.lens, looks)
        if self.camera.is_open:
            focal_px = fitted_focal_px(self.model, self.camera, self.lens, field, looks, mirrored=self.mirrored)
            camera = self.camera.model_copy(update={"focal_px": focal_px})
            self.__dict__["camera"] = remember(camera, given_of(self.camera) | {"focal_px": "fit"})
        if self.profile is None:
            self.model.check(self.camera, self.lens, edge_of(field, looks))
            self._check_misalignment()
        return self

    def _check_profile(self, profile: Profile) -> None:
        if self.model != Mirror():
            raise ValueError(f"model: the mirror of [profile] takes the place of the {self.model.title}; leave one out")
        if self.camera.is_open:
            raise ValueError('camera.focal_px = "fit" needs a camera model, not a [profile]; give it in pixels')
        if 1000 * profile.camera_m <= max(0.0, self.misalignment.z_mm):
            raise ValueError(
                f"misalignment.z_mm = {self.misalignment.z_mm:g} is not below the mirror's apex; use less than "
                f"{1000 * profile.camera_m:g}"
            )

    def _check_misalignment(self) -> None:
        if self.misalignment.is_zero:
            return
        given = next(name for name in Misalignment.model_fields if getattr(self.misalignment, name))
        if not isinstance(self.model, Mirror):
            raise ValueError(  # noqa: TRY004 - the user's mistake, which pydantic collects
                f"misalignment.{given} = {getattr(self.misalignment, given):g}: {with_article(self.model.title)} "
                "has no mirror to be misaligned with; leave it out"
            )
        if encloses(self.model, self.misalignment.offset_m - [0, 0, 2 * self.model.e_m]):
            raise ValueError(
                f"misalignment: the camera centre is inside the mirror, whose apex is "
                f"{1000 * (self.model.a_m + self.model.e_m):.4g} mm from the outer focus; use smaller values"
            )

    def with_mask(self, file: str | Path) -> "Sensor":
        """The same sensor with another mask.

        Raises
        ------
        InputError
            When the file is no 8-bit grey image of the sensor's size.
        """
        masked = parse(Sensor, as_given(self) | {"mask": str(file)})
        check_mask(masked)
        return masked


def sensor_of(table: Mapping[str, Any], file: Path) -> Sensor:
    """The sensor described by a table of a file; the path of a mask is relative to the file.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    given, mask = dict(table), table.get("mask")
    if isinstance(mask, str):
        given["mask"] = str(path_of(mask, file.parent, file=file, key="mask").absolute())
    elif isinstance(mask, dict) and isinstance(mask.get("file"), str):
        given["mask"] = mask | {"file": str(path_of(mask["file"], file.parent, file=file, key="mask.file").absolute())}
    sensor = parse(Sensor, given, file=file)
    check_mask(sensor, file=file)
    return sensor


def check_mask(sensor: Sensor, file: str | Path | None = None, key: str = "mask") -> None:
    """Check that a sensor's mask can be read and has the size of its image.

    Parameters
    ----------
    file, key
        Where the mask is named, for messages.

    Raises
    ------
    InputError
        Names `file` and `key`, the mask's own file and what would be right.
    """
    try:
        used(sensor)
    except InputError as error:
        raise InputError(f"'{error.file}': {error.problem}", file=file, key=key) from error


def project(sensor: Sensor, directions: ArrayLike) -> tuple[Array, np.ndarray]:
    """The pixels of directions from the effective viewpoint, and whether the sensor sees them.

    Parameters
    ----------
    directions
        `[..., 3]` in the sensor's frame (z up), of any length.

    Returns
    -------
    pixels
        `[..., 2]`, (u, v) in pixels. Also given outside the field, within the model's domain; NaN beyond.
    valid
        `[...]`, bool: in the field of view, on the image, and nearest to a pixel that is not masked.
    """
    directions = np.asarray(directions, dtype=np.float64)
    pixels = np.empty((*directions.shape[:-1], 2))
    project_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), pixels.reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        return pixels, in_field(sensor, directions) & on_image(sensor, pixels) & not_masked(sensor, pixels)


def jacobian(sensor: Sensor, directions: ArrayLike) -> Array:
    """Derivatives of pixels by directions.

    Parameters
    ----------
    directions
        `[..., 3]` in the sensor's frame, of any length.

    Returns
    -------
    Array
        `[..., 2, 3]`, derivatives of (u, v) by (x, y, z), pixels per unit of the directions' length.
    """
    directions = np.asarray(directions, dtype=np.float64)
    out = np.empty((*directions.shape[:-1], 2, 3))
    differentiate_all(np.ascontiguousarray(directions).reshape(-1, 3), parameters_of(sensor), out.reshape(-1, 2, 3))
    return out


def pixels_per_steradian(sensor: Sensor, directions: ArrayLike) -> Array:
    """The image's pixels in a unit of solid angle `[...]`, around unit directions `[..., 3]` of the sensor's frame."""
    J = jacobian(sensor, directions)
    return np.asarray(np.linalg.norm(np.cross(J[..., 0, :], J[..., 1, :]), axis=-1))


def unproject(sensor: Sensor, pixels: ArrayLike) -> tuple[Array, np.ndarray]:
    """The directions of pixels from the effective viewpoint, and whether the sensor uses them.

    The inverse of `project`. Closed form except for lens distortion (see `harness.camera._lens_kernels`) and the
    polynomial of Kannala and Brandt, which are inverted by Newton's method.

    Parameters
    ----------
    pixels
        `[..., 2]`, (u, v), fractions allowed.

    Returns
    -------
    directions
        `[..., 3]`, unit length; NaN where the model has no inverse. Outside the field they continue smoothly, even
        beyond the rim of a mirror.
    valid
        `[...]`, bool: in the field of view (so neither beyond the rim nor in the blind disc), on the image, and
        nearest to a pixel that is not masked.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    flat = pixels.reshape(-1, 2)
    rays = rays_of(sensor, np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1]))
    with np.errstate(invalid="ignore"):
        directions = (rays / np.sqrt(np.sum(rays * rays, axis=0))).T.reshape(*pixels.shape[:-1], 3)
    return directions, in_field(sensor, directions) & on_image(sensor, pixels) & not_masked(sensor, pixels)


def rays_of(sensor: Sensor, u: Array, v: Array) -> Array:
    """Rays of many pixels, not of unit length, as three rows `[3, n]`: the fast form of `unproject`, without validity.

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
    """Whether directions `[..., 3]` (any length) lie in the sensor's field of view."""
    directions = np.asarray(directions, dtype=np.float64)
    field = field_of(sensor)
    with np.errstate(invalid="ignore", divide="ignore"):
        norm = lengths(directions)
        sine = _along(directions, field.up_x, field.up_y, field.up_z) / norm
        inside = (sine >= field.lowest) & (sine <= field.highest)
        if field.nearest > -1:
            inside &= _along(directions, field.axis_x, field.axis_y, field.axis_z) / norm >= field.nearest
        return inside


def _along(directions: Array, x: float, y: float, z: float) -> Array:
    return directions[..., 2] if (x, y, z) == (0, 0, 1) else directions @ np.array([x, y, z])


def on_image(sensor: Sensor, pixels: ArrayLike) -> np.ndarray:
    """Whether pixel coordinates `[..., 2]` lie on the image, which spans -0.5 .. width - 0.5."""
    pixels = np.asarray(pixels, dtype=np.float64)
    u, v = pixels[..., 0], pixels[..., 1]
    return (u >= -0.5) & (u <= sensor.camera.width_px - 0.5) & (v >= -0.5) & (v <= sensor.camera.height_px - 0.5)


def in_use(sensor: Sensor, directions: ArrayLike) -> np.ndarray:
    """Whether directions `[..., 3]` (any length) lie in the sensor's field of view, and not on a masked pixel.

    Unlike `valid` of `project`, True beyond the borders of the image too.
    """
    inside = in_field(sensor, directions)
    return inside if sensor.mask is None else inside & not_masked(sensor, project(sensor, directions)[0])


def used(sensor: Sensor) -> np.ndarray | None:
    """`[height, width]`, bool: the pixels that are not masked; None without a mask. Raises as `mask.used_pixels`."""
    camera = sensor.camera
    return None if sensor.mask is None else used_pixels(sensor.mask, camera.width_px, camera.height_px)


@lru_cache(maxsize=8)
def masked_pixels(sensor: Sensor) -> np.ndarray | None:
    """`[height, width]`, bool: pixels in the field that the mask hides; None where there is no mask. Read-only."""
    usable = used(sensor)
    if usable is None:
        return None
    hidden = pixel_directions(sensor.model_copy(update={"mask": None}))[1] & ~usable
    hidden.flags.writeable = False
    return np.asarray(hidden)


def not_masked(sensor: Sensor, pixels: Array) -> np.ndarray:
    """Whether the pixel nearest to each of `[..., 2]` is used; True beyond the image."""
    usable = used(sensor)
    if usable is None:
        return np.ones(pixels.shape[:-1], dtype=bool)
    outside = ~on_image(sensor, pixels)
    column, row = np.moveaxis(np.rint(np.where(outside[..., None], 0.0, pixels)).astype(np.intp), -1, 0)
    height, width = usable.shape
    return outside | usable[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]


@lru_cache(maxsize=8)
def pixel_directions(sensor: Sensor) -> tuple[Array, np.ndarray]:
    """Unit direction `[height, width, 3]` and validity `[height, width]` of every pixel centre; read-only, cached."""
    width, height = sensor.camera.width_px, sensor.camera.height_px
    planes, valid = np.empty((3, height, width)), np.empty((height, width), bool)
    for first in range(0, height, max(1, _LARGE_PX // width)):
        rows = slice(first, min(first + max(1, _LARGE_PX // width), height))
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(rows.start, rows.stop, dtype=np.float64))
        directions, valid[rows] = unproject(sensor, np.stack([u, v], axis=-1))
        planes[:, rows] = np.moveaxis(directions, -1, 0)
    planes.flags.writeable = False
    valid.flags.writeable = False
    return np.moveaxis(planes, 0, -1), valid


@lru_cache(maxsize=8)
def pixels_seen(sensor: Sensor) -> np.ndarray:
    """The validity of `pixel_directions` alone, `[height, width]`; read-only. It outlives `forget_directions`."""
    return pixel_directions(sensor)[1]


def forget_directions(sensor: Sensor) -> None:
    """Give back what `pixel_directions` keeps, 25 bytes a pixel and of all sensors, if this one's image is large."""
    if sensor.camera.width_px * sensor.camera.height_px > _LARGE_PX:
        pixel_directions.cache_clear()


def seam_px(sensor: Sensor, reach_px: int = 32) -> int:
    """Columns by which to pad an image left and right, for an operation that reaches `reach_px` pixels.

    0 unless the image is periodic in azimuth. 32 are enough for a spline's prefilter, in which what lies farther away
    has a weight of 1e-12.
    """
    return min(reach_px, sensor.camera.width_px) if sensor.model.goes_round(sensor.camera) else 0


def require_central(sensor: Sensor, file: str | Path | None = None) -> None:
    """Refuse a sensor whose camera is misaligned with its mirror, or whose mirror has a profile of its own.

    Parameters
    ----------
    file
        Where the sensor is from, for messages.

    Raises
    ------
    InputError
        Says what to use instead.
    """
    if sensor.profile is not None:
        raise InputError(
            f"the rays of {with_article(sensor.profile.title)} meet in no viewpoint, which is needed here; use "
            "the nearest central sensor: omnirange sensor FILE --central --to toml --out central.toml writes it",
            file=file,
            key="profile",
        )
    if not sensor.is_central:
        raise InputError(
            "camera and mirror are misaligned, so that rays meet in no viewpoint, which is needed here; use the "
            "central sensor that omnirange calibrate writes beside it, or one without [misalignment]: omnirange sensor "
            "FILE --central --to toml --out central.toml writes it",
            file=file,
            key="misalignment",
        )


@lru_cache(maxsize=64)
def parameters_of(sensor: Sensor) -> Any:
    """The compiled projection's parameters: the camera model's named tuple, or a `MountedCamera` around it.

    Raises
    ------
    InputError
        When camera and mirror are misaligned: directions have no single image then (see `harness.camera.reflection`).
    """
    require_central(sensor)
    model = sensor.model.parameters(sensor.camera, sensor.lens)
    R = model_from_sensor(sensor)
    return model if np.array_equal(R, np.eye(3)) else MountedCamera(*(*R.ravel().tolist(), model))


def model_from_sensor(sensor: Sensor) -> Array:
    """`[3, 3]`, orthogonal: turns directions of the sensor's frame into the camera model's own."""
    model = sensor.model
    return camera_from_sensor(model.looks, mirrored=model.mirrored).T @ lens_from_sensor(sensor)


def lens_from_sensor(sensor: Sensor) -> Array:
    """`[3, 3]`, orthogonal: turns directions of the sensor's frame into the lens's, see `camera_from_sensor`."""
    return camera_from_sensor(sensor.looks, mirrored=sensor.mirrored) @ sensor.mount.R_sensor_from_untilted.T


@lru_cache(maxsize=64)
def field_of(sensor: Sensor, margin_rad: float = 0.0) -> FieldLimits:
    """The limits of the field of view, in the form that compiled loops take.

    Parameters
    ----------
    margin_rad
        Angle by which the field is widened on all sides.
    """
    field, margin_deg = sensor.field, math.degrees(margin_rad)
    lowest, highest = field.elevation_min_deg - margin_deg, field.elevation_max_deg + margin_deg
    nearest = field.angle_max_deg + margin_deg
    up = sensor.mount.R_sensor_from_untilted[:, 2]
    axis = sensor.mount.R_sensor_from_untilted @ camera_from_sensor(sensor.looks, mirrored=sensor.mirrored)[2]
    return FieldLimits(
        # Straight up or down, rounding may make the sine larger than 1.
        float(np.sin(np.radians(lowest))) if lowest > -90 else -2.0,
        float(np.sin(np.radians(highest))) if highest < 90 else 2.0,
        float(np.cos(np.radians(nearest))) if nearest < 180 else -2.0,
        *up.tolist(),
        *axis.tolist(),
    )
