"""A view from another viewpoint: rays of the new view meet the surface of a map of ranges, and the source images are
sampled where they saw the same points.

Source k at c_k sees a point p = c + d r of the new ray at c_k + d_k r_k. An error of the range along the new ray, of
standard deviation sigma, moves what it samples by e_k = sigma sin(angle(d, d_k)) / r_k: by nothing where both look
along the same line. Sources are blended with weights of 1 / (e_k^2 + w_k^2)^2, where w_k is a pixel's width there, so
that the one which is nearest to the new ray and sharpest counts most.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from harness.camera.fill import nearest_known
from harness.camera.sensor import Sensor, pixels_per_steradian
from harness.camera.unwrap import sample
from harness.display import OneLine
from harness.geometry.angles import Array, normalise
from harness.geometry.pose import Motion
from harness.warping.surface import SIGMAS, RangeSurface

S = TypeVar("S", bound=np.generic)

_UNTOLD = 0.03
"""Share of the range that is taken for an error besides sigma: a patch is flat, and at an outline it is a pixel's."""
_HIDDEN = 0.01
"""Share of the distance by which a surface in front of a point hides it, beyond `SIGMAS` of its own sigma."""


class PixelState(IntEnum):
    """The source of a pixel's grey level in a warped view."""

    SEEN = 0
    """A source image shows the point."""
    DISOCCLUDED = 1
    """Behind an outline: none of the views with ranges sees the surface there."""
    UNMATCHED = 2
    """The matcher has no range for the surface there."""
    OUTSIDE = 3
    """Beyond all panoramas."""
    UNSAMPLED = 4
    """A range, but no image that shows the point."""


STATES = {
    PixelState.SEEN: "are seen",
    PixelState.DISOCCLUDED: "are behind an outline",
    PixelState.UNMATCHED: "have no range",
    PixelState.OUTSIDE: "are beyond the panorama",
    PixelState.UNSAMPLED: "are in neither image",
}
"""The states in words, as predicates of pixels."""


def shares_in_words(state: NDArray[np.uint8]) -> list[str]:
    """`12.3% are behind an outline` and so on, for the states that pixels of any shape have."""
    return [f"{share:.1%} {STATES[each]}" for each in PixelState if (share := float((state == each).mean())) >= 0.0005]


@dataclass(frozen=True, repr=False, eq=False)
class Image(OneLine):
    """An image to take grey levels from."""

    grey: NDArray[np.float32]
    """`[sensor height, sensor width]`, 0 .. 255."""
    sensor: Sensor
    motion: Motion
    """The motion from the frame of the sources to this view."""


@dataclass(frozen=True, repr=False, eq=False)
class Source(OneLine):
    """A map of ranges, and where it is."""

    surface: RangeSurface
    motion: Motion
    """The motion from the frame of the sources to the map's."""


@dataclass(frozen=True, repr=False, eq=False)
class WarpedView(OneLine):
    """A view that was warped; arrays of the shape of the rays, `[rows, columns]`."""

    grey: NDArray[np.float32]
    """0 .. 255; NaN where nothing is known, unless it was filled."""
    range_m: Array
    """Distance from the new viewpoint, metres; NaN where no range is known."""
    sigma_m: Array
    """Standard deviation of `range_m`, metres."""
    state: NDArray[np.uint8]
    """`PixelState`."""

    @property
    def holes(self) -> NDArray[np.bool_]:
        """Pixels that no source gives."""
        return np.asarray(self.state != PixelState.SEEN)


