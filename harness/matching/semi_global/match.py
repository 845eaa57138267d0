"""Semi-global matching around the seam (Hirschmüller 2005, 2008), on parallaxes.

**Labels** are whole steps k of alpha_2 - alpha_1, the angle that the baseline fills as seen from the point. It is
defined and continuous in every direction but those of t and -t themselves, where it tends to 0: paths run straight on
across their azimuths, where a label that counts columns changes its sign, and a vertical baseline is no exception.
`asin(|t|/d_min)` bounds the number of labels everywhere; in columns, the floor under the sensor takes twice as many.

**Views are compared on the sphere's longitudes and latitudes about the baseline.** There all points of an epipolar
curve lie in one row, the sample k of a pixel is k columns on, and a patch of the floor keeps its height and nearly its
width; on the cylinder, whose rows stretch towards the nadir, it may become five times as high from one view to the
other. This grid also has the rows of view 2 that its mirror image has and its panorama lacks: a tenth of the pixels of
the paper's box are seen in them. Each pixel of view 1's panorama is compared at the nearest point of this grid, the
same in both views, so that one image as both views has no parallax at all. What this rounding costs is the change of
the parallax over half a step, and measured, finer steps gain nothing.

**The matching cost** is the number of differing bits of census transforms (5 x 5, after a slight blur), averaged over a
box of pixels with one label. Any growing function of the grey levels leaves it as it is.

**Paths run over view 1's panorama.** Around a row they have no beginning and no end: each is followed until it
repeats itself, so that every pixel has the costs of an endless path, and a turn of the panorama by whole columns turns
the result. On the paper's box, corridor and room that takes 15 pixels beyond the first lap in the median and 86 at
most. (Where two ways around the whole row cost exactly the same, where it began may show.) Rows end above and below.
Labels outside a pixel's search interval cost what they cost and cannot win; to forbid them was no better.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import ndimage

from harness.camera.fill import Mask, closed_image, touches
from harness.camera.sensor import Sensor, project, seam_px
from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, Sampling, alpha_2_at, epipolar_curves, forget_curves
from harness.geometry.panorama import Grid, cylinder, directions
from harness.matching.grey_levels import Moments, grey_level_squared
from harness.matching.interface import MatcherSettings, Matches, Reason
from harness.matching.pair import Pair
from harness.matching.semi_global import _semi_global_kernels as kernels
from harness.matching.semi_global.paths import LARGE_BYTES, Rules, aggregate, aggregate_in_bands, forget_reused, reused
from harness.matching.semi_global.planes import fitted_to_planes, sine_and_cosine
from harness.matching.window.subpixel import refine
from harness.spec import Positive
from harness.threads import in_bands

PER_BIT = 2
"""Costs are counted in halves of a bit."""
BITS = (2 * kernels.REACH + 1) ** 2 - 1
"""Bits of a census code: the most that two pixels differ by."""
_PER_GREY = 16
"""Steps in a grey level of what the census compares, before the blur adds four bits."""
_LARGEST_GREY = 2.0**15
"""Larger grey levels are cut off, so that sums of steps fit 32 bits; none but hot pixels are as large."""


class SemiGlobal(MatcherSettings):
    """Settings of semi-global matching. One set for all scenes; measured on box, corridor and room, without noise and
    with 10 grey levels of it.
    """

    briefs: ClassVar[Mapping[str, str]] = {"sgm": "semi-global matching with a census cost"}

    kind: Literal["sgm"] = "sgm"
    """Semi-global matching."""
    sampling: Literal["alpha"] = "alpha"
    """Labels are steps of alpha_2."""
    pitch_px: Positive = 1.0
    """Distance of the labels, panorama pixels. With half of it, and half of P1, the median error on the box is 0.08
    px instead of 0.11; but at noise 10, 1.5 times as many pixels are off by more than 1 px, and the time nearly
    doubles."""
    blur: bool = True
    """Whether images are smoothed by (1 2 1)/4 along rows and columns before the census. Without it, the pixels off
    by more than 1 px are 0.1 % instead of 0.3 % on the box, and 14 % instead of 10 % in the corridor at noise 10."""
    box_px: Annotated[int, Field(ge=1, le=15)] = 5
    """Side of the box over which matching costs are averaged, pixels; odd. 3 is better at the room's edges and
    worse in noise; 7 is the opposite."""
    p1_bits: Annotated[float, Field(ge=0)] = 8.0
    """Cost of a step of one label from one pixel to the next, differing bits of 24. Half of it and one and a half times
    it are a little worse nearly everywhere."""
    p2_bits: Annotated[float, Field(ge=0)] = 64.0
    """Cost of a larger jump from one pixel to the next, differing bits of 24; at least `p1_bits`."""
    edge_grey: Annotated[float, Field(ge=0, le=255)] = 0.0
    """P2 becomes `max(P1, P2/(1 + |grey difference|/edge_grey))`, grey levels of which the images have 128 in the
    quadratic mean; Hirschmüller's idea. 0 leaves P2 as it is, since it gains nothing at the room's edges and more
    pixels are wrong in noise."""
    paths: Literal[4, 8] = 4
    """Directions of the paths: 4, along rows and columns, or 8 with the diagonals, which take 1.5 times as long
    and gain less in noise than they lose in the room."""
    subpixel: Literal["none", "parabola", "v"] = "v"
    """The sub-pixel step: `v`, two lines of opposite slopes through the best sum and its neighbours; `parabola`,
    through the same three, with a median error of 0.13 px; or `none`."""
    plane_px: Annotated[int, Field(ge=1, le=31)] = 9
    """Side of the square of panorama pixels whose sub-pixel matches a plane is fitted to; odd. Below 5 each match stays
    as it is. On the box the median error is 0.065 px instead of 0.114, and all three scenes gain, with noise and
    without. Larger squares have still smaller medians, and more pixels that are off by more than 1 px at edges."""
    consistency_px: Annotated[float, Field(ge=0)] = 2.0
    """A pixel whose match in view 2 is a better match of another pixel, with a parallax that differs by more than
    this many panorama pixels, is `INCONSISTENT`; 0 keeps all. At 2 nearly half of the room's wrong pixels are lost,
    and hardly any right ones of box and corridor; at 1 several times as many are, on slanted surfaces."""

    @model_validator(mode="after")
    def _sensible(self) -> "SemiGlobal":
        if self.box_px % 2 == 0:
            raise ValueError(f"box_px must be odd, so that the box has a centre; found {self.box_px}")
        if self.plane_px % 2 == 0:
            raise ValueError(f"plane_px must be odd, so that the square has a centre; found {self.plane_px}")
        if self.p1_bits > self.p2_bits:
            raise ValueError(f"p1_bits = {self.p1_bits:g} must not be above p2_bits = {self.p2_bits:g}")
        # A path cost is at most a matching cost and P2, P1 is added to it, and 8 bits must hold that.
        largest = 255 / PER_BIT - BITS
        if self.p1_bits + self.p2_bits > largest:
            raise ValueError(
                f"p1_bits + p2_bits must not be above {largest:g}; found {self.p1_bits:g} + {self.p2_bits:g}"
            )
        return self

    def match(self, pair: Pair) -> Matches:
        """The matches of the mirror images, resampled about the baseline."""
        return match_semi_global(pair, self)

    def match_seconds(self, image_mp: float, curve_mp: float) -> float:  # noqa: ARG002 - by the panorama alone
        """See `MatcherSettings.match_seconds`: paths through a volume of costs."""
        return 0.22 * curve_mp

    @property
    def step(self) -> str:
        """The sub-pixel step, by its name."""
        return self.subpixel

    def sampled(self, t_v1: Array) -> tuple[Sampling, float]:  # noqa: ARG002 - labels are steps of alpha_2
        """How the epipolar curves are sampled, and the distance of samples in columns."""
        return self.sampling, self.pitch_px

    @property
    def search(self) -> "SemiGlobal":
        """The search for the best label, which all sub-pixel steps and checks of consistency share."""
        return self.model_copy(update={"subpixel": "none", "plane_px": 1, "consistency_px": 0.0})


def match_semi_global(pair: Pair, matcher: SemiGlobal) -> Matches:
    """Match the mirror images, resampled about the baseline as `pair.interpolation` says.

    A pixel is `CURVE_LEAVES_IMAGE` if its best sample is in a direction that view 2 does not see, and `NO_MATCH` if a
    label that is not beside the best one costs no more: the match is ambiguous. Its confidence is the fraction by which
    the best label's costs are below those of the next one that is not beside it.
    """
    geometry = geometry_for(pair, matcher)
    settings = ("about the baseline", geometry.baseline_grid)
    views = pair.shared("about the baseline", settings, lambda: views_about_the_baseline(pair, geometry))
    searched = matcher.search
    result = pair.shared("match", searched, lambda: search(views, geometry, searched, pair.available_threads))
    return pair.shared("sub-pixel", matcher, lambda: match(result, geometry, matcher, pair.available_threads))


_LARGE_PX = 500_000
"""Pixels of a panorama from which a pair's geometry is not kept for the next pair: it takes 150 bytes for each."""


