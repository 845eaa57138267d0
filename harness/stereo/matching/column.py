"""Windows whose columns follow the epipolar map: the same comparison, at a cost that the window's size does not change.

Both panoramas have one orientation, so that only t is left between them. Let u be a column's azimuth from that of t,
counted to either side, 0 < u < pi. A point seen in this column appears in view 2 farther from t, at u + w, and
`z_2 = (sin(u + w) z_1 - (t_z/|t_xy|) sin w)/sin u`: for one column and one sample, w = k times the pitch, the map from
rows to rows is affine. A window of this matcher is a square of view 1 of which every column is moved by the same k
samples away from t, and stretched by its own map: what the epipolar geometry does to a patch of one disparity. So the
difference of two pixels belongs to (row, column, k) alone, a window's cost is the sum of a box of them, and box sums
along columns and rows are running sums.

Columns to both sides of t move to both sides, as they do for a camera that moves between them; a window across that
border is no exception, each of its columns follows its own map.

Sums are exact. Grey levels are rounded to eighths, so that differences are whole numbers and no running sum drifts or
depends on where it began, nor on the number of threads. A difference where one of the two pixels is not there weighs
more than any whole window: such a window is known by its cost.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.angles import Array, wrap_angle
from harness.stereo.epipolar import Curves
from harness.stereo.matching import _kernels
from harness.stereo.matching.centres import searchable, window_centres
from harness.stereo.matching.window_settings import WholePixelMatches, WindowMatcher
from harness.stereo.panorama import Panorama

PER_GREY = 8
"""Steps in a grey level: the rounding's error, 0.04 grey levels RMS, is far below the noise of any camera."""

_LARGEST = 2047
"""Largest whole number of a pixel, 255.9 grey levels: any 8-bit image, and the Laplacian of Gaussian of any, fits."""

_NO_PIXEL_1, _NO_PIXEL_2 = 16384, -32768
"""Stand for a missing pixel of view 1 and view 2: farther from each other and from any pixel than two pixels can be."""

Integers = NDArray[np.signedinteger]


