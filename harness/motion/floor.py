"""Detection of the floor among points of known direction and inverse range: the height of view 1 in units of |t|.

On a plane the inverse range is linear in the direction, w = g · x, and 1/|g| is the plane's distance. Deviations are
measured as angles of view 2's ray, `sin(alpha_1) (d_1/d_2)² (w - g · x)` in units of |t|, which are of similar size.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from harness.display import OneLine
from harness.geometry.angles import Array, angle_between, normalise
from harness.geometry.motion_error import MotionError, sensitivity_to_motion

LEAST_POINTS = 20
"""Least number of points on the floor; fewer may be those of a table."""
_TILT = math.radians(20.0)
"""Largest angle between the floor's normal and the sensor's z."""
_LIMIT = math.radians(0.3)
"""Largest deviation of an inlier of the floor: about the angle of a pixel."""
_SAMPLES = 2000
_ROUNDS = 6, 14
"""Rounds with Cauchy's loss, and then with Tukey's."""
_CAUCHY = 2.385
_TUKEY = 4.0
"""Standard deviations beyond which a point has no weight. The tiles at the foot of a wall all lie on one side, a few
standard deviations off: with any weight they lift the floor, by two sigmas of the height on rendered pairs."""
_BESIDE = 6
"""Number of neighbours of a point that are checked: if two of them are off the floor, its tile may be partly a wall."""
_OFF = 3.0
"""Standard deviations beyond which a neighbour is off the floor."""


@dataclass(frozen=True, repr=False)
class Floor(OneLine):
    """A plane below view 1."""

    height: float
    """Distance of viewpoint 1 from the plane, in units of |t|."""
    normal: Array
    """`[3]`, unit, upwards, in v1's frame."""
    points: int
    """Number of inliers."""
    share: float
    """Relative standard deviation of the height, from the scatter of the points."""
    by_motion: Array
    """`[6]`: derivatives of ln(height) by errors of the motion; see `harness.geometry.motion_error`."""

    def length(self, height_m: float) -> float:
        """|t| in metres, for a height of view 1 above the floor."""
        return height_m / self.height

    def error(self, covariance: Array) -> MotionError:
        """Errors of the motion, including that of the length that follows from the height."""
        return MotionError(covariance, -self.by_motion, self.share)


def find_floor(x: Array, w: Array, t: Array, seed: int = 0) -> Floor | None:
    """The plane with the most inliers among points below the horizon; None if there are too few.

    Parameters
    ----------
    x
        `[n, 3]`, unit directions in v1's frame, whose z is up.
    w
        `[n]`, inverse ranges, 1/|t|.
    t
        `[3]`, unit direction of t.
    """
    below = (x[:, 2] < 0) & (w > 0)
    x, w = x[below], w[below]
    if len(x) < LEAST_POINTS:
        return None
    q = x / w[:, None] - t
    sharp = np.sin(angle_between(x, t)) / np.sum(q * q, axis=1) / w**2
    draws = np.random.default_rng(seed)
    best, least = None, math.inf
    for _ in range(_SAMPLES):
        chosen = draws.choice(len(x), 3, replace=False)
        if abs(np.linalg.det(x[chosen])) < 1e-6:
            continue
        g = np.asarray(np.linalg.solve(x[chosen], w[chosen]), dtype=np.float64)
        if _tilt(g) > _TILT:
            continue
        cost = float(np.minimum((sharp * (w - x @ g)) ** 2, _LIMIT**2).sum())
        if cost < least:
            best, least = g, cost
    return None if best is None else _fitted(x, w, sharp, t, best)


def _tilt(g: Array) -> float:
    """Angle between the upward normal of the plane, -g, and z."""
    return math.acos(float(np.clip(-g[2] / np.linalg.norm(g), -1, 1)))


def _fitted(x: Array, w: Array, sharp: Array, t: Array, g: Array) -> Floor | None:
    """The least-squares plane of the inliers, first with Cauchy's loss, then with Tukey's and without the border."""
    inner = np.ones(len(x), dtype=bool)
    for k in range(sum(_ROUNDS)):
        e = sharp * (w - x @ g)
        near = inner & (np.abs(e) < _LIMIT)
        if near.sum() < LEAST_POINTS:
            return None
        if k < _ROUNDS[0]:
            scale = 1.4826 * float(np.median(np.abs(e[near]))) + 1e-12
            weight = np.where(near, sharp / np.sqrt(1 + (e / (_CAUCHY * scale)) ** 2), 0.0)
        else:
            if k == _ROUNDS[0]:
                inside = _without_border(x, np.abs(e) > _OFF * scale)
                inner = inside if (near & inside).sum() >= LEAST_POINTS else inner
                near &= inner
            scale = 1.4826 * float(np.median(np.abs(e[near & (np.abs(e) < _TUKEY * scale)]))) + 1e-12
            weight = np.where(near, sharp * np.maximum(1 - (e / (_TUKEY * scale)) ** 2, 0.0), 0.0)
        g = np.asarray(np.linalg.lstsq(weight[:, None] * x, weight * w, rcond=None)[0], dtype=np.float64)
    if _tilt(g) > _TILT:
        return None
    height = 1 / float(np.linalg.norm(g))
    # Derivative of the plane by each w, from that of Tukey's score, and of ln(height) = -ln|g| by the plane.
    e = sharp * (w - x @ g)
    u = (e / (_TUKEY * scale)) ** 2
    near &= u < 1
    if near.sum() < LEAST_POINTS:
        return None
    answer = np.where(near, sharp**2 * (1 - u) * (1 - 5 * u), 0.0)[:, None] * x
    by_plane = -(height**2) * np.linalg.solve(x.T @ answer, g)
    by_w = answer @ by_plane
    j = sensitivity_to_motion(x, 1 / w, t)
    by_motion = np.sum((by_w * -(w**2))[near, None] * j[near], axis=0)
    score = np.where(near, sharp * (1 - u) ** 2 * e, 0.0) * (x @ by_plane)
    return Floor(height, -normalise(g), int(near.sum()), float(np.sqrt(np.sum(score**2))), by_motion)


def _without_border(x: Array, off: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Points `[n]` in directions x of which, with their neighbours, fewer than two are off the floor."""
    _, beside = cKDTree(x).query(x, k=min(_BESIDE + 1, len(x)))
    return np.asarray(off[beside].sum(axis=1) < 2)