def forget_large(grid: Grid) -> None:
    """Give back the memory of a large panorama's geometry; to make it again takes a fiftieth of the matching."""
    if grid.width_px * grid.height_px > _LARGE_PX:
        forget_curves()
        geometry_of.cache_clear()
        sine_and_cosine.cache_clear()
        cylinder.cache_clear()
        _sampling_table.cache_clear()
        forget_reused()


# -- Geometry: depends on the pose and the limits alone, and is cached for the next pair of images ---------------------


@dataclass(frozen=True)
class BaselineGrid:
    """Longitudes and latitudes about t, the same for both views: row b is a half plane through t, column a an angle to
    t.
    """

    t_v1: tuple[float, float, float]
    rows: int
    """Once around, in steps of `2 pi/rows`."""
    columns: int
    step: float
    """Radians from a column to the next; column 0 looks along t."""

    @property
    def directions(self) -> Array:
        """`[rows, columns, 3]`, unit vectors in v1's frame."""
        t_hat, e_1, e_2 = frame_about(np.array(self.t_v1))
        around, alpha = np.arange(self.rows) * (2 * np.pi / self.rows), np.arange(self.columns) * self.step
        across = np.cos(around)[:, None] * e_1 + np.sin(around)[:, None] * e_2
        return np.cos(alpha)[:, None] * t_hat + np.sin(alpha)[:, None] * across[:, None, :]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Where on the baseline grid every pixel of view 1's panorama is compared."""

    curves: Curves
    baseline_grid: BaselineGrid
    around: NDArray[np.int32]
    along: NDArray[np.int32]
    """`[height, width]`: the row and column of `baseline_grid` nearest to the pixel's direction. Sample k is k columns
    on."""
    k_0: int
    """The first label: one before any searched one, for the sub-pixel fit."""
    labels: int
    """How many; whole blocks, and at least one more than is searched."""


