"""An occupancy grid: for each cell how likely it is to be occupied, from range profiles taken at known poses.

A profile says, at a bearing, that the nearest surface is at the distance rho, give or take sigma. A cell whose middle
is at the distance r covers the length 2h of that ray. The surface is nearer than the cell, in it, or beyond it with the
probabilities

    before = Phi((r - h - rho)/sigma),   inside = Phi((r + h - rho)/sigma) - before,   1 - before - inside.

Where it is beyond, the cell is free; where it is before, the cell is hidden, and as likely to be occupied as it was,
which is the prior p_0. With a share e of answers that mean nothing,

    p = (1 - e) (inside + p_0 before) + e p_0.

That is the exact posterior of one answer when nothing else is known (S. Thrun, W. Burgard and D. Fox, Probabilistic
Robotics, 2005, chapter 9, call it the inverse sensor model). Answers count as independent: log-odds add up. An unsure
answer spreads thinly over many cells, changes little at each, and clears only what is nearer for certain.

A cell is occupied if anything in it is. So each profile is asked along `FINER` x `FINER` rays through a cell, and says
of it what the ray says that speaks most for an obstacle; where none does, it says the mean.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.mapping.range_profile import RangeProfile

FINER = 3
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.196
"""Probabilities from which a cell is called occupied or free: those of ROS's map_saver."""
MOST_CELLS = 4_000_000
_ONE_SURFACE = 0.15
"""Neighbouring bearings whose distances differ by less than this share of the smaller one look at one surface: between
them the inverse of the distance runs evenly, as it nearly does on a plane."""
_BLUR = 0.25
"""Least standard deviation of a distance, as a share of half a cell: distances between bearings are interpolated."""
_BOUND = 20.0
"""Limit of the log-odds, either way: a probability of a ten-thousandth of a millionth."""


class Cell(IntEnum):
    """The state of a cell."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2


@dataclass(frozen=True, repr=False, eq=False)
class Place(OneLine):
    """The pose of a profile on the map: its position, and the rotation of its frame against the map's."""

    x_m: float
    y_m: float
    yaw: float
    """Radians, counter-clockwise."""


