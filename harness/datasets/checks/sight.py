"""The images of a pair at the points of its map, and the changes of geometry that make them agree better.

Images are freed of brightness and contrast: smoothed, less their surroundings, over the local standard deviation.
Points next to a jump in range, and points at an image's border, are left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.sensor import Sensor, pixel_directions, project
from harness.datasets.layouts.helvipad import polar_of, range_of_disparity
from harness.datasets.layouts.layout import PlacedView, StoredPair
from harness.datasets.layouts.reading import read_grey
from harness.datasets.pair import VISIBLE
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.simulation.noise import generator

_MOST_POINTS, _FEW = 2500, 200
_FINE_PX, _COARSE_PX = 1.0, 5.0
"""Standard deviations of the smoothing, and of the surroundings."""
_FLOOR_GREY = 3.0
"""Added to the local standard deviation: where it is smaller there is no texture but noise."""
_BORDER_PX = 4.0
_JUMP = 1.05
_SCALE = 0.6
"""Residual at which a point counts half: plain images have a standard deviation of 1."""

Pixels = tuple[Array, Array]
"""`[n, 2]` in either image."""
Change = Callable[["Sight", Array], Pixels]
"""Gives the pixels of a pair's points under a change of its geometry by some numbers."""


@dataclass(frozen=True, eq=False)
class PlainImage:
    """An image freed of brightness and contrast."""

    values: Array
    spline: Array
    """Coefficients of the values' cubic spline, which hardly smooths between pixels."""
    slope_u: Array
    slope_v: Array
    known: Array
    """1 where the sensor sees something and the border is not near, else 0."""

    @classmethod
    def of(cls, grey: NDArray[np.float32], sensor: Sensor) -> "PlainImage":
        """Free an image of a sensor."""
        visible = pixel_directions(sensor)[1].astype(np.float64)

        def mean(values: Array, sigma: float) -> Array:
            weight = ndimage.gaussian_filter(visible, sigma)
            return np.asarray(ndimage.gaussian_filter(values * visible, sigma) / np.maximum(weight, 1e-6))

        image = grey.astype(np.float64)
        around = mean(image, _COARSE_PX)
        deviation = np.sqrt(mean((image - around) ** 2, _COARSE_PX)) + _FLOOR_GREY
        values = (mean(image, _FINE_PX) - around) / deviation * visible
        slope_v, slope_u = (np.asarray(each, dtype=np.float64) for each in np.gradient(values))
        inner = ndimage.distance_transform_edt(np.pad(visible, 1))[1:-1, 1:-1] > _BORDER_PX
        spline = np.asarray(ndimage.spline_filter(values, mode="mirror"), dtype=np.float64)
        return cls(values, spline, slope_u, slope_v, inner.astype(np.float64))

    def at(self, pixels: Array) -> Array:
        """Values `[n]`; NaN where nothing is known."""
        where = [pixels[:, 1], pixels[:, 0]]
        inside = ndimage.map_coordinates(self.known, where, order=1, cval=0.0) > 0.99
        value = ndimage.map_coordinates(self.spline, where, order=3, prefilter=False, mode="mirror")
        return np.where(inside, value, np.nan)

    def slopes_at(self, pixels: Array) -> Array:
        """Slopes along u and v `[n, 2]`."""
        where = [pixels[:, 1], pixels[:, 0]]
        slopes = [ndimage.map_coordinates(each, where, order=1) for each in (self.slope_u, self.slope_v)]
        return np.stack(slopes, axis=-1)


@dataclass(frozen=True, eq=False)
class Sight:
    """A pair, ready to be looked at under any geometry."""

    pair: StoredPair
    directions: Array
    """`[n, 3]`, in the map's frame."""
    range_m: Array
    """`[n]`, metres from the map's origin."""
    raw: Array
    """`[n]`: the numbers of the map as they are meant, whatever they are."""
    cells: NDArray[np.intp] | None
    """`[n, 2]`: row and column on the map; None for single points."""
    range_map: Array | None

    @cached_property
    def images(self) -> tuple[PlainImage, PlainImage]:
        """Both images."""
        first, second = (PlainImage.of(read_grey(view.image), view.sensor) for view in self.pair.views)
        return first, second

    @property
    def views(self) -> tuple[PlacedView, PlacedView]:
        """Both views of the pair."""
        return self.pair.views

    def pixels(self, range_m: Array | None = None, motion: Motion | None = None) -> Pixels:
        """The points' pixels in both images, with other ranges, or with another motion from view 1 to view 2."""
        points = self.directions * (self.range_m if range_m is None else range_m)[:, None]
        first, second = self.views
        in_1 = (points - first.position_m) @ first.R_view_from_map.T
        in_2 = (points - second.position_m) @ second.R_view_from_map.T if motion is None else motion.apply(in_1)
        return _projected(first.sensor, in_1), _projected(second.sensor, in_2)


