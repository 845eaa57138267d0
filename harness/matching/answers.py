"""Answers of a matcher other than alpha_2, on the pixels of the images that it asked for; their conversion to alpha_2.

Every answer is first turned into inverse range on its own pixels, `1/d_1 = sin(alpha_2 - alpha_1)/(|t| sin alpha_2)`
(eq. 7). On a plane that is linear in the direction, so that between pixels a linear interpolation of it makes no error
to speak of, and none leaves the range of its neighbours. alpha_2 follows at the panorama's own directions:
`tan alpha_2 = sin alpha_1/(cos alpha_1 - |t|/d_1)`.
"""

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.geometry.angles import Array, angle_between
from harness.geometry.panorama import Grid, directions
from harness.matching.projections import Projection

QUANTITIES = {
    "range_m": "metres from viewpoint 1 along the pixel's ray",
    "disparity_deg": "the angle alpha_2 - alpha_1 in degrees, 0 at infinity",
    "disparity_px": "columns to the left (or rows up) from view 1 to view 2",
    "alpha_2": "radians, the angle in the epipolar plane between t and the direction from viewpoint 2",
}
"""The quantities that a matcher may answer with, and their meanings."""


@dataclass(frozen=True, eq=False, repr=False)
class Answer(OneLine):
    """A matcher's answer on pixels of its own choice; made by `Views.answer` and `Pair.answer`.

    Arrays are `[height, width]` of the projection, NaN where there is no match. Exactly one of `QUANTITIES` is given.
    """

    projection: Projection | None
    """The pixels of the arrays; None for those of the pair's panorama."""
    t_v1: Array
    """Viewpoint 2 in v1's frame, metres."""
    seen: NDArray[np.bool_] | None = None
    """Pixels that view 1's image covers; values of all others are ignored. None for all."""
    range_m: Array | None = None
    disparity_deg: Array | None = None
    disparity_px: Array | None = None
    alpha_2: Array | None = None
    confidence: Array | None = None
    """Higher is more confident; NaN exactly where there is no match."""
    sigma: Array | None = None
    """Predicted standard deviation in the unit of the quantity, above zero; NaN exactly where there is no match."""

    @property
    def given(self) -> list[str]:
        """The names of the quantities whose arrays are given."""
        return [name for name in QUANTITIES if getattr(self, name) is not None]

    @property
    def quantity(self) -> str:
        """The name of the quantity that is given."""
        return self.given[0]

    @property
    def values(self) -> Array:
        """The array of that quantity, as given."""
        return np.asarray(getattr(self, self.quantity))

    def shape(self, grid: Grid) -> tuple[int, int]:
        """The shape, (rows, columns), that every array must have."""
        return grid.shape if self.projection is None else self.projection.shape

    @property
    def arrays(self) -> dict[str, Any]:
        """The arrays that are given, by name."""
        names = [*QUANTITIES, "confidence", "sigma"]
        return {
            each.name: value
            for each in fields(self)
            if each.name in names and (value := getattr(self, each.name)) is not None
        }


@dataclass(frozen=True, repr=False)
class Converted(OneLine):
    """An answer in the harness's terms, on the panorama `[height, width]`; NaN where there is no match."""

    alpha_2: Array
    confidence: Array | None
    sigma_alpha_2: Array | None


def outside(answer: Answer) -> tuple[NDArray[np.bool_], str]:
    """The pixels whose value is impossible for its quantity, and the values that are possible, for a message."""
    values = np.asarray(answer.values, dtype=np.float64)
    known = ~np.isnan(values)
    if answer.quantity == "range_m":
        return known & ~(values > 0), "range_m must be above zero, or NaN for no match"
    if answer.quantity == "alpha_2":
        return known & ~(
            (values >= 0) & (values <= np.pi)
        ), "alpha_2 must lie within 0 .. pi radians, or be NaN for no match"
    if answer.quantity == "disparity_deg":
        return known & ~(np.abs(values) < 180), "disparity_deg must lie within 0 .. 180 degrees, or be NaN for no match"
    most = max(answer.projection.shape) if answer.projection else 0
    return known & ~(np.abs(values) < most), "disparity_px must be smaller than the image, or NaN for no match"


def converted(answer: Answer, grid: Grid) -> Converted:
    """An answer without faults (see `interface.faults`), converted to angles on the panorama.

    Linear between the four pixels around a direction where all of them have an answer and their disparities lie within
    one pixel of each other; that of the nearest pixel elsewhere, so that nothing is made up across an edge. Confidence
    and standard deviation are the nearest pixel's. A point behind viewpoint 2, as a disparity beyond the direction of t
    means, is no match.
    """
    looking = _looking(answer, grid)
    baseline = float(np.linalg.norm(answer.t_v1))
    a_1 = angle_between(looking, answer.t_v1)
    inverse, slope = _inverse_range(answer, a_1, baseline)
    if answer.seen is not None:
        inverse = np.where(answer.seen, inverse, np.nan)
    sigma = None if answer.sigma is None else np.asarray(answer.sigma, dtype=np.float64) * slope
    confidence = None if answer.confidence is None else np.asarray(answer.confidence, dtype=np.float64)
    if answer.projection is None:
        a_2 = (
            np.asarray(answer.alpha_2, dtype=np.float64)
            if answer.alpha_2 is not None
            else _alpha_2(inverse, a_1, baseline)
        )
    else:
        disparity = _alpha_2(inverse, a_1, baseline) - a_1
        at = _between(answer.projection, grid)
        inverse = at.linear(inverse, disparity, answer.projection.step)
        a_2 = _alpha_2(inverse, angle_between(directions(grid), answer.t_v1), baseline)
        sigma, confidence = (None if each is None else at.nearest(each) for each in (sigma, confidence))
    known = ~np.isnan(a_2)
    if sigma is not None:  # not valid where the range does not depend on the answer, along t
        known &= np.isfinite(sigma) & (sigma > 0)
    return Converted(
        alpha_2=np.where(known, a_2, np.nan),
        confidence=None if confidence is None else np.where(known, confidence, np.nan),
        sigma_alpha_2=None if sigma is None else np.where(known, sigma, np.nan),
    )