def frame_about(t: Array) -> tuple[Array, Array, Array]:
    """Three unit vectors at right angles to each other, the first along t."""
    t_hat = t / np.linalg.norm(t)
    reference = np.eye(3)[0 if abs(t_hat[2]) > 0.9 else 2]
    e_1 = reference - (reference @ t_hat) * t_hat
    e_1 /= np.linalg.norm(e_1)
    return t_hat, e_1, np.cross(t_hat, e_1)


def geometry_for(pair: Pair, matcher: SemiGlobal) -> Geometry:
    """The geometry of this pair, within the matcher's limits."""
    curves = epipolar_curves(
        pair.grid,
        pair.t_v1,
        d_min_m=matcher.d_min_m,
        d_max_m=matcher.d_max_m,
        sampling="alpha",
        pitch_px=matcher.pitch_px,
    )
    return geometry_of(curves)


@lru_cache(maxsize=4)
def geometry_of(curves: Curves) -> Geometry:
    """The geometry of curves that are sampled in alpha_2."""
    step = float(curves.step[0, 0])
    _, e_1, e_2 = frame_about(curves.t)
    x = directions(curves.grid)
    rows = max(1, round(2 * np.pi / step))
    x_, y_, z_ = (float(value) for value in curves.t)
    baseline_grid = BaselineGrid((x_, y_, z_), rows, math.ceil(np.pi / step) + 1, step)
    around = np.rint(np.arctan2(x @ e_2, x @ e_1) * (rows / (2 * np.pi))).astype(np.int32) % rows
    along = np.rint(curves.alpha_1 / step).astype(np.int32)
    searched = curves.k_last >= curves.k_first
    k_0 = int(curves.k_first[searched].min(initial=0)) - 1
    needed = int(curves.k_last[searched].max(initial=0)) + 2 - k_0
    labels = kernels.BLOCK * math.ceil(needed / kernels.BLOCK)
    return Geometry(curves, baseline_grid, around, along, k_0, labels)


# -- Images ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class View:
    """An image on the `BaselineGrid`."""

    values: NDArray[np.int32]
    """`[rows, columns]`, sixteenths of a grey level; 0 where not valid."""
    valid: NDArray[np.bool_]


