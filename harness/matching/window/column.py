"""Windows whose columns follow the epipolar map, compared at a cost that does not depend on the window's size.

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

1 - ZNCC is made of running sums of the pixels of view 2, their squares, and their products with view 1's. Census
transforms are those of the panoramas (of view 2 also between columns, where samples fall there), compared at the
nearest row, as bits cannot be interpolated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array, wrap_angle
from harness.geometry.epipolar import Curves
from harness.geometry.panorama import Panorama
from harness.matching import _matching_kernels
from harness.matching._vector_kernels import LANES
from harness.matching.interface import Reason
from harness.matching.window import _column_kernels
from harness.matching.window.census import census
from harness.matching.window.centres import searchable, whole_windows
from harness.matching.window.settings import WholePixelMatches, WindowMatcher
from harness.threads import in_bands

PER_GREY = 8
"""Steps in a grey level: the rounding's error, 0.04 grey levels RMS, is far below the noise of any camera."""

_LARGEST = 2047
"""Largest whole number of a pixel, 255.9 grey levels: any 8-bit image, and the Laplacian of Gaussian of any, fits."""


Integers = NDArray[np.signedinteger]


def search(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, threads: int
) -> WholePixelMatches:
    """The best sample of every pixel's curve; `threads` deals out bands of columns.

    `Reason.CURVE_LEAVES_IMAGE`: one of the samples has no whole window. What lies between samples is not looked at.
    """
    compare = _whole_samples(first, second, curves, matcher)
    searched, reason = searchable(curves, whole_windows(compare.images.valid_1, matcher.window_px))
    k = np.zeros(first.grid.shape, dtype=np.int32)
    costs = np.full((*first.grid.shape, 2 * matcher.neighbours + 1), np.nan)

    def work(column_first: int, column_end: int) -> None:
        compare(column_first, column_end, searched, reason, k, costs, before=matcher.neighbours)

    _over_columns(work, first, matcher.window_px, threads)
    return WholePixelMatches(curves, k, costs, reason)


def costs_of_half_samples(
    first: Panorama, second: Panorama, whole: WholePixelMatches, matcher: WindowMatcher, threads: int
) -> Array:
    """The costs 1.5, 1, 0.5 samples before the best one, at it, and 0.5, 1, 1.5 after it, `[height, width, 7]`.

    View 2 is interpolated between its columns, as it is for whole samples that do not fall on one.
    """
    parts, matched = matcher.samples_per_column, whole.reason == Reason.MATCHED
    maps = _maps(whole.curves, parts, 2, half=True)
    k = np.where(matched, whole.k, 0).astype(np.int32)
    # From two samples before the best one to one after it, which are half a sample late.
    searched = _searched(_columns(np.where(matched, k - 2, 1)), _columns(np.where(matched, k + 1, 0)), maps, 0)
    compare = _Comparison(matcher, _images(first, second, matcher, 2 * parts), maps, _rows(searched, matcher.window_px))
    between, reason = np.full((*first.grid.shape, 4), np.nan), whole.reason.copy()

    def work(column_first: int, column_end: int) -> None:
        compare(column_first, column_end, matched, reason, k, between, before=2, find=False)

    _over_columns(work, first, matcher.window_px, threads)
    costs = np.empty((*first.grid.shape, 7))
    costs[..., ::2] = between
    costs[..., 1::2] = whole.costs[..., matcher.neighbours - 1 : matcher.neighbours + 2]
    return costs


