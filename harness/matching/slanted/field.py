"""The field of planes over a mirror image, and its Gauss-Newton steps.

A field takes 76 bytes a pixel, view 2's 52. Only the part of the image that the sensor sees has one. What is known to
no better than a few digits, or is as exact as the images are, is in single precision.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera._field_kernels import FieldLimits
from harness.camera.fill import across_seam, nearest_known
from harness.camera.sensor import Sensor, field_of, parameters_of, pixel_directions, project
from harness.camera.spline_noise import noise_through_spline
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.machine import available_cpus
from harness.matching.slanted import _fit_kernels, _median_kernels, _reading_kernels
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.noise import Noise
from harness.matching.slanted.settings import Slanted
from harness.matching.slanted.smoothing import smoothed
from harness.threads import Item, in_pool

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_BAND = 40
"""Rows that are worked on at a time; fixed, as a running sum begins anew in each."""

_LEAST_SHARE = 0.35
"""The least share of a window's pixels that must be there: a straight border through its middle leaves half."""

_SLOPE_WEIGHT = 0.0025
"""A weak prior: slopes of inverse range are 0 ± 2 (1/m per radian), at a noise of a tenth of the contrast."""

_APART_PX = 0.3
"""Planes closer than this count as one surface in the choice between windows."""

_CENTRE_BONUS = 0.8
"""A moved window has to fit better by a fifth: a patch's mean square has a relative standard deviation of a quarter."""

_RESIDUAL_WEIGHT = 0.5
"""Weight of a window's own residual, beside that of the patch, in the choice."""

_BEYOND = 2.0
"""Planes may be nearer than the search goes by this factor: what is on both sides of the limit is one surface, and
windows that see it need its pixels. They are no matches."""

_MEDIAN_REACH = 2
"""Reach of the median over the start, pixels: it removes single outliers and pairs of them."""


# -- Geometry and images -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """The rows and columns of an image, continued across its seam, that a field is of."""

    sensor: Sensor
    seam: int
    """Columns by which the image is continued on both sides."""
    rows: slice
    """From a multiple of the bands' height on: running sums then begin where they do on the whole image."""
    columns: slice

    @property
    def at(self) -> tuple[slice, slice]:
        """The index of the part."""
        return self.rows, self.columns

    @property
    def once(self) -> slice:
        """Those of its columns that are no continuation, counted in the part."""
        begin = self.seam - self.columns.start
        return slice(max(begin, 0), begin + self.sensor.camera.width_px)


def part_of(sensor: Sensor, seam: int, known: Mask) -> Part:
    """The part of an image that is known, and a pixel more, since pixels are compared with the next ones."""
    if not known.any():
        return Part(sensor, seam, slice(0, known.shape[0]), slice(0, known.shape[1]))
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    first = max(int(rows[0]) - 1, 0) // _BAND * _BAND
    return Part(
        sensor,
        seam,
        slice(first, min(int(rows[-1]) + 2, known.shape[0])),
        slice(max(int(columns[0]) - 1, 0), min(int(columns[-1]) + 2, known.shape[1])),
    )


@dataclass(frozen=True)
class Warp:
    """How points map from one view to the other, for the kernels: pixels of the one, the camera of the other."""

    t: Array
    R: Array
    s: Array
    """-R t: the derivative of q = R x + w s by the inverse range w."""
    camera: tuple[Any, FieldLimits, float, float]
    """The other view's camera model and limits of its field; if its image is periodic, the number of columns that it is
    continued by, and of those in a turn; else 0."""
    x: Array
    """`[rows, columns, 3]`, unit directions of the first of the two views' mirror pixels, of its part."""
    valid: Mask
    """`[rows, columns]`: pixels of the first of the two that the sensor sees, and that are finite."""


