"""The paper's matcher: a fixed square window on the epipolar curve, compared at the nearest pixel (section 4)."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves
from harness.geometry.panorama import Panorama
from harness.matching import _matching_kernels
from harness.matching._vector_kernels import LANES
from harness.matching.interface import Reason
from harness.matching.window import _square_kernels
from harness.matching.window.census import NEIGHBOURHOOD_PX, census
from harness.matching.window.centres import searchable, whole_windows
from harness.matching.window.settings import WholePixelMatches, WindowMatcher
from harness.threads import in_threads

_FLAT = 1e-12
"""A spread below this share of the sum of squares is rounding: windows have at most 10^4 pixels, each within 1e-16."""


def search(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, threads: int
) -> WholePixelMatches:
    """The best sample of every pixel's curve; `threads` deals out rows."""
    grid = first.grid
    images = _images(first, second, matcher)
    matchable_2 = whole_windows(images.valid_2, matcher.window_px)
    searched, reason = searchable(curves, whole_windows(images.valid_1, matcher.window_px))
    lost = searched & ~_extremum_inside(curves, matchable_2)
    reason[lost] = Reason.CURVE_LEAVES_IMAGE
    searched &= ~lost

    k_best = np.zeros(grid.shape, dtype=np.int32)
    costs = np.full((*grid.shape, 2 * matcher.neighbours + 1), np.nan)
    k_0, cosine, sine = _turns(curves, matcher.neighbours)

    def work(rows: NDArray[np.intp]) -> None:
        _square_kernels.match_rows(
            rows,
            _matching_kernels.SAMPLINGS[matcher.sampling],
            _matching_kernels.COSTS[matcher.cost],
            images.first,
            images.second,
            images.codes_1,
            images.codes_2,
            images.moments_1,
            images.moments_2,
            searched,
            _with_rows_beside(matchable_2),
            matcher.window_px // 2,
            grid.phi,
            curves.alpha_1,
            curves.step,
            curves.t / np.linalg.norm(curves.t),
            curves.m,
            curves.n,
            k_0,
            cosine,
            sine,
            curves.k_first,
            curves.k_last,
            grid.z_max,
            grid.z_pitch,
            grid.phi_pitch,
            matcher.neighbours,
            reason,
            k_best,
            costs,
        )

    in_interleaved_rows(work, grid.height_px, threads)
    return WholePixelMatches(curves, k_best, costs, reason)


def costs_of_half_samples(
    first: Panorama, second: Panorama, whole: WholePixelMatches, matcher: WindowMatcher, threads: int
) -> Array:
    """The costs 1.5, 1, 0.5 samples before the best one, at it, and 0.5, 1, 1.5 after it, `[height, width, 7]`.

    View 2 is interpolated linearly at all of them, whole samples as well: the nearest pixel to a curve is up to half a
    row off, which would count at some of them and not at others.
    """
    grid, curves = first.grid, whole.curves
    images = _images(first, second, matcher)
    margin = NEIGHBOURHOOD_PX // 2 if matcher.cost == "census" else 0
    half = matcher.window_px // 2
    values_2 = np.pad(second.values, ((0, 0), (half + margin, half + margin + 1)), mode="wrap")
    matchable_2 = whole_windows(second.valid, matcher.window_px + 2 * margin)
    costs = np.full((*grid.shape, 7), np.nan)

    def work(rows: NDArray[np.intp]) -> None:
        _square_kernels.costs_between(
            rows,
            _matching_kernels.SAMPLINGS[matcher.sampling],
            _matching_kernels.COSTS[matcher.cost],
            images.first,
            values_2,
            images.codes_1,
            images.moments_1,
            margin,
            whole.reason == Reason.MATCHED,
            matchable_2,
            half,
            grid.phi,
            curves.alpha_1,
            curves.step,
            curves.t / np.linalg.norm(curves.t),
            curves.m,
            curves.n,
            grid.z_max,
            grid.z_pitch,
            grid.phi_pitch,
            whole.k,
            costs,
        )

    in_interleaved_rows(work, grid.height_px, threads)
    return costs