def _projected(sensor: Sensor, points: Array) -> Array:
    pixels, _ = project(sensor, points)
    return np.where(np.isfinite(pixels), pixels, -1e6)


def sight_of(pair: StoredPair) -> Sight | None:
    """A pair ready to be looked at; None where it has too few points with a range."""
    draws = generator(0, "dataset", "check", pair.name)
    if pair.maps:
        map_ = pair.maps[0]
        values, x = map_.read(), map_.directions()
        range_m = _ranges_of(map_.quantity, values, x, pair)
        range_m = np.where(np.isfinite(range_m), range_m, np.nan)
        known = np.isfinite(range_m) & (range_m > 0) & np.isfinite(x[..., 0])
        usable = known & ~_jumps(range_m, np.inf)
        if usable.sum() < _FEW:  # a laser's sparse points: missing neighbours are no outline
            usable = known & ~_jumps(range_m, np.nan)
        if pair.state is not None and map_.is_image:
            state = pair.state()
            usable &= (state == VISIBLE) if state.shape == usable.shape else True
        row, column = np.nonzero(usable)
        if row.size < _FEW:
            return None
        chosen = draws.permutation(row.size)[:_MOST_POINTS]
        cells = np.stack([row[chosen], column[chosen]], axis=-1)
        at = tuple(cells.T)
        return Sight(pair, x[at], range_m[at], values[at], cells, range_m)
    if pair.observed is None or len(pair.observed[0]) < 100:
        return None
    points = pair.observed[0]
    range_m = np.linalg.norm(points, axis=1)
    return Sight(pair, points / range_m[:, None], range_m, range_m, None, None)


def _ranges_of(quantity: str, values: Array, x: Array, pair: StoredPair) -> Array:
    if quantity == "inverse range":
        with np.errstate(divide="ignore"):
            return np.where(values > 0, 1 / np.where(values > 0, values, 1), np.nan)
    if quantity == "disparity":
        return range_of_disparity(values, polar_of(x), pair.motion.baseline_m)
    return values


def _jumps(range_m: Array, missing: float) -> NDArray[np.bool_]:
    """Pixels with a jump among their neighbours; one without a range counts as so far away, or not at all if NaN."""
    none = np.isnan(range_m)
    with np.errstate(invalid="ignore"):
        most = ndimage.maximum_filter(np.where(none, 0.0 if np.isnan(missing) else missing, range_m), 5)
        least = ndimage.minimum_filter(np.where(none, np.inf, range_m), 5)
        # On a floor at a grazing angle neighbours differ too, and are left out with the rest.
        return np.asarray(~(most < _JUMP**2 * np.maximum(least, 1e-9)))


# --- Agreement, and what improves it ---------------------------------------------------------------------------------


def correlation(sights: Sequence[Sight], change: Change, numbers: Array | None = None) -> float:
    """The correlation of what both images show of all points, under a change of the geometry; 0 without points."""
    numbers = np.zeros(0) if numbers is None else numbers
    sums = np.zeros(3)
    for sight in sights:
        p_1, p_2 = change(sight, numbers)
        a, b = (image.at(pixels) for image, pixels in zip(sight.images, (p_1, p_2), strict=True))
        both = np.isfinite(a) & np.isfinite(b)
        # A correlation over few points means little.
        if both.sum() > 0.05 * both.size:
            sums += a[both] @ a[both], b[both] @ b[both], a[both] @ b[both]
    return float(sums[2] / np.sqrt(sums[0] * sums[1])) if sums[0] * sums[1] > 0 else 0.0


@dataclass(frozen=True)
class Fit:
    """Numbers of a change that make both images agree best, to first order and repeated."""

    numbers: Array
    gain: float
    """Decrease of the weighted sum of squared differences against that without the change, and against that of the
    opposite change, as a share. A change that only smooths an image has no such gain."""


_ROUNDS = 5


def fit(sights: Sequence[Sight], change: Change, steps: Array) -> Fit:
    """Fit the numbers of a change to all pairs together, by Gauss and Newton.

    Parameters
    ----------
    steps
        For the derivatives, a fraction of a pixel's worth of each number.
    """
    errors: list[float] = []
    tried: list[Array] = [np.zeros(len(steps))]
    for _ in range(_ROUNDS + 1):
        A, b, error = _summed(sights, change, tried[-1], steps)
        errors.append(error)
        step = np.linalg.lstsq(A + 1e-9 * np.diag(np.diag(A)), b, rcond=None)[0]
        if (np.abs(step) < 0.1 * steps).all():  # a few thousandths of a pixel
            break
        tried.append(tried[-1] + step)
    best = min(errors)
    best_numbers = tried[errors.index(best)]
    least = min(errors[0], _summed(sights, change, -best_numbers, steps)[2])
    return Fit(best_numbers, float(1 - best / least) if least > 0 else 0.0)