def warp_between(part: Part, other: Part, motion: Motion, known: Mask) -> Warp:
    """The warp from the part of one view to the other view; `known` are the pixels of the part's whole image."""
    x = np.ascontiguousarray(across_seam(pixel_directions(part.sensor)[0], part.seam)[part.at])
    t, R = (np.ascontiguousarray(a, dtype=np.float64) for a in (motion.t_v1, motion.R_v2_from_v1))
    turn = float(other.sensor.camera.width_px) if other.seam else 0.0
    camera = (parameters_of(other.sensor), field_of(other.sensor), float(other.seam), turn)
    return Warp(t, R, -R @ t, camera, x, np.ascontiguousarray(known[part.at]))


@dataclass(frozen=True)
class View:
    """A view's image, as what is explained and as what explains."""

    image: Image
    """Its part."""
    coefficients: Image
    """Coefficients of the whole image's interpolating cubic B-spline; NaN where the sensor sees nothing."""
    blur: float
    """How far both were smoothed; see `smoothing`."""
    noise: tuple[float, float]
    """Variances, along an axis, of its noise once it is interpolated, and of the slope's, for a variance of 1."""


def view_of(image: Image, valid: Mask, part: Part, blur: float = 0.0) -> View:
    """The view of an image without gaps, smoothed if it is noisy."""
    whole = image[nearest_known(valid)]
    if blur:
        whole = smoothed(whole, blur)
        image = np.where(valid, whole, image)
    spline = ndimage.spline_filter(whole, 3, output=np.float32, mode="mirror")
    return View(
        np.ascontiguousarray(image[part.at], dtype=np.float32),
        np.where(valid, spline, np.float32(np.nan)),
        blur,
        noise_through_spline((1 - 2 * blur, blur)),
    )


# -- Gauss-Newton ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Field:
    """Every mirror pixel's window, and the window that it takes its plane from; all `[height, width]`."""

    plane: Array
    """`[..., 3]`, m."""
    covariance: Image
    """`[..., 6]`: the inverse normal matrix in tangent coordinates, upper triangle; `[0, 0, 6]` if not needed."""
    residual: Image
    """Variance in grey levels squared; infinite where there is no plane."""
    gain: Image
    offset: Image
    share: Image
    """How much of the sum of g² is noise."""
    w: Array
    """1/m, NaN where there is none."""
    chosen: NDArray[np.int32]
    """Flat index of the window; -1 where there is none."""


@dataclass(frozen=True)
class Samples:
    """View 2 at the field; all `[height, width]`."""

    known: Mask
    value: Image
    slope: Image
    motion: Image


def in_rows(pool: ThreadPoolExecutor, height: int, work: Callable[..., None], *arguments: object) -> None:
    """Run a kernel on all bands of rows."""
    in_turn(pool, range(0, height, _BAND), lambda first: work(first, min(first + _BAND, height), *arguments))


def in_turn(pool: ThreadPoolExecutor, items: Iterable[Item], work: Callable[[Item], None]) -> None:
    """Do some work with all items; see `in_pool`."""
    in_pool(pool, work, items, available_cpus())


def sample(w: Array, second: View, warp: Warp, samples: Samples, pool: ThreadPoolExecutor) -> None:
    """Write view 2's samples at a field of inverse ranges."""
    in_rows(
        pool, len(w), _kernels.warp_rows, warp.valid, warp.x, w, warp.R, warp.s, warp.camera, second.coefficients,
        samples.known, samples.value, samples.slope, samples.motion,
    )  # fmt: skip


def no_samples(shape: tuple[int, ...]) -> Samples:
    """Memory for samples."""
    return Samples(np.zeros(shape, bool), *np.zeros((3, *shape), np.float32))


@dataclass(frozen=True)
class Step:
    """How a Gauss-Newton step is taken."""

    window_px: int
    """Side of the windows, odd."""
    sharp: bool
    """Whether pixels choose between planes by patches, too, and the step goes no farther than its solution."""


def steps_forth(settings: Slanted) -> tuple[Step, ...]:
    """The steps of view 1: narrow windows, then wide ones, of which the last are sharp."""
    sharp = min(settings.sharp_iterations, settings.iterations)
    far = settings.iterations - sharp
    narrow = min(settings.narrow_iterations, far)
    return (
        *[Step(narrow_px(settings), sharp=False)] * narrow,
        *[Step(settings.window_px, sharp=False)] * (far - narrow),
        *[Step(settings.window_px, sharp=True)] * sharp,
    )