def costs_along_curve(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs."""
    grid = first.grid
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    out = np.empty(ks.size)
    images = _images(first, second, matcher)
    k_0, cosine, sine = _turns(curves, matcher.neighbours)
    _square_kernels.costs_along_curve(
        int(curves.k_first[row, column]),
        _matching_kernels.SAMPLINGS[matcher.sampling],
        _matching_kernels.COSTS[matcher.cost],
        images.first,
        images.second,
        images.codes_1,
        images.codes_2,
        images.moments_1,
        images.moments_2,
        _with_rows_beside(whole_windows(images.valid_2, matcher.window_px)),
        row,
        column,
        matcher.window_px // 2,
        grid.phi[column] if matcher.sampling == "phi" else curves.alpha_1[row, column],
        curves.step[row, column],
        curves.t / np.linalg.norm(curves.t),
        curves.m[row, column],
        curves.n[row, column],
        k_0,
        cosine,
        sine,
        grid.z_max,
        grid.z_pitch,
        grid.phi_pitch,
        out,
    )
    return ks, out


def in_interleaved_rows(work: Callable[[NDArray[np.intp]], None], height: int, threads: int) -> None:
    """Interleave rows to balance the load: near rows cost more than far ones."""
    rows = np.arange(height)
    parts = 1 if threads == 1 else 4 * threads
    in_threads(work, [np.ascontiguousarray(rows[i::parts]) for i in range(parts)], threads)


@dataclass(frozen=True, eq=False)
class _Images:
    """Images in the form that the kernel compares, padded by half a window of columns on both sides, and by the columns
    of a vector on the right.

    Arrays that the cost does not use are empty.
    """

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    codes_1: NDArray[np.int32]
    codes_2: NDArray[np.int32]
    """Census transforms."""
    moments_1: Array
    moments_2: Array
    """`[2, height, width]`, not padded: each window's sum, and n times the sum of squares less its square."""
    valid_1: NDArray[np.bool_]
    valid_2: NDArray[np.bool_]
    """`[height, width]`."""


def _images(first: Panorama, second: Panorama, matcher: WindowMatcher) -> _Images:
    half = matcher.window_px // 2
    around = ((0, 0), (half, half + LANES))
    values = [np.pad(image.values, around, mode="wrap") for image in (first, second)]
    codes = [np.empty((1, 1), dtype=np.int32)] * 2
    moments = [np.empty((2, 1, 1))] * 2
    valid = [first.valid, second.valid]
    if matcher.cost == "census":
        transforms = [census(image.values, image.valid) for image in (first, second)]
        codes = [np.pad(each, around, mode="wrap") for each, _ in transforms]
        valid = [whole for _, whole in transforms]
    if matcher.cost == "zncc":
        moments = [_moments(each[:, :-LANES].astype(np.float64), half) for each in values]
    return _Images(values[0], values[1], codes[0], codes[1], moments[0], moments[1], valid[0], valid[1])


def _with_rows_beside(centres: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where windows may be centred, with a row of nowhere above and below, for samples that are off the image."""
    return np.pad(centres, ((1, 1), (0, 0)))


def _moments(padded: Array, half: int) -> Array:
    """The sum of every window, and n times the sum of squares less the sum squared, 0 where all pixels are equal."""
    size, height, width = 2 * half + 1, padded.shape[0] - 2 * half, padded.shape[1] - 2 * half
    if height < 1:
        return np.zeros((2, padded.shape[0], width))

    def box(image: Array) -> Array:
        columns = functools.reduce(np.add, (image[:, j : j + width] for j in range(size)))
        rows = functools.reduce(np.add, (columns[i : i + height] for i in range(size)))
        return np.pad(rows, ((half, half), (0, 0)))

    total, squares = box(padded), size**2 * box(padded**2)
    spread = squares - total**2
    return np.stack([total, np.where(spread > _FLAT * squares, spread, 0)])


def _turns(curves: Curves, reach: int) -> tuple[int, Array, Array]:
    """Cosine and sine of k steps, for all samples searched and `reach` beside them; and the first k."""
    some = curves.k_last >= curves.k_first
    k_0 = int(curves.k_first[some].min(initial=0)) - reach
    angle = np.arange(k_0, int(curves.k_last[some].max(initial=0)) + reach + 1) * float(np.abs(curves.step).max())
    return k_0, np.cos(angle), np.sin(angle)


def _extremum_inside(curves: Curves, matchable_2: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the extremum of z_2(phi), where it falls into the search interval, lies at an allowed window centre.

    z_2(phi) = -(n_x cos phi + n_y sin phi)/n_z is extreme where phi points along (n_x, n_y) or against it.
    """
    grid = curves.grid
    inside = np.ones(grid.shape, dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.arctan2(curves.n[..., 1], curves.n[..., 0])
        horizontal = np.hypot(curves.n[..., 0], curves.n[..., 1])
        for phi, sign in ((along, -1.0), (along + np.pi, 1.0)):
            z = sign * horizontal / curves.n[..., 2]
            k = _k_of_phi(curves, phi, z)
            within = curves.defined & (k >= curves.k_first) & (k <= curves.k_last)
            row = np.floor((grid.z_max - z) / grid.z_pitch)
            column = np.floor((phi + np.pi) / grid.phi_pitch)
            on_image = within & (row >= 0) & (row < grid.height_px)
            ok = np.zeros(grid.shape, dtype=bool)
            ok[on_image] = matchable_2[row[on_image].astype(int), column[on_image].astype(int) % grid.width_px]
            inside &= ~within | ok
    return inside


def _k_of_phi(curves: Curves, phi: Array, z: Array) -> Array:
    """The sample number, a fraction, at which a curve passes the point (phi, z) on it."""
    if curves.sampling == "phi":
        turn = np.mod((phi - curves.grid.phi[None, :]) * np.sign(curves.step), 2 * np.pi)
        return np.asarray(turn / np.abs(curves.step))
    direction = np.stack([np.cos(phi), np.sin(phi), z], axis=-1)
    t_hat = curves.t / np.linalg.norm(curves.t)
    angle = np.arctan2(np.sum(direction * curves.m, axis=-1), direction @ t_hat)
    return np.asarray((angle - curves.alpha_1) / curves.step)
