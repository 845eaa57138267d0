"""Robust estimation of the motion from pairs of bearing vectors: MSAC over minimal samples.

The minimal solvers are PoseLib's, which take rays in any direction: five points (Nistér), three for a rotation about a
known vertical, two for motion in a plane. Samples come from a seeded generator: results are reproducible to the bit.
"""

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array, angle_between
from harness.motion import _bearing_kernels as _kernels
from harness.motion.features import Correspondences
from harness.motion.residuals import Turn, bearings_of, slack
from harness.motion.sparse import Freedom, fit

LIMIT_PX = 2.0
"""Sampson distance, pixels, above which a pair is an outlier."""
MOST_ITERATIONS = 50_000
"""Most iterations: enough, almost surely, for one sample of five inliers among 80 % outliers."""
_MISS = 1e-5
"""Accepted probability of never drawing a sample of inliers only."""
_LEAST_ITERATIONS = 200
"""Least iterations: a sample of inliers may still be degenerate, of points that lie close together."""
_RIVALS = 8
"""Number of alternative motions that are kept besides the best, each with another direction."""
_APART = math.radians(5.0)
"""Motions whose directions of t and rotations differ by less than this angle are the same."""

_SIZES = {"free": 5, "upright": 3, "planar": 2}
_SOLVERS = {
    "free": "relpose_5pt",
    "upright": "relpose_upright_3pt",
    "planar": "relpose_upright_planar_2pt",
}
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""PoseLib's upright solvers turn about y: (x, -z, y) of our frame, a proper rotation."""


@dataclass(frozen=True, repr=False)
class Consensus(OneLine):
    """The motion with the least truncated cost, and the next best alternatives."""

    turn: Turn
    cost: float
    """Sum of squared Sampson distances truncated at `LIMIT_PX`², divided by it: the number of unexplained pairs."""
    rivals: list[tuple[float, Turn]]
    """The best alternative motions and their costs."""
    iterations: int


def agree(pairs: Correspondences, *, freedom: Freedom = "free", seed: int = 0) -> Consensus | None:
    """The motion of least truncated cost; None when no sample yields a motion.

    Raises
    ------
    InputError
        When PoseLib is not installed.
    """
    size, draws = _SIZES[freedom], np.random.default_rng(seed)
    if len(pairs) <= size:
        return None
    solver = getattr(_poselib(), _SOLVERS[freedom])
    order = draws.permutation(len(pairs))  # the evaluation of a cost stops early, so neighbours are separated
    shuffled = pairs.at(order)
    search = _Search(shuffled)
    wanted = MOST_ITERATIONS
    iteration = 0
    while iteration < wanted:
        iteration += 1
        chosen = draws.choice(len(pairs), size, replace=False)
        better = False
        for turn in _solved(solver, shuffled.x_1[chosen], shuffled.x_2[chosen], freedom):
            better |= search.tried(turn)
        if better:
            search.tried(fit(shuffled, search.best, freedom, limit_px=LIMIT_PX).turn)
            wanted = min(wanted, max(_LEAST_ITERATIONS, _needed(1 - search.cost / len(pairs), size)))
    if search.best is None:
        return None
    return Consensus(search.best, search.cost, search.rivals(), iteration)


def _poselib() -> Any:
    try:
        return importlib.import_module("poselib")
    except ImportError as error:
        raise InputError("needs the extra: pip install 'omnirange[motion]'", file="motion") from error


def _needed(share: float, size: int) -> int:
    """Iterations after which the probability that no sample consists of inliers only is `_MISS`."""
    hit = max(share, 1e-3) ** size
    return MOST_ITERATIONS if hit < 1e-12 else math.ceil(math.log(_MISS) / math.log1p(-min(hit, 1 - 1e-12)))


def _solved(solver: Any, x_1: Array, x_2: Array, freedom: Freedom) -> list[Turn]:
    """The solutions of a minimal sample. PoseLib's pose is `p_2 = R p_1 + t'`, so that t = -R^T t'."""
    upright = freedom != "free"
    if upright:
        x_1, x_2 = x_1 @ _Y_UP.T, x_2 @ _Y_UP.T
    turns = []
    for pose in solver(np.ascontiguousarray(x_1), np.ascontiguousarray(x_2)):
        R = np.asarray(pose.R)
        t = -R.T @ np.asarray(pose.t)
        if upright:
            R, t = _Y_UP.T @ R @ _Y_UP, _Y_UP.T @ t
        length = float(np.linalg.norm(t))
        if length > 0 and np.isfinite(R).all() and math.isfinite(length):
            turns.append(Turn(np.ascontiguousarray(R), t / length))
    return turns


class _Search:
    """Collects the best motions."""

    def __init__(self, pairs: Correspondences) -> None:
        self._bearings = bearings_of(pairs)
        self._slack = slack(pairs)
        self._ranked: list[tuple[float, Turn]] = []

    @property
    def best(self) -> Any:
        """The motion of least cost; None before any."""
        return self._ranked[0][1] if self._ranked else None

    @property
    def cost(self) -> float:
        """The cost of the best motion; infinite before any."""
        return self._ranked[0][0] if self._ranked else math.inf

    def tried(self, turn: Turn) -> bool:
        """Evaluate a motion, keep it if it is among the best, and return whether it is the best so far."""
        full = len(self._ranked) > _RIVALS
        most = self._ranked[-1][0] if full else math.inf
        cost = _kernels.truncated_cost(*self._bearings, self._slack, turn.R, turn.t, LIMIT_PX, most * LIMIT_PX**2)
        cost /= LIMIT_PX**2
        if cost > most:
            return False
        is_best = cost < self.cost
        if is_best:
            self._ranked = [(c, each) for c, each in self._ranked if not alike(each, turn)]
        elif any(alike(each, turn) and c <= cost for c, each in self._ranked):
            return False
        self._ranked = sorted([*self._ranked, (cost, turn)], key=lambda each: each[0])[: _RIVALS + 1]
        return is_best

    def rivals(self) -> list[tuple[float, Turn]]:
        """The alternative motions and their costs."""
        return [each for each in self._ranked[1:] if not alike(each[1], self.best)]


def alike(one: Turn, other: Turn) -> bool:
    """Whether two motions are within 5 degrees of each other."""
    trace = np.trace(one.R.T @ other.R)
    return bool(angle_between(one.t, other.t) < _APART and trace > 1 + 2 * math.cos(_APART))
