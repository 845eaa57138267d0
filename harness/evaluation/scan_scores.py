"""Scores of a range profile: errors of right estimates, missed obstacles, and false ones.

An estimate is *right* within a share of the true distance. Farther than that the robot takes an obstacle for free
space: it is *missed*; nearer than that the obstacle is *false*. A bearing without an estimate is neither: the robot
knows that it does not know.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.mapping.range_profile import RangeProfile
from harness.mapping.settings import Scan

Mask = NDArray[np.bool_]

_IN_FRONT = 0.05
"""Least share by which an obstacle is nearer than the surfaces on both sides of it."""


@dataclass(frozen=True)
class Obstacle:
    """An object of the true scene that stands out in front of its background."""

    name: str
    """The object's, in the scene."""
    begin: int
    end: int
    """The first of its fine bearings, and the one after the last; the latter may exceed their number."""
    width_deg: float
    range_m: float
    """Distance of its nearest point in the band, metres."""
    found: bool = False
    """Whether a bearing that it covers, even in part, has an estimate within the tolerance of `range_m`."""


@dataclass(frozen=True)
class ScanScore:
    """Figures of one profile. Shares are of the bearings that truly have an obstacle."""

    bearings: int
    """Number of bearings with a true obstacle."""
    density: float
    """Share of these with an estimate."""
    bias_m: float | None
    """Mean error of the right estimates; None if there are none, as for the following figures."""
    rms_m: float | None
    """Root of the mean squared error of the right ones."""
    median_abs_m: float | None
    """Median |error| of all estimates, right or not."""
    within_1_sigma: float | None
    """Share of all estimates whose error is within their own standard deviation; 0.683 is right."""
    within_2_sigma: float | None
    """Share of all estimates whose error is within two of their own standard deviations; 0.954 is right."""
    missed: float
    """Share with an estimate that is too far."""
    false: float
    """Share with an estimate that is too near, and of bearings without any obstacle."""
    obstacles: int
    """Obstacles that stand in front of something."""
    obstacles_found: int
    thin: int
    """The number of thin obstacles."""
    thin_found: int


def score_scan(
    profile: RangeProfile, true_m: Array, obstacles: list[Obstacle], scan: Scan, fine: int
) -> tuple[ScanScore, list[Obstacle]]:
    """The figures of a profile, and the obstacles with whether it has found them.

    Parameters
    ----------
    true_m
        True distance at the middle of each bearing, metres; NaN where there is no obstacle.
    obstacles
        See `obstacles_of`.
    fine
        Number of their fine bearings per bearing of the profile.
    """
    there, known = np.isfinite(true_m), profile.known
    error = profile.range_m - true_m
    both = there & known
    right = both & (np.abs(error) <= scan.tolerance * true_m)
    sure = both & np.isfinite(profile.sigma_m)
    within = [_share(np.abs(error[sure]) <= k * profile.sigma_m[sure]) for k in (1, 2)]
    found = [_marked(each, profile, scan, fine) for each in obstacles]
    thin = [each for each in found if each.width_deg < scan.thin_deg]
    total = max(int(there.sum()), 1)
    return ScanScore(
        bearings=int(there.sum()),
        density=float(both.sum() / total),
        bias_m=float(error[right].mean()) if right.any() else None,
        rms_m=math.sqrt(float(np.square(error[right]).mean())) if right.any() else None,
        median_abs_m=float(np.median(np.abs(error[both]))) if both.any() else None,
        within_1_sigma=within[0],
        within_2_sigma=within[1],
        missed=float((both & ~right & (error > 0)).sum() / total),
        false=float(((both & ~right & (error < 0)) | (known & ~there)).sum() / total),
        obstacles=len(found),
        obstacles_found=sum(each.found for each in found),
        thin=len(thin),
        thin_found=sum(each.found for each in thin),
    ), found


def obstacles_of(range_m: Array, which: NDArray[np.integer], names: tuple[str, ...]) -> list[Obstacle]:
    """The obstacles of a finely sampled true profile: runs of one object nearer than the surfaces on both sides.

    Parameters
    ----------
    range_m
        `[fine bearings]`, metres, around the view; NaN where there is nothing.
    which
        `[fine bearings]`: the object that is met; -1 for none.
    names
        Names of all objects.
    """
    count = range_m.size
    starts = np.flatnonzero(which != np.roll(which, 1))
    if starts.size < 2:  # one object all around has nothing beside it
        return []
    far = np.where(np.isfinite(range_m), range_m, np.inf)
    obstacles = []
    for begin, end in zip(starts, np.append(starts[1:], starts[0] + count), strict=True):
        if which[begin] < 0:
            continue
        inside = np.arange(begin, end) % count
        before, after = far[begin - 1], far[end % count]
        if before > (1 + _IN_FRONT) * far[begin] and after > (1 + _IN_FRONT) * far[(end - 1) % count]:
            width = float((end - begin) * 360 / count)
            obstacles.append(Obstacle(names[which[begin]], int(begin), int(end), width, float(far[inside].min())))
    return obstacles


def _marked(obstacle: Obstacle, profile: RangeProfile, scan: Scan, fine: int) -> Obstacle:
    """The obstacle, marked as found or not; `fine` bearings make one of the profile's."""
    count = profile.bearing.size
    covered = np.arange(obstacle.begin // fine, (obstacle.end - 1) // fine + 1) % count
    error = np.abs(profile.range_m[covered] - obstacle.range_m)
    near = scan.tolerance * obstacle.range_m
    return replace(obstacle, found=bool((error <= near).any()))


def _share(true: Mask) -> float | None:
    return float(true.mean()) if true.size else None
