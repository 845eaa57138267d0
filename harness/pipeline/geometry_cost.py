"""What errors of a geometry do to ranges, as a standard deviation for every pixel.

The likeliest error theta is known with its sign, and so is what it does to every range: once it is undone, the ranges
are other ones, and windows lose some of it besides, since where texture is oblique to the curve a shift along it makes
up for one across it. But a standard deviation has to hold for errors of its kind, not trace the zeros of this one: its
pattern is the root of the mean square over all errors of theta's kind, of typical sizes and any direction, and of that
pattern's median over the image; its height the one that has 68 % of the pixels within one standard deviation of their
ranges, by what theta does there.

What lies across the curves and is neither noise nor an error that is known here is taken to be as large along them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import erf

from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.geometry.angles import Array, normalise
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.motion.across import Across, pixels_per_radian
from harness.motion.causes import Cause, Causes, Effects, columns_of, effects_of, typical_sizes
from harness.motion.residuals import Turn

NO_RANGE = 0.02
"""Least inverse range, 1/|t|, that an error is compared with."""
ONE_SIGMA = 0.6827
_SAMPLES = 8000
_EVEN = 1.0
"""What of the pattern's squared median is added to its square: kinds of few numbers have zeros in common."""
_MUCH_LESS = 25.0
"""Difference of log-likelihoods beyond which an error is no longer counted: a generous one, as residuals of neighbours
are not independent."""
_INEXACT = 0.1
"""Standard deviation of errors of ranges about what theta does to them, as a share of it: 0.02 to 0.1 for displaced
mirrors, where windows follow little."""
_FOLLOWED = 0.6
"""Standard deviation, as a share of it, of what windows lose in range because they follow what lies across, where it is
taken from the nearest tile: 0.5 to 0.65 of it remain of errors of rotation, of the direction of t and of the centre."""
_POWER = 8
"""Power of the mean over what equally likely errors cost: near the costliest of them, which alone would cover too much
where it is another one."""
_LEAST_TRUE = 0.005
"""Inverse range, 1/|t|, that a true one is taken to be at least: an error may have hidden that a point is far away."""
_DOUBLINGS, _BISECTIONS = 60, 40
_NEAREST = 4
_MIDDLE = 0.02
_BY_RANGE = 0.2
"""Distance, as an angle, of two pixels side by side whose ranges differ by a factor e."""


@dataclass(frozen=True, repr=False)
class Cost(OneLine):
    """Standard deviation that the geometry adds, as a share of the range, at `k` pixels spread over the panorama."""

    x: Array
    """`[k, 3]`, unit directions from view 1."""
    w: Array
    """`[k]`, inverse ranges, 1/|t|."""
    share: Array
    """`[k]`."""
    at_tiles: Array
    """The same at the tiles."""
    covered: float
    """Share of the ranges that the matching's standard deviation alone should cover."""

    @property
    def median(self) -> float:
        """Median of `share`."""
        return float(np.median(self.share))

    def everywhere(self, grid: Grid, w: Array) -> Array:
        """The share at all pixels of a panorama, by those that are alike in direction and range; NaN without a range.

        Parameters
        ----------
        w
            `[height, width]`, inverse ranges, 1/|t|.
        """
        known = np.isfinite(w)
        share = np.full(w.shape, np.nan)
        if not known.any():
            return share
        apart, near = cKDTree(_place(self.x, self.w)).query(
            _place(directions(grid)[known], w[known]), k=min(_NEAREST, len(self.x))
        )
        apart, near = apart.reshape(len(near), -1), near.reshape(len(near), -1)
        weight = 1 / (apart**2 + _MIDDLE**2)
        share[known] = np.sum(weight * self.share[near], axis=1) / np.sum(weight, axis=1)
        return share


def cost_of(
    tiles: Across,
    causes: Causes,
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    grid: Grid,
    ranges: tuple[Array, Array],
) -> Cost | None:
    """What a significant error costs, and what is unexplained; None where there are no ranges.

    Parameters
    ----------
    ranges
        `[height, width]` on the panorama: ranges, and the matching's standard deviations; NaN where there is none.
    """
    turn = Turn(np.asarray(motion.R_v2_from_v1, np.float64), motion.t_v1 / motion.baseline_m)
    chosen = _spread(np.isfinite(ranges[0]) & np.isfinite(ranges[1]))
    if not chosen.any():
        return None
    x, w = directions(grid)[chosen], motion.baseline_m / ranges[0][chosen]
    matching = ranges[1][chosen] / ranges[0][chosen]
    here = effects_of(x, _planes(tiles, x, w), sensors, turn, causes.effects.outermost_px)
    aside = tiles.aside[cKDTree(tiles.x_1).query(x)[1]]
    unexplained = causes.unexplained_px, sensors[1], turn
    open_here = _still_open(here, causes) + _along(x, w, *unexplained) ** 2
    open_there = _still_open(causes.effects, causes) + _along(tiles.x_1, tiles.w, *unexplained) ** 2
    here_by_cause, there_by_cause, covered = [], [], 1.0
    for cause in _possible(causes):
        follows = aside * (here.across @ cause.theta) / np.maximum(w, NO_RANGE)
        by_theta = 1 - w / np.maximum(here.true_inverse_range(cause.theta), _LEAST_TRUE) + follows
        unsure = np.sqrt((_INEXACT * by_theta) ** 2 + (_FOLLOWED * follows) ** 2 + open_here + matching**2)
        pattern, level = _pattern(here, cause.name)
        height = _height(pattern, by_theta, unsure, open_here + matching**2)
        covered = min(covered, _within(matching, by_theta, unsure))
        here_by_cause.append(height * pattern)
        there_by_cause.append(height * _pattern(causes.effects, cause.name, level)[0])
    at_points = np.hypot(_nearly_the_most(here_by_cause), np.sqrt(open_here))
    at_tiles = np.hypot(_nearly_the_most(there_by_cause), np.sqrt(open_there))
    return Cost(x, w, at_points, at_tiles, covered)