def views_about_the_baseline(pair: Pair, geometry: Geometry) -> tuple[View, View]:
    """The mirror images on the baseline grid, both in v1's orientation.

    A pixel that is not finite, or masked, is not valid, and neither is any whose census would use it.

    Images of any unit get about as many steps: both are divided by one of their grey levels (`grey_levels`), rounded to
    a power of two, so that no bit changes by what else is in the images, such as what a mask hides.
    """
    order = {"bilinear": 1, "cubic": 3}[pair.interpolation]
    closed = [
        closed_image(image, sensor, seam_px(sensor)) for image, sensor in zip(pair.images, pair.sensors, strict=True)
    ]
    squared = grey_level_squared([Moments.of(image, known) for image, known, _ in closed])
    scale = 2.0 ** -round(math.log2(squared) / 2) if squared > 0 else 1.0

    def view(one: tuple[NDArray[np.float32], Mask, Mask | None], sensor: Sensor, R: Array) -> View:
        image, _, gaps = one
        coordinates, valid = _sampling_table(sensor, geometry.baseline_grid, R.tobytes())
        if gaps is not None:
            gaps = touches(gaps, coordinates, order)
            reach = kernels.REACH + 1  # the blur's
            valid = valid & ~ndimage.maximum_filter(gaps, size=2 * reach + 1, mode=("wrap", "nearest"))
        values = ndimage.map_coordinates(image, coordinates, order=order, mode="nearest", output=np.float32)
        values = np.where(valid, np.clip(scale * values, 0, _LARGEST_GREY), 0)
        return View(np.rint(values * _PER_GREY).astype(np.int32), valid)

    rotations = np.eye(3), pair.motion.R_v2_from_v1
    first, second = map(view, closed, pair.sensors, rotations)
    return first, second


@lru_cache(maxsize=8)
def _sampling_table(sensor: Sensor, baseline_grid: BaselineGrid, rotation: bytes) -> tuple[Array, NDArray[np.bool_]]:
    """Where each direction is sampled on the mirror image, continued across its seam if it has one, (rows, columns);
    and whether the sensor sees it.
    """
    pixels, valid = project(sensor, baseline_grid.directions @ np.frombuffer(rotation).reshape(3, 3).T)
    coordinates = np.ascontiguousarray(np.nan_to_num(pixels[..., ::-1], nan=-1.0).transpose(2, 0, 1))
    coordinates[1] += seam_px(sensor)
    coordinates.flags.writeable = False
    valid.flags.writeable = False
    return coordinates, valid


# -- Search ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best label of every pixel; all `[height, width]`."""

    best: NDArray[np.int32]
    """Labels from `Geometry.k_0` on; -1 where none is searched."""
    nearby: NDArray[np.uint16]
    """`[height, width, 3]`: sums over all paths at the best label and beside it."""
    second: NDArray[np.uint16]
    """The least sum of a searched label that is not beside the best one."""
    valid_1: NDArray[np.bool_]
    valid_2: NDArray[np.bool_]
    """Whether the views see the pixel, and its best sample."""


def search(views: tuple[View, View], geometry: Geometry, matcher: SemiGlobal, threads: int) -> SearchResult:
    """Costs, paths, and the best label of every pixel; a tie goes to the one nearer to infinity."""
    curves, margin = geometry.curves, geometry.labels + abs(geometry.k_0)
    shape, rows_and_columns = (*curves.grid.shape, geometry.labels), views[0].values.shape
    codes = [
        reused(f"codes {view}", (rows_and_columns[0], rows_and_columns[1] + 2 * margin), np.uint32) for view in (1, 2)
    ]
    blurred = reused("blurred", rows_and_columns, np.int32)

    def transform(first: int, end: int) -> None:
        # View 1 last: its blurred image is what stays.
        for view in (1, 0):
            values, valid = views[view].values, views[view].valid
            kernels.census(values, valid, matcher.blur, margin, first, end, blurred, codes[view])

    def compare(first: int, end: int, top: int, costs: NDArray[np.uint8]) -> None:
        kernels.matching_costs(
            codes[0],
            codes[1],
            geometry.around,
            geometry.along,
            margin,
            geometry.k_0,
            matcher.box_px // 2,
            round(PER_BIT * 2**16 / matcher.box_px**2),
            first,
            end,
            top,
            costs,
        )

    in_bands(transform, rows_and_columns[0], threads, threads)
    grey = blurred[geometry.around, geometry.along] / (16.0 * _PER_GREY) if matcher.edge_grey else None
    p2 = jumps(grey, shape[:2], matcher)
    interval = geometry.k_0, curves.k_first, curves.k_last
    rules = rules_of(matcher, p2)
    if math.prod(shape) <= LARGE_BYTES:
        costs = reused("costs", shape, np.uint8)
        in_bands(lambda first, end: compare(first, end, 0, costs), shape[0], threads, threads)
        best, nearby, second = aggregate(costs, interval, rules, threads)
    else:
        best, nearby, second = aggregate_in_bands(compare, shape, interval, rules, threads)
    valid_1, valid_2 = np.empty((2, *curves.grid.shape), dtype=bool)
    ahead = np.maximum(best, 0) + geometry.k_0

    def look(first: int, end: int) -> None:
        kernels.valid_in_both(*codes, geometry.around, geometry.along, margin, ahead, first, end, valid_1, valid_2)

    in_bands(look, shape[0], threads, threads)
    return SearchResult(best, nearby, second, valid_1, valid_2)


