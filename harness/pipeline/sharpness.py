"""The sharpness of two photographs, relative and absolute, and its equalisation.

Least squares takes what one view shows sharply and the other does not for a difference of the two: it loses three
quarters of the matches where one is blurred by a pixel more, and all of them at two. So the sharper one is blurred by
as much. How much follows from the energy in two neighbouring bands of frequency: as much that both views have the same
ratio of fine to coarse energy in the same directions. What is there need not be matched for that, as long as both
views see about the same.

Where both are soft, images of half the size hold as much, with less noise, and least squares finds the way from farther
off: what has no match at full size may have one there.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.binning import binned, binned_sensor
from harness.camera.fill import nearest_known
from harness.camera.sensor import Sensor, jacobian, pixels_seen, project
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, directions, row_bands
from harness.geometry.pose import Motion
from harness.matching.interface import Matches, Reason
from harness.matching.pair import Pair

LEAST_BLUR_PX = 0.6
"""Differences below this are left alone: parallax alone makes 0.4 px of them, and matching hardly minds."""
SOFT = -0.5
"""Level below which a photograph counts as soft: that of a blur of 1 px, or of a scene that has little detail."""
FEW = 0.5
"""Share of the panorama below which matches are few."""
LEAST_SIDE_PX = 480
"""The shorter side of images that may be made smaller."""
_FINE, _MIDDLE, _COARSE = 0.8, 1.6, 3.2
"""Standard deviations of the Gaussians whose differences are the two bands, pixels."""
_ALIKE = 0.15
"""Levels closer than this are those of images that are equally sharp."""
_BLURS = np.array([0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0])
_BLOCKS = 2, 8
_SAME_SCALE = 1.1
"""Largest ratio of the views' pixels per radian at which blurs are comparable."""

Image = NDArray[np.float32]


@dataclass(frozen=True, repr=False)
class Sharpness(OneLine):
    """The sharpness of two views."""

    levels: tuple[Array, Array]
    """`[2, 8]` each, over rows and columns of the panorama: logarithm of fine over coarse energy. About 0 for a sharp
    image of any scene with detail at all scales; -0.6 and -1.4 with a blur of 1 and of 2 px."""
    added_px: tuple[float, float]
    """Standard deviation of the Gaussian that makes a view as soft as the other one; 0 for the softer one."""

    @property
    def level(self) -> float:
        """The level of the sharper view."""
        return max(_median(each) for each in self.levels)

    def lines(self) -> list[str]:
        """The applied blur in plain words, one line for each blurred view."""
        return [
            f"sharpness: view {view + 1} is sharper; it was blurred by {blur_px:.2g} px to match"
            for view, blur_px in enumerate(self.added_px)
            if blur_px
        ]

    def summary(self) -> dict[str, Any]:
        """The figures as plain values."""
        return {
            "level_1": _median(self.levels[0]),
            "level_2": _median(self.levels[1]),
            "blur_added_1_px": self.added_px[0],
            "blur_added_2_px": self.added_px[1],
        }


def compare_sharpness(
    images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], motion: Motion, grid: Grid
) -> Sharpness:
    """Estimate how much sharper one view is than the other, over the panorama."""
    views = list(zip(images, sensors, (np.eye(3), motion.R_v2_from_v1), strict=True))
    levels = [_levels(*each, grid, 0.0) for each in views]
    difference = _median(levels[0] - levels[1])
    if not abs(difference) > _ALIKE or not _same_scale(sensors, motion, grid):
        return Sharpness((levels[0], levels[1]), (0.0, 0.0))
    sharper = 0 if difference > 0 else 1
    curve = np.stack([levels[sharper], *(_levels(*views[sharper], grid, each) for each in _BLURS[1:])])
    target = levels[1 - sharper]
    squares = [
        np.interp(-target[block], -curve[(slice(None), *block)], _BLURS**2)
        for block in np.ndindex(target.shape)
        if np.isfinite(curve[(slice(None), *block)]).all() and np.isfinite(target[block])
    ]
    blur = float(np.sqrt(np.median(squares)))
    if blur < LEAST_BLUR_PX:
        return Sharpness((levels[0], levels[1]), (0.0, 0.0))
    return Sharpness((levels[0], levels[1]), (blur, 0.0) if sharper == 0 else (0.0, blur))


