"""The corners of boards in images: the data of a calibration."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.spec import Positive, Spec

Count = Annotated[int, Field(ge=2, le=200)]

_LEAST_PX, _MOST_PX = 8, 16384
"""Sides of images, as `Camera` allows them."""
_LEAST_M, _MOST_M = 1e-4, 1e4
"""Extents of boards."""


class Board(Spec):
    """A chessboard, described by its inner corners, where four squares meet."""

    columns: Count
    """Inner corners along the board's x."""
    rows: Count
    """Inner corners along the board's y."""
    square_m: Positive
    """Side of a square, metres."""

    @property
    def points_m(self) -> Array:
        """The corners `[rows * columns, 2]` in the board's plane, metres: x runs fastest, the first one is (0, 0)."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return self.square_m * np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)


@dataclass(frozen=True, repr=False, eq=False)
class Corners(OneLine):
    """Corners detected in images, sorted by image: one planar board per image, in any pose."""

    images: tuple[str, ...]
    """Names of the `n` images, each of which has corners."""
    image: NDArray[np.intp]
    """`[m]`: index into `images`, ascending."""
    points_m: Array
    """`[m, 2]`: (x, y) in the plane of the board, metres."""
    pixels: Array
    """`[m, 2]`: (u, v), pixels."""
    width_px: int
    height_px: int
    """Size of the images, pixels."""

    @property
    def starts(self) -> NDArray[np.intp]:
        """`[n]`: index of the first corner of each image."""
        return np.searchsorted(self.image, np.arange(len(self.images)))

    def of(self, chosen: Sequence[int]) -> "Corners":
        """The corners of some of the images, by their indices, ascending."""
        keep = np.isin(self.image, chosen)
        index = np.searchsorted(np.asarray(chosen), self.image[keep])
        names = tuple(self.images[each] for each in chosen)
        return Corners(names, index, self.points_m[keep], self.pixels[keep], self.width_px, self.height_px)

    def where(self, keep: NDArray[np.bool_]) -> "Corners":
        """The corners selected by a mask `[m]`; an image without any is dropped."""
        left = np.unique(self.image[keep])
        index = np.searchsorted(left, self.image[keep])
        names = tuple(self.images[each] for each in left)
        return Corners(names, index, self.points_m[keep], self.pixels[keep], self.width_px, self.height_px)


def check_size(size: tuple[int, int], *, file: str | None = None) -> None:
    """Check the width and height of images, pixels.

    Raises
    ------
    InputError
        When no camera has such a size; the error names the file or option.
    """
    if not all(_LEAST_PX <= each <= _MOST_PX for each in size):
        raise InputError(
            f"images of {size[0]} x {size[1]} pixels; sides must be {_LEAST_PX} to {_MOST_PX} pixels long", file=file
        )


def corners_of(
    views: Sequence[tuple[str, Array, Array]], width_px: int, height_px: int, *, file: str | None = None
) -> Corners:
    """Corners from (name, points on the board `[k, 2]`, pixels `[k, 2]`) of each image.

    Raises
    ------
    InputError
        When images are too small or too large, or one has fewer than 6 corners, all of them collinear, or a corner is
        not finite or outside the image, or a board's extent is not one of 0.1 mm to 10 km.
    """
    check_size((width_px, height_px), file=file)
    if not views:
        raise InputError("contains no corners", file=file)
    for name, points, pixels in views:
        if len(points) != len(pixels) or len(points) < 6:
            raise InputError(f"image '{name}' has {len(points)} corners; a board needs at least 6", file=file)
        if not (np.isfinite(points).all() and np.isfinite(pixels).all()):
            raise InputError(f"image '{name}' has corners that are not finite numbers", file=file)
        outside = ((pixels < -0.5) | (pixels > [width_px - 0.5, height_px - 0.5])).any(axis=-1)
        if outside.any():
            u, v = pixels[np.flatnonzero(outside)[0]].tolist()
            raise InputError(
                f"a corner of image '{name}' is at ({u:g}, {v:g}), outside an image of {width_px} x {height_px} pixels",
                file=file,
            )
        # Coordinates are halved, so that the difference of two finite ones is finite.
        extent = 2 * float(np.ptp(points / 2, axis=0).max())
        if not (_LEAST_M <= extent <= _MOST_M and np.abs(points).max() <= _MOST_M):
            raise InputError(
                f"the corners of image '{name}' span {extent:.3g} m of the board, or lie far from its origin; "
                f"give positions in metres: an extent of {_LEAST_M:g} to {_MOST_M:g}",
                file=file,
            )
        for where, positions in (("board", points), ("image", pixels)):
            if np.linalg.matrix_rank(positions - positions.mean(axis=0), tol=1e-6 * np.ptp(positions)) < 2:
                raise InputError(f"the corners of image '{name}' lie on one line of the {where}", file=file)
    return Corners(
        tuple(name for name, _, _ in views),
        np.repeat(np.arange(len(views)), [len(points) for _, points, _ in views]),
        np.concatenate([np.asarray(points, dtype=np.float64) for _, points, _ in views]),
        np.concatenate([np.asarray(pixels, dtype=np.float64) for _, _, pixels in views]),
        width_px,
        height_px,
    )