@dataclass(frozen=True)
class GridFrame:
    """The cells of a map. Row 0 is at the lowest y, column 0 at the lowest x."""

    origin_m: tuple[float, float]
    """The lower left corner of the lower left cell, metres."""
    cell_m: float
    shape: tuple[int, int]
    """(rows, columns)."""

    def centres(self, finer: int = 1) -> tuple[Array, Array]:
        """X `[columns]` and y `[rows]` of the cells' middles, metres, or of `finer` x `finer` places in each."""
        side = self.cell_m / finer
        rows, columns = self.shape
        x = self.origin_m[0] + (np.arange(columns * finer) + 0.5) * side
        y = self.origin_m[1] + (np.arange(rows * finer) + 0.5) * side
        return np.asarray(x, np.float64), np.asarray(y, np.float64)

    def cells_of(self, points_m: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Row and column of the cells that hold points `[n, 2]`, and whether they are on the map."""
        at = np.floor((points_m - self.origin_m) / self.cell_m)
        inside = (at >= 0).all(axis=1) & (at[:, 1] < self.shape[0]) & (at[:, 0] < self.shape[1])
        column, row = np.where(inside[:, None], at, 0).astype(np.intp).T
        return row, column, inside


@dataclass(frozen=True, repr=False, eq=False)
class OccupancyGrid(OneLine):
    """A map; `[rows, columns]` of its frame."""

    frame: GridFrame
    probability: Array
    """Probability that a cell is occupied; the prior where nothing was measured."""
    prior: float

    @property
    def state(self) -> NDArray[np.uint8]:
        """`[rows, columns]`: the `Cell` of each cell, by the thresholds of ROS's map_saver."""
        state = np.full(self.probability.shape, np.uint8(Cell.UNKNOWN))
        state[self.probability > OCCUPIED_ABOVE] = Cell.OCCUPIED
        state[(self.probability < FREE_BELOW) & (self.probability < self.prior)] = Cell.FREE
        return state


def frame_around(low_m: Array, high_m: Array, cell_m: float) -> GridFrame:
    """The cells that cover a rectangle, with one more all around.

    Walls tend to stand at round numbers: cells have their middles there, and not their borders.

    Raises
    ------
    InputError
        When there would be more than `MOST_CELLS`.
    """
    first = np.floor(np.asarray(low_m) / cell_m - 0.5) - 0.5
    last = np.ceil(np.asarray(high_m) / cell_m + 0.5) + 0.5
    columns, rows = (int(each) for each in np.rint(last - first))
    if rows * columns > MOST_CELLS:
        raise InputError(
            f"a map of {columns} x {rows} cells has more than {MOST_CELLS} cells; larger ones are fewer", key="cell_m"
        )
    x, y = (first * cell_m).tolist()
    return GridFrame((x, y), cell_m, (rows, columns))


def map_of_profiles(
    profiles: list[tuple[RangeProfile, Place]], frame: GridFrame, *, prior: float, false_share: float
) -> OccupancyGrid:
    """The occupancy grid that follows from all profiles, by Bayes' rule.

    Parameters
    ----------
    prior
        Probability that a cell is occupied before anything is measured.
    false_share
        Share of the profiles' distances that are false.
    """
    log_odds = np.full(frame.shape, np.log(prior / (1 - prior)))
    for profile, place in profiles:
        log_odds += _evidence(profile, place, frame, prior, false_share)
        np.clip(log_odds, -_BOUND, _BOUND, out=log_odds)
    return OccupancyGrid(frame, 1 / (1 + np.exp(-log_odds)), prior)


def _evidence(profile: RangeProfile, place: Place, frame: GridFrame, prior: float, false_share: float) -> Array:
    """Log-odds `[rows, columns]`, less those of the prior, that one profile adds; 0 at bearings without a distance."""
    x, y = (each - at for each, at in zip(frame.centres(), (place.x_m, place.y_m), strict=True))
    distance = np.hypot(x, y[:, None])
    # Length, over the cell's side, of the ray through a cell's centre; the robot's own cell has no such ray.
    along = np.maximum(np.maximum(np.abs(x), np.abs(y)[:, None]) / np.maximum(distance, 1e-12), np.sqrt(0.5))
    half = frame.cell_m / 2 / along
    fine_x, fine_y = (each - at for each, at in zip(frame.centres(FINER), (place.x_m, place.y_m), strict=True))
    log_odds = np.empty((FINER * FINER, *frame.shape))
    for i in range(FINER):
        for j in range(FINER):
            bearing = np.arctan2(fine_y[i::FINER, None], fine_x[j::FINER]) - place.yaw
            log_odds[i * FINER + j] = _of_ray(profile, bearing, distance, half, prior, false_share)
    most = log_odds.max(axis=0)
    return np.asarray(np.where(most > 0, most, log_odds.mean(axis=0)))


def _of_ray(
    profile: RangeProfile, bearing: Array, distance: Array, half: Array, prior: float, false_share: float
) -> Array:
    """Log-odds of cells, less those of the prior, from one ray of a profile each; 0 for a ray without a distance."""
    rho, sigma = _looked_up(profile, bearing)
    known = np.isfinite(rho)
    spread = np.hypot(np.nan_to_num(sigma), _BLUR * half)
    rho = np.where(known, rho, 1.0)
    before, until = ndtr((distance - half - rho) / spread), ndtr((distance + half - rho) / spread)
    p = (1 - false_share) * (until - before + prior * before) + false_share * prior
    return np.where(known, np.log(p / (1 - p)) - np.log(prior / (1 - prior)), 0.0)


def _looked_up(profile: RangeProfile, bearing: Array) -> tuple[Array, Array]:
    """Distance and standard deviation at any bearings: interpolated on one surface, the nearest bearing's elsewhere."""
    count = profile.bearing.size
    at = (bearing - profile.bearing[0]) / profile.increment
    low = np.floor(at).astype(np.intp)
    part = at - low
    first, second = low % count, (low + 1) % count
    nearest = np.where(part < 0.5, first, second)
    a, b = profile.range_m[first], profile.range_m[second]
    one = np.abs(a - b) <= _ONE_SURFACE * np.fmin(a, b)  # False where either is not known
    with np.errstate(invalid="ignore", divide="ignore"):
        between = 1 / ((1 - part) / a + part / b)
    return np.where(one, between, profile.range_m[nearest]), profile.sigma_m[nearest]