def costs_along_curve(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs; NaN where there is no whole window."""
    compare = _whole_samples(first, second, curves, matcher)
    searched, reason = searchable(curves, whole_windows(compare.images.valid_1, matcher.window_px))
    k, costs = np.zeros(searched.shape, np.int32), np.empty((*searched.shape, 1))
    window_costs = compare(column, column + 1, searched, reason, k, costs, before=0)
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    pixel_costs = window_costs[ks - compare.maps.k_0, row]
    return ks, np.where(pixel_costs < compare.none, pixel_costs / compare.unit, np.nan)


def _over_columns(work: Callable[[int, int], None], image: Panorama, window_px: int, threads: int) -> None:
    """Distribute the columns over threads, in few bands: columns before and after a band enter its windows too."""
    width = image.grid.width_px
    # More bands than threads, to even out.
    bands = 1 if threads == 1 else min(2 * threads, max(1, width // (4 * window_px)))
    in_bands(work, width, bands, threads)


def _whole_samples(first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher) -> "_Comparison":
    parts = matcher.samples_per_column
    maps = _maps(curves, parts, matcher.neighbours, half=False)
    searched = _searched_by(curves, maps, matcher.neighbours)
    return _Comparison(matcher, _images(first, second, matcher, parts), maps, _rows(searched, matcher.window_px))


class _Comparison:
    """The kernel with all its arguments but the band of columns, and the arrays that it reads and writes by pixels."""

    def __init__(self, matcher: WindowMatcher, images: "_Images", maps: "_Maps", rows: "_Rows") -> None:
        self.images, self.maps = images, maps
        self._rows, self._half = rows, matcher.window_px // 2
        self._kind = _matching_kernels.COSTS[matcher.cost]
        pixels, zncc = matcher.window_px**2, matcher.cost == "zncc"
        self.unit, largest, greatest_sum = {
            "sad": (float(PER_GREY), 2 * _LARGEST, 0),
            "ssd": (float(PER_GREY**2), (2 * _LARGEST) ** 2, 0),
            "zncc": (float(_column_kernels.ZNCC_UNIT), 2 * _LARGEST, pixels * _LARGEST**2),
            "census": (1.0, 32, 0),
        }[matcher.cost]
        # One more than the cost of any whole window; a window has no more of them than pixels.
        self._absent = pixels * largest + 1
        self.none = _column_kernels.NO_ZNCC if zncc else self._absent
        self._number = np.int32 if max(pixels * self._absent, greatest_sum) < 2**31 else np.int64
        self._moments = _moments(images.first, self._half) if zncc else (np.zeros((1, 1)), np.zeros((1, 1)))

    def __call__(
        self,
        column_first: int,
        column_end: int,
        searched: NDArray[np.bool_],
        reason: NDArray[np.uint8],
        k: NDArray[np.int32],
        costs: Array,
        *,
        before: int,
        find: bool = True,
    ) -> Integers:
        """Write `reason`, `k` (if they are to be found) and `costs`.

        Returns
        -------
        window_costs
            `[samples, height]`: the costs in the band's last column, in parts of `unit`; `none` or more where there is
            no whole window.
        """
        maps, rows = self.maps, self._rows
        shape = (maps.gain.shape[1], searched.shape[0] + 2 * LANES)
        total, sums = np.zeros((2, *shape), dtype=self._number)
        if self._kind == _matching_kernels.ZNCC:
            squares, products, of_squares, of_products, window_costs = np.zeros((5, *shape), dtype=self._number)
        else:
            squares, products, of_squares, of_products = np.zeros((4, 1, 1), dtype=self._number)
            window_costs = sums
        if searched.shape[0] <= 2 * self._half:
            return window_costs
        _column_kernels.match_columns(
            column_first,
            column_end,
            self._kind,
            self.images.first,
            self.images.second,
            self.images.parts,
            2 if maps.half else 1,
            1 if maps.half else 0,
            self._half,
            self.unit,
            self._number(self._absent),
            self._number(self.none),
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
            *self._moments,
            rows.searched.k_first,
            rows.searched.k_last,
            searched,
            total,
            squares,
            products,
            np.empty((2 * self._half + 1, shape[0], searched.shape[0]), dtype=np.int16),
            sums,
            of_squares,
            of_products,
            window_costs,
            before,
            find,
            reason,
            k,
            costs,
        )
        return window_costs


# -- Geometry: depends on the pose and the limits alone, and is cached for the next pair of images --------------------


@dataclass(frozen=True, eq=False)
class _Maps:
    """The maps of every column's rows into view 2, for every sample that is searched and its neighbours."""

    half: bool
    """Whether the maps are of samples k + 1/2 instead of k."""
    k_0: int
    """The first sample of the arrays below."""
    sign: Integers
    """`[width]`: 1 where phi grows along the curves, -1 where it falls."""
    gain: Integers
    offset: Integers
    """`[width, samples]`: row_2 = (gain row_1 + offset)/2^16. Modulo 2^32: right where row_2 is in the image."""
    image_first: Integers
    image_end: Integers
    """`[width, samples]`, half-open: the rows of view 1 that are mapped into view 2's image."""


@dataclass(frozen=True, eq=False)
class _Searched:
    """The samples that are searched, by pixel and by column."""

    k_first: Integers
    k_last: Integers
    """`[width, height]`."""
    first: Integers
    end: Integers
    """`[width, samples]`, half-open: the rows in which the sample is searched, or one up to `reach` beside it."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows to work on; all `[width, samples]`, half-open."""

    searched: _Searched
    centre_first: Integers
    centre_end: Integers
    """Centres of windows that are compared."""
    first: Integers
    end: Integers
    """Pixels of all windows that the column is part of."""


@lru_cache(maxsize=4)
def _maps(curves: Curves, parts: int, reach: int, *, half: bool) -> _Maps:
    grid, t = curves.grid, curves.t
    searched = curves.k_last >= curves.k_first
    k_0 = int(curves.k_first[searched].min(initial=0)) - reach
    k = np.arange(k_0, int(curves.k_last[searched].max(initial=0)) + reach + 1)

    u = np.abs(wrap_angle(grid.phi - np.arctan2(t[1], t[0])))[:, None]
    w = (k + 0.5 if half else k) * (grid.phi_pitch / parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.sin(u + w) / np.sin(u)
        h = -t[2] / np.hypot(t[0], t[1]) * np.sin(w) / np.sin(u)
    # z_2 = g z_1 + h with z = z_max - (row + 1/2) z_pitch on both sides.
    shift = ((1 - g) * grid.z_max - h) / grid.z_pitch + (g - 1) / 2
    # Between t and -t, and short of a stretch beyond which no two rows of an image stay within it.
    follows = (u + w > 0) & (u + w < np.pi) & (g < grid.height_px) & (np.abs(shift) < grid.height_px**2)
    unit = 1 << _column_kernels.FRACTION_BITS
    gain = np.rint(np.where(follows, g, 1) * unit).astype(np.int64)
    offset = np.rint(np.where(follows, shift, 0) * unit).astype(np.int64)
    follows &= gain > 0
    gain = np.maximum(gain, 1)
    image_first = np.clip(-(offset // gain), 0, grid.height_px)
    image_end = np.clip(((grid.height_px - 1) * unit - offset) // gain + 1, image_first, grid.height_px)
    image_end = np.where(follows, image_end, image_first)
    sign = np.where(curves.step[0] < 0, -1, 1)
    # Casting keeps the lower 32 bits, in which the kernel computes.
    gain, offset, image_first, image_end = (a.astype(np.int32) for a in (gain, offset, image_first, image_end))
    return _Maps(half, k_0, sign, gain, offset, image_first, image_end)


@lru_cache(maxsize=4)
def _searched_by(curves: Curves, maps: _Maps, reach: int) -> _Searched:
    return _searched(_columns(curves.k_first), _columns(curves.k_last), maps, reach)


def _searched(k_first: Integers, k_last: Integers, maps: _Maps, reach: int) -> _Searched:
    first, end = np.full_like(maps.gain, k_first.shape[1]), np.zeros_like(maps.gain)
    _column_kernels.rows_of_samples(k_first, k_last, maps.k_0, reach, first, end)
    return _Searched(k_first, k_last, first, end)


@lru_cache(maxsize=8)
def _rows(searched: _Searched, window_px: int) -> _Rows:
    height, half = searched.k_first.shape[1], window_px // 2
    centre_first = np.maximum(searched.first, half)
    centre_end = np.minimum(searched.end, height - half)
    none = centre_first >= centre_end
    centre_first[none], centre_end[none] = height, 0
    first = ndimage.minimum_filter1d(centre_first, window_px, axis=0, mode="wrap") - half
    end = ndimage.maximum_filter1d(centre_end, window_px, axis=0, mode="wrap") + half
    first[end == half] = height  # no window at all
    return _Rows(searched, centre_first, centre_end, first, end)


# -- Images: whole numbers, one column after the other ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Images:
    """The images in the form that the kernel compares."""

    first: Integers
    """`[width, height]`: whole numbers of 1/PER_GREY, or census transforms."""
    valid_1: NDArray[np.bool_]
    """`[height, width]`."""
    second: Integers
    """`[width parts, height]`: a pixel in the upper 16 bits and the step to the next row in the lower ones, or a census
    transform."""
    parts: int
    """Columns of view 2 per column of view 1."""


def _images(first: Panorama, second: Panorama, matcher: WindowMatcher, parts: int) -> _Images:
    """The images in the kernel's form, view 2 interpolated linearly between columns.

    A position between two rows is valid if both of them are.
    """
    pixels_1 = _quantised(first.values)
    values, valid = second.values, second.valid
    if parts > 1:
        weight = np.arange(parts) / parts
        next_values, next_valid = (np.roll(a, -1, axis=1)[..., None] for a in (values, valid))
        between = values[..., None] * (1 - weight) + next_values * weight
        pixels_2 = _quantised(between.reshape(len(values), -1))
        valid = (valid[..., None] & (next_valid | (weight == 0))).reshape(len(valid), -1)
    else:
        pixels_2 = _quantised(values)
    if matcher.cost == "census":
        codes_1, valid_1 = census(pixels_1, first.valid)
        codes_2, valid_2 = census(pixels_2, valid, parts)
        return _Images(_columns(codes_1), valid_1, _columns(np.where(valid_2, codes_2, _column_kernels.MISSING)), parts)
    steps = np.diff(pixels_2, axis=0, append=pixels_2[-1:])
    both = valid & np.concatenate([valid[1:], valid[-1:]])
    packed = np.where(both, pixels_2 << 16 | steps & 0xFFFF, _column_kernels.MISSING)
    values_1 = np.where(first.valid, pixels_1, 0).astype(np.int16)
    return _Images(_columns(values_1), first.valid, _columns(packed), parts)


def _quantised(values: NDArray[np.floating]) -> NDArray[np.int32]:
    return np.rint(np.clip(values * PER_GREY, -_LARGEST, _LARGEST)).astype(np.int32)


def _columns(image: Integers) -> Integers:
    return np.ascontiguousarray(image.T)


def _moments(pixels: Integers, half: int) -> tuple[Array, Array]:
    """The sum of every window, and n times the sum of squares less the sum squared; exact, `[width, height]`."""
    if pixels.shape[1] <= 2 * half:
        return np.zeros(pixels.shape), np.zeros(pixels.shape)
    values = np.pad(pixels.astype(np.int64), ((half, half), (0, 0)), mode="wrap")

    def box(image: Integers) -> Integers:
        for axis in (0, 1):
            so_far = np.cumsum(np.insert(image, 0, 0, axis=axis), axis=axis)
            size, length = 2 * half + 1, so_far.shape[axis]
            image = np.take(so_far, range(size, length), axis) - np.take(so_far, range(length - size), axis)
        return np.pad(image, ((0, 0), (half, half)))

    total = box(values)
    return total.astype(np.float64), ((2 * half + 1) ** 2 * box(values**2) - total**2).astype(np.float64)
