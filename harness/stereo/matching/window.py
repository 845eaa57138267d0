"""The paper's matcher: a fixed square window moved along the epipolar curve, compared at the nearest pixel (section 4)."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import ndimage

from harness.camera.angles import Array
from harness.spec import Positive, Spec
from harness.stereo.epipolar import Curves, Sampling, alpha_2_at, epipolar_curves
from harness.stereo.matching import _kernels
from harness.stereo.matching.subpixel import Subpixel, refine
from harness.stereo.panorama import Panorama


class WindowMatcher(Spec):
    """Settings of the window matcher; the paper leaves all of them open but the cost, d_min's and d_max's existence
    and the parabola over three neighbours a side.

    - `window_px` 11: large enough for the LoG texture to be told apart, small enough that a window on a wall stays
      nearly at one disparity. Odd, so that it has a centre.
    - `sampling`, `pitch_px`: one sample a column, the panorama's own resolution.
    - `d_min_m` 1: the floor is nearest at the bottom row, 1.22 m away under a sensor 1 m high.
    - `d_max_m` 10: more than twice the farthest point of the paper's box (4.5 m), so that the limit hides no error,
      yet finite, so that every matched pixel has a range.
    """

    cost: Literal["sad", "ssd"] = "sad"
    window_px: Annotated[int, Field(ge=1, le=99)] = 11
    sampling: Sampling = "phi"
    pitch_px: Positive = 1.0
    d_min_m: Positive = 1.0
    d_max_m: Annotated[float, Field(gt=0)] = 10.0
    subpixel: Subpixel = "parabola"
    neighbours: Annotated[int, Field(ge=1, le=9)] = 3

    @model_validator(mode="after")
    def _sensible(self) -> "WindowMatcher":
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px must be odd, so that the window has a centre; found {self.window_px}")
        if not self.d_min_m < self.d_max_m:
            raise ValueError(f"d_min_m = {self.d_min_m:g} must be below d_max_m = {self.d_max_m:g}")
        return self


class Reason(IntEnum):
    """Why a pixel has no match (0: it has one)."""

    MATCHED = 0
    CURVE_LEAVES_IMAGE = 1
    """A sample of the curve, or its extremum, has no whole window in the second panorama."""
    WINDOW_LEAVES_IMAGE = 2
    """The pixel's own window is not whole in the first panorama."""
    NO_EPIPOLAR_PLANE = 3
    """The pixel looks along t, or n_z vanishes and phi cannot follow the curve."""
    NO_SAMPLE = 4
    """The search interval falls between two samples of the curve."""
    BEYOND_INFINITY = 5
    """There is a match, but its rays are parallel or diverge: no range."""


@dataclass(frozen=True)
class Matches:
    """What a matcher found: an angle for each pixel of view 1's panorama."""

    alpha_2: Array
    """`[height, width]`, radians; NaN where there is no match."""
    reason: NDArray[np.uint8]
    """`[height, width]`, `Reason`."""
    refined: NDArray[np.bool_]
    """`[height, width]`: moved off the whole sample by the sub-pixel step."""
    k: Array
    """`[height, width]`, position on the curve in samples; NaN where there is no match."""


@dataclass(frozen=True)
class WholePixelMatches:
    """The best sample of each curve and the costs around it: all that a sub-pixel step needs."""

    curves: Curves
    k: NDArray[np.int32]
    costs: Array
    """`[height, width, 2 reach + 1]`; NaN where a neighbouring sample has no whole window."""
    reason: NDArray[np.uint8]


def match_whole_pixels(
    first: Panorama, second: Panorama, t_v1: Array, matcher: WindowMatcher, *, threads: int | None = None
) -> WholePixelMatches:
    """Search the whole epipolar curve of every pixel; a tie goes to the sample nearer to infinity.

    Parameters
    ----------
    first, second
        Filtered panoramas on one grid, both in v1's orientation.
    t_v1
        `[3]`, metres.
    threads
        How many rows are matched at a time; all CPUs by default. The result does not depend on it.
    """
    grid = first.grid
    if second.grid != grid:
        raise ValueError("both panoramas must lie on one grid")
    curves = epipolar_curves(
        grid,
        t_v1,
        d_min_m=matcher.d_min_m,
        d_max_m=matcher.d_max_m,
        sampling=matcher.sampling,
        pitch_px=matcher.pitch_px,
    )
    reason = np.full(grid.shape, Reason.NO_SAMPLE, dtype=np.uint8)
    reason[~curves.defined] = Reason.NO_EPIPOLAR_PLANE
    matchable_1, matchable_2 = (_window_centres(image, matcher.window_px) for image in (first, second))
    reason[~matchable_1] = Reason.WINDOW_LEAVES_IMAGE
    searched = matchable_1 & curves.defined & (curves.k_last >= curves.k_first)
    lost = searched & ~_extremum_inside(curves, matchable_2)
    reason[lost] = Reason.CURVE_LEAVES_IMAGE
    searched &= ~lost

    k_best = np.zeros(grid.shape, dtype=np.int32)
    costs = np.full((*grid.shape, 2 * matcher.neighbours + 1), np.nan)
    shared = _shared_arguments(first, second, matcher, matchable_2)

    def work(rows: NDArray[np.intp]) -> None:
        _kernels.match_rows(
            rows,
            shared["mode"],
            shared["cost"],
            shared["first"],
            shared["second"],
            searched,
            matchable_2,
            shared["half"],
            grid.phi,
            curves.alpha_1,
            curves.step,
            curves.t / np.linalg.norm(curves.t),
            curves.m,
            curves.n,
            curves.k_first,
            curves.k_last,
            grid.z_max,
            grid.z_pitch,
            grid.phi_pitch,
            matcher.neighbours,
            reason,
            k_best,
            costs,
        )

    threads = threads or len(os.sched_getaffinity(0))
    rows = np.arange(grid.height_px)
    with ThreadPoolExecutor(threads) as pool:
        # Near rows cost more than far ones: deal the rows out like cards.
        list(pool.map(work, [rows[i :: 4 * threads] for i in range(4 * threads)]))
    return WholePixelMatches(curves, k_best, costs, reason)