def equalised(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], sharpness: Sharpness) -> tuple[Image, Image]:
    """Both images equally sharp; the arrays themselves if they are already."""
    first, second = (
        image if blur_px == 0 else _blurred(image, sensor, blur_px)
        for image, sensor, blur_px in zip(images, sensors, sharpness.added_px, strict=True)
    )
    return first, second


def has_few_matches(sharpness: Sharpness, density: float, images: tuple[Image, Image]) -> bool:
    """Whether images of half the size are worth a try: they are soft, and few pixels have a match."""
    smallest = min(min(each.shape) for each in images)
    return density < FEW and sharpness.level < SOFT and smallest >= LEAST_SIDE_PX


def half_size(pair: Pair) -> Pair:
    """The pair at half the size, of means over 2 x 2 pixels."""
    first, second = (binned(image, sensor, 2) for image, sensor in zip(pair.images, pair.sensors, strict=True))
    sensors = binned_sensor(pair.sensors[0], 2), binned_sensor(pair.sensors[1], 2)
    return Pair((first, second), sensors, pair.motion, pair.grid)


def filled(matches: Matches, others: Matches) -> Matches:
    """Matches, with missing ones filled in from others."""
    missing = (matches.reasons != Reason.MATCHED) & (others.reasons == Reason.MATCHED)

    def both(name: str) -> Any:
        one, other = getattr(matches, name), getattr(others, name)
        return None if one is None or other is None else np.where(missing, other, one)

    return replace(
        matches,
        alpha_2=both("alpha_2"),
        confidence=both("confidence"),
        sigma_alpha_2=both("sigma_alpha_2"),
        reason=np.where(missing, np.uint8(Reason.MATCHED), matches.reasons),
        refined=both("refined"),
        k=both("k"),
    )


def _blurred(image: Image, sensor: Sensor, blur_px: float) -> Image:
    """The image smoothed by a Gaussian; gaps stay gaps, and neither they nor invisible pixels contribute."""
    finite = np.isfinite(image)
    known = pixels_seen(sensor) & finite
    smooth = ndimage.gaussian_filter(image[nearest_known(known)], blur_px, mode="nearest")
    smooth = np.where(finite, smooth, np.float32(np.nan))
    smooth.flags.writeable = False
    return smooth


def _levels(image: Image, sensor: Sensor, R: Array, grid: Grid, blur_px: float) -> Array:
    """Levels of one view `[2, 8]`, NaN in blocks that it hardly sees; with a blur added."""
    known = pixels_seen(sensor) & np.isfinite(image)
    filled = image[nearest_known(known)]
    smooth = [ndimage.gaussian_filter(filled, np.hypot(each, blur_px)) for each in (_FINE, _MIDDLE, _COARSE)]
    inside = ndimage.binary_erosion(known, iterations=round(2 * _COARSE))
    differences = [a - b for a, b in pairwise(smooth)]
    del filled, smooth
    usable, bands = np.empty(grid.shape, bool), np.empty((2, *grid.shape), np.float32)
    for rows in row_bands(grid):
        pixels, valid = project(sensor, directions(grid)[rows] @ R.T)
        column, row = np.moveaxis(np.rint(np.where(valid[..., None], pixels, 0)).astype(np.intp), -1, 0)
        row, column = np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)
        usable[rows] = valid & inside[row, column]
        bands[:, rows] = [np.where(usable[rows], each[row, column] ** 2, 0.0) for each in differences]
    fine, coarse, share = (_block_means(each) for each in (*bands, usable.astype(np.float64)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(share > 0.2, np.log(fine / coarse), np.nan)


def _block_means(values: NDArray[np.floating]) -> Array:
    rows, columns = (np.array_split(np.arange(size), count) for size, count in zip(values.shape, _BLOCKS, strict=True))
    return np.array([[values[np.ix_(row, column)].mean() for column in columns] for row in rows])


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def _same_scale(sensors: tuple[Sensor, Sensor], motion: Motion, grid: Grid) -> bool:
    """Whether pixels of both views span about the same angle."""
    if sensors[0] == sensors[1]:
        return True
    x = directions(grid)[::8, ::8].reshape(-1, 3)
    scales = [
        np.nanmedian(np.linalg.norm(jacobian(sensor, x @ R.T), axis=(1, 2)))
        for sensor, R in zip(sensors, (np.eye(3), motion.R_v2_from_v1), strict=True)
    ]
    return bool(max(scales) < _SAME_SCALE * min(scales))