def steps_back(settings: Slanted) -> tuple[Step, ...]:
    """The steps of view 2, which begin at what view 1 ended with: wide windows bridge the gaps that its points leave
    where view 2 has more pixels, narrow ones keep borders where they are.
    """
    return Step(settings.window_px, sharp=False), Step(narrow_px(settings), sharp=True)


def narrow_px(settings: Slanted) -> int:
    """Side of a narrow window: two thirds of the others', odd, and no less than a plane with gain and offset needs."""
    return max(2 * (settings.window_px // 3) + 1, 5)


def field_from(start: Array, warp: Warp, pool: ThreadPoolExecutor, *, covariance: bool = True) -> Field:
    """A field without planes, at a start: `[rows, columns]`, 1/m, NaN where there is none.

    Parameters
    ----------
    covariance
        Whether it is wanted.
    """
    shape = start.shape
    field = Field(
        plane=np.zeros((*shape, 3)),
        covariance=np.zeros((*(shape if covariance else (0, 0)), 6), np.float32),
        residual=np.full(shape, np.inf, np.float32),
        gain=np.ones(shape, np.float32),
        offset=np.zeros(shape, np.float32),
        share=np.ones(shape, np.float32),
        w=np.empty(shape),
        chosen=np.full(shape, -1, np.int32),
    )
    in_rows(pool, len(start), _median_kernels.median_rows, _MEDIAN_REACH, warp.valid, start, field.w)
    return field


def advance(
    field: Field,
    first: View,
    second: View,
    warp: Warp,
    noise: Noise,
    settings: Slanted,
    steps: tuple[Step, ...],
    pixel: float,
    pool: ThreadPoolExecutor,
) -> None:
    """Take some steps from where the field is.

    Parameters
    ----------
    noise
        Of the first view against that of the second.
    pixel
        Angle of a pixel of the panorama, radians.
    """
    rows = len(field.w)
    samples, none = no_samples(field.w.shape), np.zeros((0, 0, 6), np.float32)
    for number, step in enumerate(steps, 1):
        sample(field.w, second, warp, samples, pool)
        half, reach = step.window_px // 2, settings.patch_px // 2 if step.sharp else -1
        in_rows(
            pool, rows, _fit_kernels.fit_rows, half, _LEAST_SHARE * step.window_px**2, _SLOPE_WEIGHT,
            not step.sharp, noise.for_fit(second.noise), warp.valid, warp.x, field.w, first.image, samples.known,
            samples.value, samples.slope, samples.motion, field.plane,
            field.covariance if number == len(steps) else none, field.residual, field.gain, field.offset, field.share,
        )  # fmt: skip
        in_rows(
            pool, rows, _kernels.choose_rows, half, reach, _APART_PX * pixel, _CENTRE_BONUS,
            _RESIDUAL_WEIGHT, 1 / settings.d_max_m, _BEYOND / settings.d_min_m, warp.valid, warp.x, warp.t, warp.R,
            warp.s, warp.camera, first.image, second.coefficients, field.plane, field.residual, field.gain,
            field.offset, field.w, field.chosen,
        )  # fmt: skip


def read_planes(field: Field, x: Array, part: Part) -> tuple[NDArray[np.intp], NDArray[np.int32], Array]:
    """Flat index of the mirror pixel nearest to each direction, the window that it takes its plane from, and that
    plane's inverse range in the direction itself; NaN where the direction is not seen or there is no plane.
    """
    pixels, valid = project(part.sensor, x)
    index, window, w = np.empty(valid.shape, np.intp), np.empty(valid.shape, np.int32), np.empty(valid.shape)
    _reading_kernels.read(
        pixels.reshape(-1, 2), valid.ravel(), np.ascontiguousarray(x).reshape(-1, 3), part.rows.start,
        part.columns.start - part.seam, field.plane, field.chosen, index.ravel(), window.ravel(), w.ravel(),
    )  # fmt: skip
    return index, window, w