def search(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, threads: int
) -> WholePixelMatches:
    """The best sample of every pixel's curve; `threads` deals out bands of columns.

    `Reason.CURVE_LEAVES_IMAGE`: one of the samples has no whole window. What lies between samples is not looked at.
    """
    grid = first.grid
    searched, reason = searchable(curves, window_centres(first, matcher.window_px))
    k = np.zeros(grid.shape, dtype=np.int32)
    costs = np.empty((*grid.shape, 2 * matcher.neighbours + 1))
    match_band = _comparison(first, second, curves, matcher)

    # The columns before and after a band enter its windows too, so bands are few; yet more than threads, to even out.
    bands = min(2 * threads, max(1, grid.width_px // (4 * matcher.window_px)))
    edges = np.linspace(0, grid.width_px, bands + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda a, b: match_band(a, b, searched, reason, k, costs), edges[:-1], edges[1:]))
    return WholePixelMatches(curves, k, costs, reason)


def costs_along_curve(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs; NaN where there is no whole window."""
    searched, reason = searchable(curves, window_centres(first, matcher.window_px))
    k, costs = np.zeros(searched.shape, np.int32), np.empty((*searched.shape, 2 * matcher.neighbours + 1))
    k_0, all_costs = _comparison(first, second, curves, matcher)(column, column + 1, searched, reason, k, costs)
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    return ks, all_costs[ks - k_0, row]


def _comparison(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher
) -> Callable[..., tuple[int, Array]]:
    """The kernel with all its arguments but the band of columns, and the arrays that it reads and writes for a pixel.

    What it returns are the costs in the band's last column `[samples, height]`, and the number of the first sample.
    """
    parts, half = matcher.samples_per_column, matcher.window_px // 2
    maps = _maps(curves, parts, matcher.neighbours)
    rows = _rows(maps, half)
    image_1, image_2 = _first_image(first), _second_image(second, parts)
    squared = matcher.cost == "ssd"
    unit = float(PER_GREY) ** (2 if squared else 1)
    # One more than the cost of any whole window; a window has no more of them than pixels.
    absent = matcher.window_px**2 * (2 * _LARGEST) ** (2 if squared else 1) + 1
    number = np.int32 if matcher.window_px**2 * absent < 2**31 else np.int64

    def match_band(
        column_first: int,
        column_end: int,
        searched: NDArray[np.bool_],
        reason: NDArray[np.uint8],
        k: NDArray[np.int32],
        costs: Array,
    ) -> tuple[int, Array]:
        shape = (maps.gain.shape[1], first.grid.height_px)
        total, sums = np.zeros((2, *shape), dtype=number)
        _kernels.match_columns(
            column_first,
            column_end,
            image_1,
            image_2,
            parts,
            half,
            squared,
            unit,
            number(absent),
            maps.k_0,
            maps.sign,
            maps.gain,
            maps.offset,
            maps.image_first,
            maps.image_end,
            rows.centre_first,
            rows.centre_end,
            rows.first,
            rows.end,
            maps.k_first,
            maps.k_last,
            searched,
            total,
            np.empty((matcher.window_px, *shape), dtype=np.int16),
            sums,
            matcher.neighbours,
            reason,
            k,
            costs,
        )
        return maps.k_0, np.where(sums < absent, sums / unit, np.nan)

    return match_band


# -- Geometry: depends on the pose and the limits alone, and is kept for the next pair of images ----------------------


@dataclass(frozen=True, eq=False)
class _Maps:
    """Where the rows of every column go, for every sample that is searched, or beside one that is."""

    k_0: int
    """The sample that comes first in the arrays below."""
    sign: Integers
    """`[width]`: 1 where phi grows along the curves, -1 where it falls."""
    gain: Integers
    offset: Integers
    """`[width, samples]`: row_2 = (gain row_1 + offset)/2^16. Modulo 2^32: right where row_2 is in the image."""
    image_first: Integers
    image_end: Integers
    """`[width, samples]`, half-open: the rows of view 1 that are mapped into view 2's image."""
    searched_first: Integers
    searched_end: Integers
    """`[width, samples]`, half-open: the rows in which the sample is searched, or one up to `reach` beside it."""
    k_first: Integers
    k_last: Integers
    """`[width, height]`: the curves' search intervals."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows to work on; all `[width, samples]`, half-open."""

    centre_first: Integers
    centre_end: Integers
    """Centres of windows that are compared."""
    first: Integers
    end: Integers
    """Pixels of all windows that the column is part of."""


@lru_cache(maxsize=4)
def _maps(curves: Curves, parts: int, reach: int) -> _Maps:
    grid, t = curves.grid, curves.t
    searched = curves.k_last >= curves.k_first
    k_0 = int(curves.k_first[searched].min(initial=0)) - reach
    k = np.arange(k_0, int(curves.k_last[searched].max(initial=0)) + reach + 1)

    u = np.abs(wrap_angle(grid.phi - np.arctan2(t[1], t[0])))[:, None]
    w = k * (grid.phi_pitch / parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.sin(u + w) / np.sin(u)
        h = -t[2] / np.hypot(t[0], t[1]) * np.sin(w) / np.sin(u)
    # z_2 = g z_1 + h with z = z_max - (row + 1/2) z_pitch on both sides.
    shift = ((1 - g) * grid.z_max - h) / grid.z_pitch + (g - 1) / 2
    # Between t and -t, and short of a stretch beyond which no two rows of an image stay within it.
    follows = (u + w > 0) & (u + w < np.pi) & (g < grid.height_px) & (np.abs(shift) < grid.height_px**2)
    unit = 1 << _kernels.FRACTION_BITS
    gain = np.rint(np.where(follows, g, 1) * unit).astype(np.int64)
    offset = np.rint(np.where(follows, shift, 0) * unit).astype(np.int64)
    follows &= gain > 0
    gain = np.maximum(gain, 1)
    image_first = np.clip(-(offset // gain), 0, grid.height_px)
    image_end = np.clip(((grid.height_px - 1) * unit - offset) // gain + 1, image_first, grid.height_px)
    image_end = np.where(follows, image_end, image_first)

    k_first, k_last = _columns(curves.k_first), _columns(curves.k_last)
    first, end = np.full_like(gain, grid.height_px), np.zeros_like(gain)
    _kernels.rows_of_samples(k_first, k_last, k_0, reach, first, end)
    sign = np.where(curves.step[0] < 0, -1, 1)
    # Casting keeps the lower 32 bits, which is what the kernel computes with.
    gain, offset, image_first, image_end = (a.astype(np.int32) for a in (gain, offset, image_first, image_end))
    return _Maps(k_0, sign, gain, offset, image_first, image_end, first, end, k_first, k_last)


@lru_cache(maxsize=8)
def _rows(maps: _Maps, half: int) -> _Rows:
    height = maps.k_first.shape[1]
    centre_first = np.maximum(maps.searched_first, half)
    centre_end = np.minimum(maps.searched_end, height - half)
    none = centre_first >= centre_end
    centre_first[none], centre_end[none] = height, 0
    first = ndimage.minimum_filter1d(centre_first, 2 * half + 1, axis=0, mode="wrap") - half
    end = ndimage.maximum_filter1d(centre_end, 2 * half + 1, axis=0, mode="wrap") + half
    first[end == half] = height  # no window at all
    return _Rows(centre_first, centre_end, first, end)


# -- Images: whole numbers, one column after the other ---------------------------------------------------------------


def _first_image(panorama: Panorama) -> Integers:
    """`[width, height]`."""
    return _columns(np.where(panorama.valid, _quantised(panorama.values), _NO_PIXEL_1).astype(np.int16))


def _second_image(panorama: Panorama, parts: int) -> Integers:
    """`[width parts, height]`: a pixel in the upper 16 bits, the step to the next row in the lower ones.

    Between columns the image is interpolated linearly. A place between two rows is there if both of them are.
    """
    values, valid = panorama.values, panorama.valid
    if parts > 1:
        weight = np.arange(parts) / parts
        next_values, next_valid = (np.roll(a, -1, axis=1)[..., None] for a in (values, valid))
        between = values[..., None] * (1 - weight) + next_values * weight
        pixels = _quantised(between.reshape(len(values), -1))
        valid = (valid[..., None] & (next_valid | (weight == 0))).reshape(len(valid), -1)
    else:
        pixels = _quantised(values)
    steps = np.diff(pixels, axis=0, append=pixels[-1:])
    both = valid & np.concatenate([valid[1:], valid[-1:]])
    return _columns(np.where(both, pixels << 16 | steps & 0xFFFF, np.int32(_NO_PIXEL_2 << 16)))


def _quantised(values: NDArray[np.floating]) -> NDArray[np.int32]:
    return np.rint(np.clip(values * PER_GREY, -_LARGEST, _LARGEST)).astype(np.int32)


def _columns(image: Integers) -> Integers:
    return np.ascontiguousarray(image.T)
