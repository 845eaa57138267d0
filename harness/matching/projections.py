"""The images that a matcher may ask for beside the panorama: from pixels to directions, and back.

All of them are in view 1's orientation, so that two views differ by the translation t alone, and none is a mirror
image: right in the scene is right in the image. The centre of pixel [row, column] is at whole numbers.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from harness.errors import InputError
from harness.geometry.angles import Array, normalise

MOST_PX = 16384
"""The most rows or columns of an image."""

Along = Literal["rows", "columns"]

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Projection(ABC):
    """The pixels of an image in v1's frame; the same for both views."""

    height_px: int
    width_px: int

    def __post_init__(self) -> None:
        for name, value in (("width", self.width_px), ("height", self.height_px)):
            if not (isinstance(value, int | np.integer) and 2 <= value <= MOST_PX):
                raise InputError(f"must be a whole number of pixels from 2 to {MOST_PX}; found {value!r}", key=name)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.height_px, self.width_px

    @property
    @abstractmethod
    def step(self) -> float:
        """Radians from a pixel to the next where pixels are widest: one pixel of disparity."""

    @property
    def wraps(self) -> tuple[bool, bool]:
        """Whether the last row is next to the first one, and the last column to the first one."""
        return False, False

    @property
    @abstractmethod
    def words(self) -> str:
        """A description for messages."""

    @abstractmethod
    def looking(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Unit directions `[..., 3]` at rows and columns, fractions allowed."""

    @abstractmethod
    def pixel_of(self, directions: ArrayLike) -> tuple[Array, Array]:
        """Row and column `[...]`, fractions, of directions `[..., 3]` of any length; NaN for one that no pixel sees."""

    @property
    def directions(self) -> Array:
        """`[height, width, 3]`: the unit vector towards each pixel, in v1's frame; read-only."""
        return _directions(self)

    def shifted_alpha_2(self, shift_px: Array) -> Array:
        """alpha_2, radians `[height, width]`, of matches in view 2 that lie `shift_px` columns to the left.

        Raises
        ------
        InputError
            When the rows of the image are no epipolar curves.
        """
        del shift_px
        raise InputError(f"{self.words} has no epipolar curves along its rows or columns; answer another quantity")


@lru_cache(maxsize=8)
def _directions(projection: Projection) -> Array:
    rows, columns = np.arange(projection.height_px)[:, None], np.arange(projection.width_px)[None, :]
    looking = projection.looking(rows, columns)
    looking.flags.writeable = False
    return looking


@dataclass(frozen=True)
class Equirectangular(Projection):
    """Columns are azimuths and rows elevations, both in even steps.

    Azimuth falls from pi at the left edge to -pi at the right edge, as a person sees it from inside: view 1's x axis is
    in the middle, its y axis a quarter of the width to the left.
    """

    top: float = math.pi / 2
    """Elevation of the upper edge, radians."""
    bottom: float = -math.pi / 2

    def __post_init__(self) -> None:
        if not -math.pi / 2 <= self.bottom < self.top <= math.pi / 2:
            raise InputError("the elevations of the edges must lie within -90 .. 90 degrees, the upper above the lower")
        super().__post_init__()

    @property
    def step(self) -> float:
        """Radians from a column to the next."""
        return 2 * math.pi / self.width_px

    @property
    def row_step(self) -> float:
        """Radians from a row to the next."""
        return (self.top - self.bottom) / self.height_px

    @property
    def wraps(self) -> tuple[bool, bool]:
        """Columns wrap, rows do not."""
        return False, True

    @property
    def words(self) -> str:
        """A description for messages."""
        return f"an equirectangular image of {self.height_px} x {self.width_px} pixels"

    def looking(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Unit directions `[..., 3]` at rows and columns, fractions allowed."""
        azimuth = math.pi - (np.asarray(column, dtype=np.float64) + 0.5) * self.step
        elevation = self.top - (np.asarray(row, dtype=np.float64) + 0.5) * self.row_step
        level = np.cos(elevation)
        parts = level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)
        return np.stack(np.broadcast_arrays(*parts), axis=-1)

    def pixel_of(self, directions: ArrayLike) -> tuple[Array, Array]:
        """Row and column of directions; rows are also given above and below the image."""
        x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
        row = (self.top - np.arctan2(z, np.hypot(x, y))) / self.row_step - 0.5
        return row, (math.pi - np.arctan2(y, x)) / self.step - 0.5


@dataclass(frozen=True)
class Rectified(Projection):
    """Longitude and latitude about the baseline, which OpenCV calls LONGLATI: corresponding points share a row, or a
    column.

    Along a row (or down a column) the angle to -t, `theta = pi - alpha`, runs from 0 to 180 degrees, so that a point
    moves to the left (or up) from view 1 to view 2, by the angle `alpha_2 - alpha_1` wherever it is. Across them the
    half planes around the baseline follow in the same step, once around; what lies below the baseline, or before a
    baseline that is steep, is in the middle.
    """

    t_v1: Vector = (1.0, 0.0, 0.0)
    """Viewpoint 2 in v1's frame."""
    along: Along = "rows"
    """Whether rows or columns are epipolar curves."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.along not in ("rows", "columns"):
            raise InputError(f"must be 'rows' or 'columns'; found {self.along!r}", key="along")

    @property
    def step(self) -> float:
        """Radians from a pixel to the next, the same along and across."""
        return 2 * math.pi / (self.height_px if self.along == "rows" else self.width_px)

    @property
    def wraps(self) -> tuple[bool, bool]:
        """The axis along which the half planes follow each other wraps."""
        return self.along == "rows", self.along == "columns"

    @property
    def words(self) -> str:
        """A description for messages."""
        return f"a rectified image of {self.height_px} x {self.width_px} pixels, its {self.along} along the baseline"

    @cached_property
    def axes(self) -> Array:
        """`[3, 3]`, rows: t, the direction of the half plane in the middle, and the third of a right-handed frame."""
        t = normalise(self.t_v1)
        steep = abs(t[2]) > np.hypot(t[0], t[1])
        reference = np.array([1.0, 0.0, 0.0]) if steep else np.array([0.0, 0.0, -1.0])
        middle = normalise(reference - (reference @ t) * t)
        return np.stack([t, middle, np.cross(t, middle)])

    @property
    def _turn(self) -> float:
        """The sense in which half planes follow each other around the baseline: the one without a mirror image."""
        return -1.0 if self.along == "rows" else 1.0

    def looking(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Unit directions `[..., 3]` at rows and columns, fractions allowed."""
        down, right = np.asarray(row, dtype=np.float64), np.asarray(column, dtype=np.float64)
        along, across = (right, down) if self.along == "rows" else (down, right)
        theta = (along + 0.5) * self.step
        around = self._turn * ((across + 0.5) * self.step - math.pi)
        parts = -np.cos(theta), np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around)
        return np.stack(np.broadcast_arrays(*parts), axis=-1) @ self.axes

    def pixel_of(self, directions: ArrayLike) -> tuple[Array, Array]:
        """Row and column of directions; every direction has one."""
        x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64) @ self.axes.T, -1, 0)
        along = np.arctan2(np.hypot(y, z), -x) / self.step - 0.5
        across = (self._turn * np.arctan2(z, y) + math.pi) / self.step - 0.5
        return (across, along) if self.along == "rows" else (along, across)

    def shifted_alpha_2(self, shift_px: Array) -> Array:
        """alpha_2, radians, of matches in view 2 that lie `shift_px` pixels to the left, or up."""
        size = self.width_px if self.along == "rows" else self.height_px
        alpha = math.pi - (np.arange(size) + 0.5) * self.step
        return (alpha[None, :] if self.along == "rows" else alpha[:, None]) + shift_px * self.step