def warp(
    sources: Sequence[Source], images: Sequence[Image], viewpoint_m: Array, rays: Array, *, fill: bool = False
) -> WarpedView:
    """The view from another viewpoint.

    Parameters
    ----------
    viewpoint_m
        `[3]`, metres, in the frame of the sources.
    rays
        `[rows, columns, 3]`: unit directions in that frame; NaN for pixels without a ray.
    fill
        Whether holes are filled, though their state stays: as if the map's surface went on between what is known; where
        there is none, from the nearest image as it is; and else from the nearest pixel.

    Raises
    ------
    ValueError
        When there is no source or no image.
    """
    if not sources or not images:
        raise ValueError("a view is warped from one map of ranges and one image at least")
    viewpoint_m = np.asarray(viewpoint_m, dtype=np.float64)
    shape = rays.shape[:2]
    flat = np.asarray(rays, dtype=np.float64).reshape(-1, 3)
    inside = np.isfinite(flat).all(axis=-1)
    looking = flat[inside]
    range_m, sigma_m = _met(sources, viewpoint_m, looking)
    state, guess_m = _states(sources, viewpoint_m, looking, np.isfinite(range_m))
    grey = _blended(sources, images, viewpoint_m, looking, range_m, sigma_m)
    state[(state == PixelState.SEEN) & np.isnan(grey)] = PixelState.UNSAMPLED
    if fill:
        guessed = _blended(sources, images, viewpoint_m, looking, np.where(np.isnan(grey), guess_m, np.nan), sigma_m)
        grey = np.where(np.isnan(grey), guessed, grey)
        left = np.flatnonzero(np.isnan(grey))
        grey[left] = untouched(images, viewpoint_m, looking[left][None])[0]

    def spread(values: NDArray[S], missing: float) -> NDArray[S]:
        out = np.full(len(flat), missing, dtype=values.dtype)
        out[inside] = values
        return out.reshape(shape)

    view = WarpedView(
        grey=spread(grey.astype(np.float32), np.nan),
        range_m=spread(range_m, np.nan),
        sigma_m=spread(sigma_m, np.nan),
        state=spread(state, PixelState.OUTSIDE),
    )
    if not fill:
        return view
    closed = np.where(np.asarray(inside).reshape(shape), view.grey[nearest_known(np.isfinite(view.grey))], view.grey)
    return replace(view, grey=closed)


def untouched(images: Sequence[Image], viewpoint_m: Array, rays: Array) -> NDArray[np.float32]:
    """The image whose viewpoint is nearest, in the directions of rays `[rows, columns, 3]`; NaN outside the image."""
    nearest = min(images, key=lambda each: float(np.linalg.norm(each.motion.t_v1 - viewpoint_m)))
    grey, valid = sample(nearest.grey, nearest.sensor, rays @ nearest.motion.R_v2_from_v1.T)
    return np.where(valid, grey, np.float32(np.nan))


def _met(sources: Sequence[Source], viewpoint_m: Array, rays: Array) -> tuple[Array, Array]:
    """Distance of the surface along each ray, metres, and its standard deviation.

    Of several surfaces the first counts, and those that agree with it within `SIGMAS` are averaged with it, by weights
    of 1 / sigma^2.
    """
    distances, sigmas = [], []
    for source in sources:
        begin, towards = _in_frame(source.motion, viewpoint_m, rays)
        distance, pixel = source.surface.meet(begin, towards)
        hit = pixel >= 0
        own = np.where(hit, source.surface.sigma_m.reshape(-1)[pixel], np.nan)
        # The error is along the map's own ray: the new ray, at a similar angle to the surface, has the same error.
        distances.append(distance)
        sigmas.append(np.where(np.isfinite(own), own, 0.0))
    distance, sigma = np.array(distances), np.array(sigmas)
    front = np.argmin(np.where(np.isnan(distance), np.inf, distance), axis=0)
    first, first_sigma = distance[front, np.arange(len(rays))], sigma[front, np.arange(len(rays))]
    agrees = np.abs(distance - first) <= np.maximum(SIGMAS * np.hypot(sigma, first_sigma), _HIDDEN * first)
    weight = np.where(agrees, 1 / (sigma**2 + (1e-6 * first) ** 2), 0.0)
    total = weight.sum(axis=0)
    met = total > 0
    safe = np.where(met, total, 1.0)
    mean = np.where(met, np.sum(np.where(agrees, distance, 0.0) * weight, axis=0) / safe, np.nan)
    return mean, np.where(met, 1 / np.sqrt(safe), np.nan)