def match(whole: WholePixelMatches, matcher: WindowMatcher) -> Matches:
    """Apply the sub-pixel step and turn samples into angles."""
    curves, matched = whole.curves, whole.reason == Reason.MATCHED
    offset, refined = refine(whole.costs, matcher.subpixel)
    # Between d_max and d_min, as the search itself: finite limits keep every range finite.
    k = whole.k + offset
    refined &= matched & (k >= curves.k_far) & (k <= curves.k_near)
    k = np.where(matched, np.where(refined, k, whole.k), np.nan)
    alpha_2 = np.full(k.shape, np.nan)
    alpha_2[matched] = alpha_2_at(curves, k[matched], (matched,))
    return Matches(alpha_2=alpha_2, reason=whole.reason, refined=refined, k=k)


def costs_along_curve(
    first: Panorama, second: Panorama, whole: WholePixelMatches, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs: what the paper's figure 3 draws."""
    curves, grid = whole.curves, first.grid
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    out = np.empty(ks.size)
    matchable_2 = _window_centres(second, matcher.window_px)
    shared = _shared_arguments(first, second, matcher, matchable_2)
    _kernels.costs_along_curve(
        ks,
        shared["mode"],
        shared["cost"],
        shared["first"],
        shared["second"],
        matchable_2,
        row,
        column,
        shared["half"],
        grid.phi[column],
        curves.alpha_1[row, column],
        curves.step[row, column],
        curves.t / np.linalg.norm(curves.t),
        curves.m[row, column],
        curves.n[row, column],
        grid.z_max,
        grid.z_pitch,
        grid.phi_pitch,
        out,
    )
    return ks, out


def _shared_arguments(first: Panorama, second: Panorama, matcher: WindowMatcher, matchable_2: Any) -> dict[str, Any]:
    half = matcher.window_px // 2
    return {
        "mode": {"phi": _kernels.PHI, "alpha": _kernels.ALPHA}[matcher.sampling],
        "cost": {"sad": _kernels.SAD, "ssd": _kernels.SSD}[matcher.cost],
        "first": np.pad(first.values, ((0, 0), (half, half)), mode="wrap"),
        "second": np.pad(second.values, ((0, 0), (half, half)), mode="wrap"),
        "half": half,
    }


def _window_centres(panorama: Panorama, window_px: int) -> NDArray[np.bool_]:
    """Pixels whose whole window is valid. The seam at phi = ±pi is no border; the first and last row are."""
    half = window_px // 2
    whole = ndimage.minimum_filter(panorama.valid, size=window_px, mode=("nearest", "wrap"))
    if half:
        whole[:half] = False
        whole[-half:] = False
    return np.ascontiguousarray(whole)


def _extremum_inside(curves: Curves, matchable_2: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the extremum of z_2(phi), where it falls into the search interval, lies at an allowed window centre.

    z_2(phi) = -(n_x cos phi + n_y sin phi)/n_z is extreme where phi points along (n_x, n_y) or against it.
    """
    grid = curves.grid
    inside = np.ones(grid.shape, dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.arctan2(curves.n[..., 1], curves.n[..., 0])
        horizontal = np.hypot(curves.n[..., 0], curves.n[..., 1])
        for phi, sign in ((along, -1.0), (along + np.pi, 1.0)):
            z = sign * horizontal / curves.n[..., 2]
            k = _k_of_phi(curves, phi, z)
            within = curves.defined & (k >= curves.k_first) & (k <= curves.k_last)
            row = np.floor((grid.z_max - z) / grid.z_pitch)
            column = np.floor((phi + np.pi) / grid.phi_pitch)
            on_image = within & (row >= 0) & (row < grid.height_px)
            ok = np.zeros(grid.shape, dtype=bool)
            ok[on_image] = matchable_2[row[on_image].astype(int), column[on_image].astype(int) % grid.width_px]
            inside &= ~within | ok
    return inside


def _k_of_phi(curves: Curves, phi: Array, z: Array) -> Array:
    """The sample number, a fraction, at which a curve passes the point (phi, z) on it."""
    if curves.sampling == "phi":
        turn = np.mod((phi - curves.grid.phi[None, :]) * np.sign(curves.step), 2 * np.pi)
        return np.asarray(turn / np.abs(curves.step))
    direction = np.stack([np.cos(phi), np.sin(phi), z], axis=-1)
    t_hat = curves.t / np.linalg.norm(curves.t)
    angle = np.arctan2(np.sum(direction * curves.m, axis=-1), direction @ t_hat)
    return np.asarray((angle - curves.alpha_1) / curves.step)