def _summed(sights: Sequence[Sight], change: Change, numbers: Array, steps: Array) -> tuple[Array, Array, float]:
    """Normal equations of all pairs, and the mean of the weighted squared differences."""
    A, b, squares = np.zeros((len(steps), len(steps))), np.zeros(len(steps)), np.zeros(2)
    for sight in sights:
        each = _equations(sight, change, numbers, steps)
        A, b, squares = A + each[0], b + each[1], squares + each[2]
    return A, b, float(squares[0] / max(squares[1], 1e-12))


def _equations(sight: Sight, change: Change, numbers: Array, steps: Array) -> tuple[Array, Array, Array]:
    """Normal equations, and the sums of weighted squares and of weights."""
    p_1, p_2 = change(sight, numbers)
    r = sight.images[0].at(p_1) - sight.images[1].at(p_2)
    slopes_1, slopes_2 = sight.images[0].slopes_at(p_1), sight.images[1].slopes_at(p_2)
    columns = []
    for i, step in enumerate(steps):
        up, down = (change(sight, numbers + sign * step * np.eye(len(steps))[i]) for sign in (1, -1))
        d_1, d_2 = (up[0] - down[0]) / (2 * step), (up[1] - down[1]) / (2 * step)
        columns.append(np.sum(slopes_2 * d_2 - slopes_1 * d_1, axis=-1))
    J = np.stack(columns, axis=-1)
    good = np.isfinite(r) & np.isfinite(J).all(axis=1)
    r, J = r[good], J[good]
    weight = 1 / (1 + (r / _SCALE) ** 2)
    return (J * weight[:, None]).T @ J, (J * weight[:, None]).T @ r, np.array([weight @ r**2, weight.sum()])


def across_px(sight: Sight) -> Array:
    """Offsets of patches of image 1 across their epipolar curves in image 2, `[patches]`, pixels.

    Each patch is the points in a cell of a grid on image 1; its shift in image 2 solves two normal equations. The part
    along the curve is an error of the range; the rest is across.
    """
    p_1, p_2 = sight.pixels()
    _, farther = sight.pixels(sight.range_m * 1.02)
    along = farther - p_2
    a, b, slopes = sight.images[0].at(p_1), sight.images[1].at(p_2), sight.images[1].slopes_at(p_2)
    usable = np.isfinite(a) & np.isfinite(b)
    length = np.linalg.norm(along, axis=1)
    usable &= length > 1e-6
    size = max(np.max(p_1[usable], axis=0, initial=1.0)) / 10
    cell = np.floor(p_1 / size).astype(np.int64)
    label = np.where(usable, cell[:, 0] * 1000 + cell[:, 1], -1)
    offsets = []
    for each in np.unique(label[label >= 0]):
        at = label == each
        if at.sum() < 20:
            continue
        J = slopes[at]
        weight = 1 / (1 + ((a - b)[at] / _SCALE) ** 2)
        A = (J * weight[:, None]).T @ J
        if np.linalg.eigvalsh(A)[0] < 0.02 * at.sum():
            continue
        shift = np.linalg.solve(A, (J * weight[:, None]).T @ (a - b)[at])
        direction = np.median(along[at] / length[at, None], axis=0)
        direction /= max(float(np.linalg.norm(direction)), 1e-9)
        offsets.append(shift[0] * -direction[1] + shift[1] * direction[0])
    return np.array(offsets)


# --- Outlines --------------------------------------------------------------------------------------------------------

_REACH = 4
_OUTLINE = 1.2


def outline_profile(sight: Sight) -> tuple[Array, Array]:
    """Steps of image 1 across the outlines of the map, along u and along v.

    An outline is where neighbouring ranges are a fifth apart. If the map is where image 1 is, the steps are largest at
    the outline itself.

    Returns
    -------
    along_u, along_v
        `[outlines, 2 reach + 1]`: |difference| of the neighbours so many pixels farther; the middle one is the
        outline's own.
    """
    empty = np.empty((0, 2 * _REACH + 1))
    if sight.range_map is None or not sight.pair.maps[0].is_image:
        return empty, empty
    image = sight.images[0]
    arrays = sight.range_map, image.values, image.known
    return _steps_along_rows(*arrays), _steps_along_rows(*(np.ascontiguousarray(each.T) for each in arrays))


def _steps_along_rows(range_m: Array, grey: Array, known: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = range_m[:, 1:] / range_m[:, :-1]
        jump = (ratio > _OUTLINE) | (ratio < 1 / _OUTLINE)
    row, column = np.nonzero(jump)
    inside = (column >= _REACH) & (column + 1 + _REACH < range_m.shape[1])
    row, column = row[inside], column[inside]
    at = column[:, None] + np.arange(-_REACH, _REACH + 2)
    whole = known[row[:, None], at].all(axis=1)
    return np.abs(np.diff(grey[row[:, None], at], axis=1))[whole]