@dataclass(frozen=True)
class Perspective(Projection):
    """A pinhole image, as of an undistorted camera: x to the right, y down, z into the picture."""

    focal_px: float = 1.0
    right: Vector = (0.0, -1.0, 0.0)
    down: Vector = (0.0, 0.0, -1.0)
    forward: Vector = (1.0, 0.0, 0.0)
    """The camera's axes in v1's frame."""
    rectified: bool = False
    """Whether x is along t: rows are epipolar curves then, and a point moves by `f |t|/z` columns to the left."""

    @property
    def step(self) -> float:
        """Radians from a pixel to the next in the middle."""
        return 1 / self.focal_px

    @property
    def words(self) -> str:
        """A description for messages."""
        return f"a perspective image of {self.height_px} x {self.width_px} pixels"

    @cached_property
    def axes(self) -> Array:
        """`[3, 3]`, rows: right, down and forward, in v1's frame."""
        return np.array([self.right, self.down, self.forward])

    @property
    def centre(self) -> tuple[float, float]:
        """Row and column of the principal point, the middle of the image."""
        return (self.height_px - 1) / 2, (self.width_px - 1) / 2

    def looking(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Unit directions `[..., 3]` at rows and columns, fractions allowed."""
        cy, cx = self.centre
        x = (np.asarray(column, dtype=np.float64) - cx) / self.focal_px
        y = (np.asarray(row, dtype=np.float64) - cy) / self.focal_px
        return normalise(np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1) @ self.axes)

    def pixel_of(self, directions: ArrayLike) -> tuple[Array, Array]:
        """Row and column of directions; NaN behind the camera."""
        x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64) @ self.axes.T, -1, 0)
        before = np.where(z > 0, z, np.nan)
        cy, cx = self.centre
        return self.focal_px * y / before + cy, self.focal_px * x / before + cx

    def shifted_alpha_2(self, shift_px: Array) -> Array:
        """alpha_2, radians, of matches in view 2 that lie `shift_px` columns to the left.

        Raises
        ------
        InputError
            When x is not along t.
        """
        if not self.rectified:
            return super().shifted_alpha_2(shift_px)
        cy, cx = self.centre
        x = (np.arange(self.width_px)[None, :] - shift_px - cx) / self.focal_px
        y = ((np.arange(self.height_px) - cy) / self.focal_px)[:, None]
        return np.asarray(np.arctan2(np.hypot(y, 1.0), x))


def perspective(
    width_px: int, height_px: int, fov_deg: float, azimuth_deg: float | None, elevation_deg: float, t_v1: Array | None
) -> Perspective:
    """A pinhole camera that looks in a direction.

    Parameters
    ----------
    fov_deg
        Between the left and the right edge, degrees.
    azimuth_deg, elevation_deg
        Of the optical axis, degrees. Azimuth None: to the left of t (along x where t is vertical).
    t_v1
        Turn the camera so that its x axis is along t, and its optical axis at a right angle to t, as near to the
        direction as that allows: to the right of t the picture is upside down. None to keep its x axis level.

    Raises
    ------
    InputError
        When the field is not within 1 .. 170 degrees, or the direction leaves the camera's turn open.
    """
    if not 1 <= fov_deg <= 170:
        raise InputError(f"must lie within 1 .. 170 degrees; found {fov_deg:g}", key="fov_deg")
    if azimuth_deg is None:
        x, y = (0.0, 0.0) if t_v1 is None else (t_v1[0], t_v1[1])
        vertical = t_v1 is None or np.hypot(x, y) < 1e-9 * np.linalg.norm(t_v1)
        azimuth_deg = 0.0 if vertical else math.degrees(math.atan2(y, x)) + 90
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    towards = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    if t_v1 is None:
        right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
        forward = towards
    else:
        right = normalise(t_v1)
        across = towards - (towards @ right) * right
        if np.linalg.norm(across) < 1e-3:
            raise InputError(
                "the camera would look along the baseline, where there is no disparity; look in another direction",
                key="azimuth_deg",
            )
        forward = normalise(across)
    focal_px = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
    down = np.cross(forward, right)
    return Perspective(
        height_px, width_px, focal_px, _vector(right), _vector(down), _vector(forward), rectified=t_v1 is not None
    )


def _vector(array: Array) -> Vector:
    x, y, z = (float(each) for each in array)
    return x, y, z
