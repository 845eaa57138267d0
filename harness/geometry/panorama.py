"""The virtual panoramic camera: the unit cylinder and its pixels (section 2 of the paper)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from harness.display import OneLine
from harness.geometry.angles import Array, cylinder_point, normalise
from harness.spec import Spec

if TYPE_CHECKING:
    Height = float
else:
    Height = Annotated[float, Field(ge=-1000, le=1000)] | Literal["auto"]
    """Height on the unit cylinder, no unit: 1000 is a twentieth of a degree from the zenith."""


class Grid(Spec):
    """The cylinder's pixels, `[row = z, column = phi]`.

    720x200 as in the paper, which leaves the z range open. By default the pixels are square at the horizon:
    (z_max - z_min)/200 = 2 pi/720.
    """

    width_px: Annotated[int, Field(ge=16, le=16384)] = 720
    """Columns around the cylinder; one column is one pixel of disparity, 2 pi/width_px radians."""
    height_px: Annotated[int, Field(ge=3, le=16384)] = 200
    """Rows from z_max down to z_min."""
    z_max: Height = 0.34
    """Upper edge of the panorama on the unit cylinder, no unit: the tangent of the elevation; "auto" for what both
    sensors see. The default's top row, 18.6°, is the highest whose cubic taps all lie inside the default sensor's rim
    at 20°."""
    z_min: Height = -1.4053
    """Lower edge of the panorama on the unit cylinder, no unit: the tangent of the elevation; "auto" for what both
    sensors see."""

    @model_validator(mode="after")
    def _ordered(self) -> "Grid":
        heights: tuple[Any, Any] = (self.z_min, self.z_max)
        if "auto" not in heights and self.z_min >= self.z_max:
            raise ValueError("z_min must be below z_max")
        return self

    @property
    def phi_pitch(self) -> float:
        """Width of a column in radians: one pixel of disparity."""
        return 2 * np.pi / self.width_px

    @property
    def z_pitch(self) -> float:
        """Height of a row on the unit cylinder, no unit."""
        return (self.z_max - self.z_min) / self.height_px

    @property
    def phi(self) -> Array:
        """Azimuth of the column centres `[width]`, radians, ascending from -pi."""
        return np.asarray(-np.pi + (np.arange(self.width_px) + 0.5) * self.phi_pitch, dtype=np.float64)

    @property
    def z(self) -> Array:
        """Height of the row centres `[height]` on the unit cylinder, row 0 at the top."""
        return np.asarray(self.z_max - (np.arange(self.height_px) + 0.5) * self.z_pitch, dtype=np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.height_px, self.width_px


@lru_cache(maxsize=8)
def cylinder(grid: Grid) -> Array:
    """Points `x = [cos phi, sin phi, z]` at the pixel centres `[height, width, 3]`; read-only, cached."""
    points = cylinder_point(grid.phi[None, :], grid.z[:, None])
    points.flags.writeable = False
    return points


@lru_cache(maxsize=8)
def directions(grid: Grid) -> Array:
    """Unit vectors towards the pixel centres `[height, width, 3]`; read-only, cached."""
    unit = normalise(cylinder(grid))
    unit.flags.writeable = False
    return unit


def pixel_of(grid: Grid, towards: ArrayLike) -> tuple[Array, Array]:
    """Row and column `[...]` of directions `[..., 3]`, fractions; whole at the pixels' centres.

    Rows lie within -0.5 .. height - 0.5 inside the panorama, and are infinite straight up and down. Columns lie within
    -0.5 .. width - 0.5: the panorama is periodic in azimuth.
    """
    row, column = _from_the_corner(grid, towards)
    return row - 0.5, column - 0.5


def row_bands(grid: Grid) -> list[slice]:
    """The panorama's rows, 32 at a time: what is worked out for each pixel on the way may take 500 bytes."""
    return [slice(first, first + 32) for first in range(0, grid.height_px, 32)]


def pixel_that_holds(grid: Grid, towards: ArrayLike) -> tuple[Array, NDArray[np.intp], NDArray[np.bool_]]:
    """Row and column `[...]` of the pixels that directions `[..., 3]` fall on, and whether they fall on any.

    Pixels are half-open intervals of z and phi. A row that is not on the panorama is a float all the same, since it may
    be infinite: index only with those that are.
    """
    row, column = (np.floor(each) for each in _from_the_corner(grid, towards))
    return row, column.astype(np.intp) % grid.width_px, (row >= 0) & (row < grid.height_px)


def _from_the_corner(grid: Grid, towards: ArrayLike) -> tuple[Array, Array]:
    """Rows and columns, counted from the upper left corner of the upper left pixel."""
    x, y, z = np.moveaxis(np.asarray(towards, dtype=np.float64), -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        row = (grid.z_max - z / np.hypot(x, y)) / grid.z_pitch
    return row, (np.arctan2(y, x) + np.pi) / grid.phi_pitch


@dataclass(frozen=True, repr=False)
class Panorama(OneLine):
    """An image on the cylinder."""

    grid: Grid
    values: NDArray[np.float32]
    """`[height, width]`; grey levels, or a filter's response. Finite everywhere, but meaningful only where `valid`."""
    valid: NDArray[np.bool_]
    """`[height, width]`: made only of pixels that the sensor sees."""
