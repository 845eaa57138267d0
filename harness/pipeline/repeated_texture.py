"""Matches on texture that repeats, such as stripes, tiles or a fence: other ranges explain the images as well.

Stripes that are matched one period off look like the same surface nearer or farther away, and the views agree in all of
its windows. Nothing near by tells, and a matcher's standard deviation, which is that of one of the periods, is a
hundredth of the error. So windows are compared with all ranges of the search, their shape scaled alike.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.unwrap import sample
from harness.geometry.angles import Array, normalise
from harness.geometry.panorama import directions, pixel_that_holds
from harness.matching.pair import Pair
from harness.motion.tiles import tangents_at, views
from harness.pipeline import _repeated_texture_kernels as _kernels
from harness.threads import in_bands

_HALF = np.radians(6.0)
"""Half a window, as an angle: 12 pixels of a panorama of 720. Windows of half that look like others by chance: a tenth
of them in the corridor, at a noise of 10 grey levels."""
_SAMPLES = 9
"""Samples along a window's side."""
_APART = np.radians(1.5)
"""Least difference in alpha_2 of another range: nearer ones belong to the same peak."""
_STEP = np.radians(0.5)
"""Step in alpha_2 from one range to the next."""
_LEAST = 0.75
"""Least correlation at another range: with less, it may be chance, among up to 200 ranges."""
_AS_GOOD = 0.1
"""Another range is as good where the correlation is less by this, at most: smoothness has decided between them."""
_VALLEY = 0.25
"""Depth of the valley that parts two ranges: smooth texture has one wide peak."""
_FLAT = np.radians(5.0)
"""Difference in alpha_2 of another range that needs no valley: stripes along the epipolar curves look alike at all
ranges."""
_SHARE = 0.5
"""Least share of a window's samples that both views see."""
_SAME_SURFACE = 1.3
"""Largest ratio of inverse ranges within a window to that of its centre; samples beyond are taken to be like it."""
_LEAST_BESIDE = 2
"""Least number of a window's eight neighbours that repeat as well: a single one is chance."""


