"""A range profile: for each bearing the horizontal distance of the nearest obstacle in a band of heights.

A pixel in the direction x, |x| = 1, of range d and standard deviation sigma is at the horizontal distance
rho = d cos(e), at the height h + d sin(e), where h is the viewpoint's height and e the elevation of x in the world. A
sole error of the range moves it along its ray: rho has the standard deviation sigma cos(e), its height sigma |sin(e)|.

The smallest of many noisy distances is too small. So the nearest obstacle is the nearest *group* of pixels that agree
within their standard deviations, and its distance is the group's mean, weighted by 1/sigma^2. Matches of neighbours
share their windows, hence their errors: the mean counts as no surer than its pixels are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.display import OneLine
from harness.geometry.angles import Array
from harness.mapping.settings import Scan

_SIGMAS = 3.0
"""Standard deviations from a group's mean within which a pixel belongs to the group."""
_AGREE = 0.02
"""Share of the distance within which a pixel belongs too: surfaces deviate by more than a small sigma."""
_LEAST = 1e-3
"""Least standard deviation in the weights, as a share of the distance."""
_ROUNDS = 5
"""Rounds in which a group's mean converges."""


@dataclass(frozen=True, repr=False, eq=False)
class RangeProfile(OneLine):
    """The nearest obstacle for each bearing; arrays `[bearings]`, ascending in bearing.

    The frame has its origin at the viewpoint, z up in the world, and x where the view's own x axis points, projected on
    the horizontal plane; bearings turn from x to y, counter-clockwise seen from above.
    """

    bearing: Array
    """Middle of each bearing, radians, from -pi on."""
    range_m: Array
    """Horizontal distance, metres; NaN where nothing is known."""
    sigma_m: Array
    """Standard deviation of `range_m`, metres; NaN where it is not known."""

    @property
    def increment(self) -> float:
        """Radians from one bearing to the next."""
        return 2 * np.pi / self.bearing.size

    @property
    def known(self) -> NDArray[np.bool_]:
        """Bearings with an obstacle."""
        return np.isfinite(self.range_m)

    @property
    def points_m(self) -> Array:
        """`[known, 2]`: x and y of the obstacles in the profile's frame, metres."""
        along = np.stack([np.cos(self.bearing), np.sin(self.bearing)], axis=-1)
        return np.asarray((along * self.range_m[:, None])[self.known])


def bearings(count: int) -> Array:
    """The middles of so many bearings around the view, radians, ascending from -pi."""
    return np.asarray(-np.pi + (np.arange(count) + 0.5) * (2 * np.pi / count))


def level_frame(R_world_from_view: ArrayLike) -> Array:
    """`[3, 3]`: the rotation from a view's frame to its profile's, whose z is the world's and whose x lies above or
    below the view's.

    Of a view that looks along the vertical with x, the profile's x is the world's.
    """
    turn = np.asarray(R_world_from_view, dtype=np.float64)
    x, y = turn[:2, 0]
    yaw = np.arctan2(y, x) if np.hypot(x, y) > 1e-9 else 0.0
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.asarray(np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ turn)


def range_profile(
    rays: Array, range_m: Array, sigma_m: Array, R_world_from_view: ArrayLike, height_m: float, scan: Scan
) -> RangeProfile:
    """The range profile of a map of ranges.

    Parameters
    ----------
    rays
        `[..., 3]`: unit directions in the view's frame.
    range_m, sigma_m
        `[...]`: the range along each, metres, and its standard deviation; NaN where they are not known. A range whose
        sigma is not known is believed as it is.
    R_world_from_view
        `[3, 3]`.
    height_m
        Height of the viewpoint in the world, metres.
    """
    count = scan.bearings
    known = np.isfinite(range_m)
    level = rays[known] @ level_frame(R_world_from_view).T
    distance, own = range_m[known], sigma_m[known]
    sigma = np.nan_to_num(own)
    flat = np.hypot(level[:, 0], level[:, 1])
    rho, height = distance * flat, height_m + distance * level[:, 2]
    clear = height - scan.clearance_sigmas * sigma * np.abs(level[:, 2]) >= scan.low_m
    counted = clear & (height <= scan.high_m) & (rho <= scan.range_max_m) & (flat > 0)
    azimuth = np.arctan2(level[counted, 1], level[counted, 0])
    where = np.floor((azimuth + np.pi) / (2 * np.pi / count)).astype(np.intp) % count
    mean, spread = _nearest(where, rho[counted], own[counted] * flat[counted], count, scan.support_px)
    return RangeProfile(bearings(count), mean, spread)


def _nearest(where: NDArray[np.intp], rho: Array, sigma: Array, count: int, support: int) -> tuple[Array, Array]:
    """Mean and standard deviation of the nearest group of distances at each of `count` bearings; NaN without one."""
    mean, spread = np.full(count, np.nan), np.full(count, np.nan)
    if not rho.size:
        return mean, spread
    order = np.lexsort((rho, where))
    where, rho, sigma = where[order], rho[order], sigma[order]
    believed = np.hypot(np.nan_to_num(sigma), _LEAST * rho)
    reach = np.maximum(_SIGMAS * believed, _AGREE * rho)
    # One ascending list for all bearings, each with an interval of its own, wider than any distance and group.
    apart = 2 * float((rho + 2 * reach).max())
    key = where * apart + rho
    following = np.searchsorted(key, key + 2 * reach, side="right") - np.arange(key.size)
    begins, first = np.unique(where[following >= support], return_index=True)
    start = np.flatnonzero(following >= support)[first]
    centre = np.full(count, np.nan)
    centre[begins] = rho[start]
    ahead = np.full(count, np.nan)
    ahead[begins] = 2 * reach[start]
    own = (rho >= centre[where]) & (rho <= (centre + ahead)[where])
    weight = 1 / believed**2
    for _ in range(_ROUNDS):
        total = np.bincount(where[own], weight[own], count)
        with np.errstate(invalid="ignore", divide="ignore"):
            centre = np.bincount(where[own], (weight * rho)[own], count) / total
        own = np.abs(rho - centre[where]) <= reach
    counted = np.bincount(where[own], minlength=count)
    enough = counted >= support
    mean[enough] = centre[enough]
    # The weighted mean of the standard deviations themselves, as of errors that are all one.
    sure = own & np.isfinite(sigma)
    total = np.bincount(where[sure], weight[sure], count)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread[enough] = (np.bincount(where[sure], (weight * sigma)[sure], count) / total)[enough]
    return mean, spread