def disparity_of(answer: Answer, grid: Grid) -> Array:
    """alpha_2 - alpha_1, radians, on the answer's own pixels `[height, width]`; NaN where there is no match."""
    a_1 = angle_between(_looking(answer, grid), answer.t_v1)
    baseline = float(np.linalg.norm(answer.t_v1))
    return _alpha_2(_inverse_range(answer, a_1, baseline)[0], a_1, baseline) - a_1


def _looking(answer: Answer, grid: Grid) -> Array:
    return directions(grid) if answer.projection is None else answer.projection.directions


def _alpha_2(inverse: Array, a_1: Array, baseline: float) -> Array:
    """alpha_2 of points at an inverse range seen under alpha_1; below alpha_1 where that is negative."""
    return np.asarray(np.arctan2(np.sin(a_1), np.cos(a_1) - baseline * inverse))


def _inverse_range(answer: Answer, a_1: Array, baseline: float) -> tuple[Array, Array]:
    """1/d_1, per metre, and |∂alpha_2/∂(what was answered)|, radians per unit of it, on the answer's pixels.

    For a range that is `|t| sin alpha_1/d_2²` (eq. 11 turned round), with d_2 by the law of cosines.
    """
    values = np.asarray(answer.values, dtype=np.float64)
    if answer.range_m is not None:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            d_2_squared = values**2 + baseline**2 - 2 * values * baseline * np.cos(a_1)
            return 1 / values, baseline * np.sin(a_1) / d_2_squared
    if answer.alpha_2 is not None:
        a_2, slope = values, np.ones_like(values)
    elif answer.disparity_deg is not None:
        a_2, slope = a_1 + np.radians(values), np.full(values.shape, math.radians(1))
    else:
        assert answer.projection is not None
        a_2 = answer.projection.shifted_alpha_2(values)
        ahead, behind = (answer.projection.shifted_alpha_2(values + side) for side in (_STEP_PX, -_STEP_PX))
        slope = np.abs(ahead - behind) / (2 * _STEP_PX)
    a_2 = np.where((a_2 >= 0) & (a_2 < np.pi), a_2, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sin(a_2 - a_1) / (baseline * np.sin(a_2)), slope


_STEP_PX = 0.01
"""Half the step of a central difference: alpha_2 has its second and third derivatives in units of a whole image."""


@dataclass(frozen=True, eq=False)
class _Interpolation:
    """The position of each panorama pixel among a projection's pixels; arrays `[height, width]` of the panorama."""

    corners: NDArray[np.intp]
    """`[4, height, width]`: flat indices of the pixels around: upper left, upper right, lower left, lower right."""
    below: Array
    beside: Array
    """Offset from the upper left of these pixels, in pixels, 0 .. 1."""
    closest: NDArray[np.intp]
    """Flat indices of the nearest pixel."""
    inside: NDArray[np.bool_]

    def nearest(self, values: Array) -> Array:
        """The nearest pixel's value; NaN outside."""
        return np.where(self.inside, values.reshape(-1)[self.closest], np.nan)

    def linear(self, values: Array, alike: Array, most: float) -> Array:
        """Bilinear where `alike` lies within `most` at the four pixels around, the nearest pixel's value elsewhere."""
        around, compared = values.reshape(-1)[self.corners], alike.reshape(-1)[self.corners]
        y, x = self.below, self.beside
        with np.errstate(invalid="ignore"):
            between = (1 - y) * ((1 - x) * around[0] + x * around[1]) + y * ((1 - x) * around[2] + x * around[3])
            smooth = np.isfinite(around).all(axis=0) & (np.ptp(compared, axis=0) <= most)
        return np.where(self.inside & smooth, between, self.nearest(values))


@lru_cache(maxsize=4)
def _between(projection: Projection, grid: Grid) -> _Interpolation:
    row, column = projection.pixel_of(directions(grid))
    inside = np.isfinite(row) & np.isfinite(column)
    firsts, seconds, shares, closest = [], [], [], []
    for position, size, wraps in zip((row, column), projection.shape, projection.wraps, strict=True):
        at = np.where(inside, position, 0.0)
        # Half a pixel at the border belongs to the border's pixels; at a seam there is another one beyond.
        inside &= wraps | ((at >= -0.5) & (at <= size - 0.5))
        at = at % size if wraps else np.clip(at, 0, size - 1)
        first = np.minimum(np.floor(at).astype(np.intp), size - 1)  # a remainder may round up to the size itself
        firsts.append(first)
        seconds.append((first + 1) % size if wraps else np.minimum(first + 1, size - 1))
        shares.append(at - first)
        closest.append(np.where(at - first < 0.5, first, seconds[-1]))
    width = projection.width_px
    corners = np.stack([i * width + j for i in (firsts[0], seconds[0]) for j in (firsts[1], seconds[1])])
    return _Interpolation(corners, shares[0], shares[1], closest[0] * width + closest[1], inside)