def repeated(pair: Pair, limits_m: tuple[float, float], range_m: Array) -> NDArray[np.bool_]:
    """Pixels `[height, width]` about which other ranges explain the images as well.

    Parameters
    ----------
    limits_m
        The nearest and the farthest range that the scene may have.
    range_m
        `[height, width]` on the panorama; NaN where there is none.
    """
    half = max(round(_HALF / pair.grid.phi_pitch), 1)
    cells = tuple(-(-size // half) for size in pair.grid.shape)
    repeats = np.zeros(cells, dtype=bool)
    row, column = _middles(np.isfinite(range_m), half)
    if row.size:
        repeats[row // half, column // half] = _has_another(pair, limits_m, range_m, row, column)
    beside = 9 * ndimage.uniform_filter(repeats.astype(np.float64), 3, mode=("constant", "wrap")) - repeats
    repeats &= beside > _LEAST_BESIDE - 0.5
    rows, columns = (np.arange(size) // half for size in pair.grid.shape)
    return np.isfinite(range_m) & repeats[np.ix_(rows, columns)]


def _middles(known: NDArray[np.bool_], side: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column `[n]` of the known pixel nearest to the middle of each square cell that has one."""
    row, column = np.nonzero(known)
    cell = row // side * (-(-known.shape[1] // side)) + column // side
    off = (row % side - side // 2) ** 2 + (column % side - side // 2) ** 2
    order = np.lexsort((off, cell))
    first = order[np.unique(cell[order], return_index=True)[1]]
    return row[first], column[first]


def _has_another(
    pair: Pair,
    limits_m: tuple[float, float],
    range_m: Array,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Whether windows about these pixels `[n]` look alike at another range as well."""
    x = _windows(directions(pair.grid)[row, column])
    held_row, held_column, inside = pixel_that_holds(pair.grid, x)
    w: Array = np.full(held_row.shape, np.nan)
    w[inside] = pair.motion.baseline_m / range_m[held_row[inside].astype(np.intp), held_column[inside]]
    w = _on_planes(w, x, pair.motion.baseline_m / range_m[row, column])
    grey, seen = sample(pair.images[0], pair.sensors[0], x)
    grey = np.where(seen, grey, np.nan).astype(np.float64)

    nearest, farthest = (pair.motion.baseline_m / each for each in limits_m)
    scale, shift = _scales(pair.alpha_1[row, column], w[:, w.shape[1] // 2], farthest, nearest)
    given, correlation = views(pair.images, pair.sensors), np.empty(scale.shape)
    t, R = pair.t_v1 / pair.motion.baseline_m, np.ascontiguousarray(pair.motion.R_v2_from_v1, np.float64)

    def compare(first: int, end: int) -> None:
        _kernels.correlations(
            first, end, x, w, scale, grey, R, t, given.camera, given.coefficients, _SHARE, correlation
        )

    in_bands(compare, len(row), 8, pair.available_threads)
    return _as_good(correlation, shift)


def _windows(middle: Array) -> Array:
    """Directions `[n, m, 3]` of square windows about directions `[n, 3]`, wherever these look; row by row."""
    side = np.tan(np.linspace(-_HALF, _HALF, _SAMPLES))
    down, right = (each.reshape(-1, 1) for each in np.meshgrid(side, side, indexing="ij"))
    b_1, b_2 = tangents_at(middle)
    return normalise(middle[:, None] + right * b_1[:, None] + down * b_2[:, None])


def _on_planes(w: Array, x: Array, middle: Array) -> Array:
    """Inverse ranges `[n, m]` of the planes through those of windows that are near that in their middle `[n]`.

    Ranges that are farther than the true ones by a factor have errors that grow with it once they are scaled back.
    """
    with np.errstate(invalid="ignore"):
        same = np.abs(np.log(w / middle[:, None])) < np.log(_SAME_SURFACE)
    A, b = np.where(same[..., None], x, 0.0), np.where(same, w, 0.0)
    H = A.transpose(0, 2, 1) @ A
    # Too few of them leave a plane open; then it goes through the middle, facing the view.
    facing = x[:, x.shape[1] // 2]
    H += 1e-6 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    g = np.sum(A * b[..., None], axis=1) + 1e-6 * np.trace(H, axis1=1, axis2=2)[:, None] * middle[:, None] * facing
    plane = np.linalg.solve(H, g[..., None])
    return np.ascontiguousarray((x @ plane)[..., 0])


def _scales(a_1: Array, w: Array, farthest: float, nearest: float) -> tuple[Array, Array]:
    """Factors `[n, k]` of inverse ranges w `[n]` that move alpha_2 in equal steps, and those steps `[k]`; NaN outside
    of the search.
    """
    steps = round(np.pi / _STEP)
    shift = _STEP * np.arange(-steps, steps + 1)
    # w = sin(alpha_2 - alpha_1)/sin(alpha_2), and alpha_2 from the point x - w t.
    a_2 = np.arctan2(np.sin(a_1), np.cos(a_1) - w)
    other = a_2[:, None] + shift
    with np.errstate(invalid="ignore", divide="ignore"):
        there = np.sin(other - a_1[:, None]) / np.sin(other)
    searched = (other > 0) & (other < np.pi) & (there >= farthest) & (there <= nearest)
    scale = np.where(searched, there, np.nan) / w[:, None]
    scale[:, steps] = 1.0
    some = np.isfinite(scale).any(axis=0)
    return np.ascontiguousarray(scale[:, some]), shift[some]


def _as_good(correlation: Array, shift: Array) -> NDArray[np.bool_]:
    """Whether another peak of correlations `[n, k]` at shifts `[k]` of alpha_2 is as good as that at 0 `[n]`."""
    own = int(np.argmin(np.abs(shift)))
    filled = np.where(np.isnan(correlation), np.inf, correlation)
    valley = np.concatenate(
        [
            np.minimum.accumulate(filled[:, own::-1], axis=1)[:, :0:-1],
            np.minimum.accumulate(filled[:, own:], axis=1),
        ],
        axis=1,
    )
    here = correlation[:, own : own + 1]
    with np.errstate(invalid="ignore"):
        as_good = correlation > np.maximum(here - _AS_GOOD, _LEAST)
        apart = (np.minimum(correlation, here) - valley > _VALLEY) & (np.abs(shift) >= _APART)
        return np.asarray((as_good & (apart | (np.abs(shift) >= _FLAT))).any(axis=1))