def rules_of(matcher: SemiGlobal, p2: NDArray[np.uint8]) -> Rules:
    """The matcher's penalties, `p2` as `jumps` makes it."""
    return Rules(p2, round(PER_BIT * matcher.p1_bits), matcher.paths)


def jumps(grey: Array | None, shape: tuple[int, int], matcher: SemiGlobal) -> NDArray[np.uint8]:
    """P2 in halves of a bit, `[4, height, width]`: between a pixel and the one to the left of it, above it, to its
    upper left and to its upper right; the last three mean nothing in the first row.

    Parameters
    ----------
    grey
        `[height, width]`, grey levels; None for one P2 everywhere.
    """
    p1, p2 = PER_BIT * matcher.p1_bits, PER_BIT * matcher.p2_bits
    if grey is None or not matcher.edge_grey:
        return np.full((4, *shape), round(p2), dtype=np.uint8)
    steps = np.stack([np.abs(grey - np.roll(grey, shift, axis=(0, 1))) for shift in ((0, 1), (1, 0), (1, 1), (1, -1))])
    return np.rint(np.maximum(p1, p2 / (1 + steps / matcher.edge_grey))).astype(np.uint8)


# -- Answer ------------------------------------------------------------------------------------------------------------


def match(result: SearchResult, geometry: Geometry, matcher: SemiGlobal, threads: int = 1) -> Matches:
    """Check whether matches agree with each other, apply the sub-pixel step and fit planes, and turn samples into
    angles.
    """
    curves = geometry.curves
    reason = np.full(curves.grid.shape, Reason.MATCHED, dtype=np.uint8)
    reason[result.second == result.nearby[..., 1]] = Reason.NO_MATCH
    reason[~result.valid_2] = Reason.CURVE_LEAVES_IMAGE
    reason[result.best < 0] = Reason.NO_SAMPLE
    reason[~curves.defined] = Reason.NO_EPIPOLAR_PLANE
    reason[~result.valid_1] = Reason.WINDOW_LEAVES_IMAGE
    sample = result.best + geometry.k_0
    if matcher.consistency_px:
        is_best = np.ones(curves.grid.shape, dtype=bool)
        kernels.consistent(
            geometry.around,
            geometry.along,
            np.where(reason == Reason.MATCHED, sample, -1),
            result.nearby[..., 1],
            math.floor(matcher.consistency_px / matcher.pitch_px + 1e-9),
            geometry.baseline_grid.rows,
            geometry.baseline_grid.columns + geometry.labels,
            is_best,
        )
        reason[~is_best] = Reason.INCONSISTENT
    matched = reason == Reason.MATCHED

    offset, refined = refine(result.nearby.astype(np.float64), matcher.subpixel)
    k = sample + offset
    # Between d_max and d_min, as the search itself: finite limits keep every range finite.
    refined &= matched & (k >= curves.k_far) & (k <= curves.k_near)
    k = np.where(matched, np.where(refined, k, sample), np.nan)
    if matcher.subpixel != "none" and matcher.plane_px > 4:
        fitted = fitted_to_planes(k, curves, matcher.plane_px, threads)
        on_plane = (fitted >= curves.k_far) & (fitted <= curves.k_near)
        k, refined = np.where(on_plane, fitted, k), refined | on_plane
    alpha_2 = alpha_2_at(curves, k)
    # Where there is a match, the rival costs more, and so more than nothing.
    confidence = np.where(matched, 1 - result.nearby[..., 1] / np.maximum(result.second, 1), np.nan)
    return Matches(alpha_2=alpha_2, confidence=confidence, reason=reason, refined=refined, k=k)