def _states(
    sources: Sequence[Source], viewpoint_m: Array, rays: Array, met: NDArray[np.bool_]
) -> tuple[NDArray[np.uint8], Array]:
    """`PixelState` of each ray, and for those that meet nothing how far away the surface may be; NaN if unknown."""
    state = np.where(met, np.uint8(PixelState.SEEN), np.uint8(PixelState.OUTSIDE))
    guess_m = np.full(len(rays), np.nan)
    missing = np.flatnonzero(~met)
    for source in sources:
        begin, towards = _in_frame(source.motion, viewpoint_m, rays[missing])
        distance, behind, unmatched = source.surface.in_a_gap(begin, towards)
        # Where one map has no range, and another an outline, the state is a missing range.
        state[missing[behind & (state[missing] == PixelState.OUTSIDE)]] = PixelState.DISOCCLUDED
        state[missing[unmatched]] = PixelState.UNMATCHED
        guess_m[missing] = np.fmax(guess_m[missing], distance)  # an unseen surface is more likely far than near
    return state, guess_m


def _blended(
    sources: Sequence[Source], images: Sequence[Image], viewpoint_m: Array, rays: Array, range_m: Array, sigma_m: Array
) -> Array:
    """Grey level along each ray; NaN where no image shows the point."""
    total, weights = np.zeros(len(rays)), np.zeros(len(rays))
    met = np.flatnonzero(np.isfinite(range_m))
    sigma_m = np.nan_to_num(sigma_m)  # a guessed distance has no sigma
    points = viewpoint_m + rays[met] * range_m[met, None]
    for image in images:
        seen = image.motion.apply(points)
        distance = np.linalg.norm(seen, axis=-1)
        towards = seen / distance[:, None]
        grey, valid = sample(image.grey, image.sensor, towards[None])
        shown = valid[0] & ~_hidden(sources, image, towards, distance, sigma_m[met])
        sine = np.linalg.norm(np.cross(rays[met] @ image.motion.R_v2_from_v1.T, towards), axis=-1)
        moved = np.hypot(sigma_m[met], _UNTOLD * range_m[met]) * sine / distance
        pixel = 1 / np.maximum(pixels_per_steradian(image.sensor, towards), 1e-9)  # its square, in radians
        weight = np.where(shown, 1 / (moved**2 + pixel) ** 2, 0.0)
        total[met] += weight * np.where(shown, grey[0], 0.0)
        weights[met] += weight
    return np.where(weights > 0, total / np.where(weights > 0, weights, 1.0), np.nan)


def _hidden(
    sources: Sequence[Source], image: Image, towards: Array, distance: Array, sigma_m: Array
) -> NDArray[np.bool_]:
    """Whether a surface stands between an image's viewpoint and the points that it is to show."""
    hidden = np.zeros(len(towards), dtype=bool)
    to_sources = image.motion.R_v2_from_v1.T
    begin = image.motion.t_v1
    for source in sources:
        if np.allclose(source.motion.t_v1, begin, rtol=0, atol=1e-9):
            first = np.full(len(towards), np.nan)  # the map's own viewpoint: all its points are visible
            continue
        at, along = _in_frame(source.motion, begin, towards @ to_sources.T)
        first, _ = source.surface.meet(at, along)
        hidden |= first < distance - np.maximum(SIGMAS * sigma_m, _HIDDEN * distance)
    return hidden


def _in_frame(motion: Motion, viewpoint_m: Array, rays: Array) -> tuple[Array, Array]:
    """A viewpoint and rays of the sources' frame in another one."""
    return motion.apply(viewpoint_m), normalise(rays @ motion.R_v2_from_v1.T)