def _nearly_the_most(costs: list[Array]) -> Array:
    """The power mean `[n]` of what equally likely errors cost."""
    return np.asarray(np.mean(np.power(costs, _POWER), axis=0) ** (1 / _POWER))


def _possible(causes: Causes) -> tuple[Cause, ...]:
    """The likeliest cause, and those that are not much less likely."""
    best, *others = causes.likely or (Cause("", 1.0, {}, causes.theta),)
    most = max((each.explains for each in causes.likely), default=1.0)
    near = tuple(each for each in (best, *others) if (most - each.explains) * causes.gain < _MUCH_LESS)
    return near or (best,)


def _place(x: Array, w: Array) -> Array:
    return np.concatenate([x, _BY_RANGE * np.log(np.maximum(w, NO_RANGE))[..., None]], axis=-1)


def _spread(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Some of these pixels, evenly spread."""
    step = max(1, round(float(np.sqrt(known.sum() / _SAMPLES))))
    chosen = np.zeros_like(known)
    chosen[step // 2 :: step, step // 2 :: step] = known[step // 2 :: step, step // 2 :: step]
    return chosen if chosen.any() else known


def _planes(tiles: Across, x: Array, w: Array) -> Array:
    """Planes `[k, 3]` through some points, with the slope of the nearest tile's."""
    planes = tiles.planes[cKDTree(tiles.x_1).query(x)[1]]
    return np.asarray(planes + (w - np.sum(planes * x, axis=1))[:, None] * x)


def _shares(effects: Effects) -> Array:
    """Derivatives `[n, k]` of ranges by errors, as shares of the range but for the sign."""
    return np.asarray(effects.w / np.maximum(effects.w_1, NO_RANGE)[:, None])


def _still_open(effects: Effects, causes: Causes) -> Array:
    """Variance `[n]` of the share by what the measurements leave open."""
    shares = _shares(effects)
    return np.maximum(np.einsum("ni,ij,nj->n", shares, causes.covariance, shares), 0.0)


def _along(x: Array, w: Array, px: float, sensor: Sensor, turn: Turn) -> Array:
    """What so many pixels of view 2 along the epipolar curves do to ranges `[n]`, as shares of the range.

    By w = sin(alpha_2 - alpha_1)/sin(alpha_2), dw/dalpha_2 is sin(alpha_1)/sin(alpha_2)².
    """
    y = normalise(x - w[:, None] * turn.t)
    sine_1, sine_2 = (np.maximum(np.linalg.norm(np.cross(turn.t, each), axis=1), 1e-6) for each in (x, y))
    away = ((y @ turn.t)[:, None] * y - turn.t) / sine_2[:, None]
    by_alpha_2 = sine_1 / sine_2**2 / np.maximum(w, NO_RANGE)
    return np.asarray(px / pixels_per_radian(sensor, turn, y, away) * by_alpha_2)


def _pattern(effects: Effects, cause: str, level: float | None = None) -> tuple[Array, float]:
    """Root mean square `[n]` of the share over errors of a kind, and the median that it contains."""
    columns = columns_of(effects, cause)
    pattern = np.sqrt(np.sum((_shares(effects)[:, columns] * typical_sizes(effects.names)[columns]) ** 2, axis=1))
    level = float(np.median(pattern)) if level is None else level
    return np.sqrt(pattern**2 + _EVEN * level**2), level


def _within(sigma: Array, error: Array, unsure: Array) -> float:
    """Share of normal deviates of these means and standard deviations that are within sigma."""
    wide = np.sqrt(2) * unsure
    return float(np.mean(erf((sigma - error) / wide) + erf((sigma + error) / wide)) / 2)


def _height(pattern: Array, error: Array, unsure: Array, besides: Array) -> float:
    """The factor of the pattern with which one standard deviation covers what it should."""

    def covered(height: float) -> float:
        return _within(np.sqrt((height * pattern) ** 2 + besides), error, unsure)

    low, high = 0.0, 1.0
    for _ in range(_DOUBLINGS):
        if covered(high) >= ONE_SIGMA:
            break
        low, high = high, 2 * high
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if covered(middle) < ONE_SIGMA else (low, middle)
    return high
