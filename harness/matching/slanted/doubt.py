"""What least squares cannot know of a match: whether its plane is that of the pixel's own surface.

The standard deviation of a fit says how far noise moves the plane that its window shows. It knows nothing of a window
that lies across a crease or a border, on texture beside a blank place, or on nothing that the two views have in common.
Four things tell. The planes of the windows around differ, which bounds the standard deviation from below. Pixels near
by remain unexplained. What the plane was fitted to lies elsewhere. And it has left the start, which semi-global
matching found in another way. The last three are no errors by themselves; they make a large one likelier, so that such
a match is held to a narrower limit: see `factor` and `factor_by_start`.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.slanted import _doubt_kernels as _kernels
from harness.matching.slanted.field import Field, Image, Samples, View, Warp, in_rows
from harness.matching.slanted.means import means
from harness.matching.slanted.noise import Noise

_USUAL = 0.2
"""The share of the variance around a pixel that may remain unexplained before a match is doubted."""
_BY_UNEXPLAINED = 2.0
"""How fast doubt grows with that share: by e for each half. This and the next two were fitted to the logarithm of the
odds of an error above 1 px (the scenes of `benchmarks/occlusion.py`, without `--unseen`)."""
_BY_TEXTURE = 0.55
"""The power with which doubt grows as the texture around the pixel falls below the window's."""
_MOVED = 2.0
"""The doubt of a plane taken from a window beside the pixel: it is extrapolated."""
_LEFT_START = 0.6
"""How far from the start a match is doubted neither more nor less, panorama pixels; doubt is in proportion to it. This
and the next three leave as many matches as without them, and two thirds of those that are off by more than 1 px."""
_LEFT_LEAST, _LEFT_MOST = 0.25, 10.0
"""Nearer than the first the start's own error is what is seen, farther than the second nothing more is learned."""
_NO_START = 2.0
"""What counts as that distance where there is no start, panorama pixels."""
_UNLIKE = 2.0
"""By how much the residual of something else exceeds that of noise: it is the sum of two textures."""


@dataclass(frozen=True)
class Surroundings:
    """What lies around every mirror pixel; all `[height, width]`."""

    disagreement: Array
    """1/m: how far the planes around are from the pixel's own, there."""
    residual: NDArray[np.float32]
    """The residual's mean square about the pixel, grey levels squared."""
    unexplained: NDArray[np.float32]
    """The same as a share of the image's variance there, as it would be if view 1 were as noisy as view 2."""
    texture_near: Array
    """Sum of g² per squared motion over the pixel's surroundings."""
    texture: Array
    """The same over a window."""


def surroundings_of(
    field: Field, first: View, noise: Noise, samples: Samples, warp: Warp, window_px: int, pool: ThreadPoolExecutor
) -> Surroundings:
    """What lies around every pixel of a field that view 2 was sampled at."""
    shape, side = field.w.shape, 2 * (window_px // 4) + 1
    square, disagreement = np.empty(shape, np.float32), np.empty(shape)
    in_rows(
        pool, len(square), _kernels.surroundings_rows, window_px // 2, warp.x, first.image, samples.known,
        samples.value, field.plane, field.chosen, field.gain, field.offset, field.w, square, disagreement,
    )  # fmt: skip
    residual, unexplained = _residuals(first, noise, samples, square, side, pool)

    def density(over: int) -> Array:
        texture, moved = np.empty(shape), np.empty(shape)
        in_rows(pool, len(texture), _kernels.texture_rows, samples.known, samples.slope, samples.motion, texture, moved)
        means(texture, over, pool, texture)
        means(moved, over, pool, moved)
        in_rows(pool, len(texture), _kernels.divide_rows, moved, texture)
        return texture

    return Surroundings(disagreement, residual, unexplained, density(near(window_px)), density(window_px))


def _residuals(
    first: View, noise: Noise, samples: Samples, square: Image, side: int, pool: ThreadPoolExecutor
) -> tuple[Image, Image]:
    """`residual` and `unexplained` of `Surroundings`, from the residual's squares, which the former overwrites; as few
    arrays at a time as possible, which are as large as the image.
    """

    def mean(values: NDArray[np.floating]) -> Array:
        return means(values, side, pool, np.empty(values.shape))

    # Means are over all pixels of the square, known or not. A grey level's rounding is below 1. Noise that view 2 alone
    # has is left over, but no part of view 1's variance, where as much of its own would be.
    floor = noise.grey_level_squared + noise.excess_2
    count = mean(samples.known.astype(np.float32))
    image = np.where(samples.known, first.image, np.float32(0))
    variance, level = mean(np.square(image, dtype=np.float64)), mean(image)
    in_rows(pool, len(level), _kernels.variance_rows, level, count, floor, variance)
    del image, level
    residual = mean(square)
    unexplained = np.empty(square.shape, np.float32)
    in_rows(pool, len(residual), _kernels.unexplained_rows, count, variance, residual, square, unexplained)
    return square, unexplained


def unlike(field: Field, around: Surroundings) -> NDArray[np.bool_]:
    """Mirror pixels, `[height, width]`, whose surroundings view 2 does not show where their planes say: what is left is
    `_UNLIKE` times what is left in the middle of all pixels, which is noise.
    """
    there = around.residual[field.chosen >= 0]
    limit = _UNLIKE * np.nanmedian(there) if there.size else np.inf
    with np.errstate(invalid="ignore"):
        return np.asarray(around.residual > limit)


def near(window_px: int) -> int:
    """Side of a pixel's surroundings, odd: two fifths of the window's."""
    return 2 * (window_px // 5) + 1


def factor(around: Surroundings, index: NDArray[np.intp], window: NDArray[np.int32]) -> Array:
    """How many times as narrow a limit the standard deviations of pixels are held to; below 1 for none.

    Parameters
    ----------
    index
        Flat indices of the mirror pixels.
    window
        Those of the windows that they take their planes from.
    """
    unexplained = np.clip(around.unexplained.ravel()[index] - _USUAL, 0.0, 2.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        texture = around.texture_near.ravel()[index] / around.texture.ravel()[window]
        doubt = np.exp(_BY_UNEXPLAINED * unexplained) * np.clip(texture, 0.0, 2.0) ** -_BY_TEXTURE
    return np.where(window != index, _MOVED * doubt, doubt)


def factor_by_start(from_start: Array, in_common: NDArray[np.bool_]) -> Array:
    """How many times as narrow a limit pixels are held to for where the start was; multiplies `factor`.

    Parameters
    ----------
    from_start
        How far from the start they are, panorama pixels; NaN where there is none.
    in_common
        Whether the two views have anything in common in their windows. Elsewhere the start stays as it was, so that
        to agree with it is no merit.
    """
    left = np.where(np.isnan(from_start), _NO_START, np.clip(from_start, _LEFT_LEAST, _LEFT_MOST)) / _LEFT_START
    return np.where(in_common, left, np.maximum(left, 1.0))
