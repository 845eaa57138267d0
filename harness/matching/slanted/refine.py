"""Slanted windows fitted by least squares, on the mirror images themselves.

On a plane inverse range is linear in the direction, 1/d = m · x. A point in direction x of view 1 lies along
q = R (x - (m·x) t) of view 2, so a window of view 1 is compared with view 2 by

    I_1(x_i) = a I_2(q_i(m)) + b,

and m, three numbers, is found by Gauss-Newton. No panorama lies between: view 1 is taken at its own pixels, whose noise
is white, view 2 between its pixels, by the interpolating cubic B-spline.

All windows share one sample of view 2 for each pixel. With a field of inverse ranges w_i and g_i = dI_2/dw there,
I_2(q_i(m)) = I_2(w_i) + g_i (m·x_i - w_i) to first order, for every plane m near the field. So the normal equations of
all windows are sums of products that belong to the pixels, running sums whatever the window's size: one step for all
windows costs a sample, 27 sums and a 3x3 system a pixel. The planes are the next field.

A window across the border of two surfaces fits neither of them. So a pixel may take the plane of a window beside it, if
that fits the pixel's own surroundings better: it keeps borders sharp, and carries planes to where the start was wrong
or missing. At last view 2 is fitted to view 1 in the same way; where the two contradict each other, there is no match.

The standard deviation is that of least squares, from the window's own residual, with three corrections; see `_sigma`.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera._field_kernels import FieldLimits
from harness.camera.fill import across_seam, closed_image, nearest_known
from harness.camera.sensor import Sensor, field_of, parameters_of, pixel_directions, project, seam_px
from harness.geometry.angles import Array, angle_between, normalise
from harness.geometry.panorama import Grid, directions, pixel_that_holds
from harness.geometry.pose import Motion
from harness.machine import available_cpus
from harness.matching.interface import Matches, Reason
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.settings import Slanted

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

_AMBIGUOUS = 1.1
"""If a second plane fits within a tenth as well, the match is ambiguous: there is no texture to decide."""

_MEDIAN_REACH = 2
"""Reach of the median over the start, pixels: it removes single outliers and pairs of them."""

_TEXTURED = 0.25
"""The least texture per pixel that a pixel's surroundings need, as a share of the window's."""

_ACROSS_SEAM = 6
"""How many windows a periodic image is continued by on both sides."""

_CORRELATED_PX = 33
"""Width of the square over which correlation is measured: four windows, as one is too few to measure it by."""


def refine_slanted(
    images: tuple[Image, Image],
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    grid: Grid,
    start_alpha_2: Array,
    *,
    settings: Slanted | None = None,
    threads: int | None = None,
) -> Matches:
    """Refine a start that is right to about a pixel over most of the panorama.

    Parameters
    ----------
    images
        Mirror images of both views, `[sensor height, sensor width]`.
    sensors
        The sensor of each view.
    grid
        View 1's panorama, of the start and of the result.
    start_alpha_2
        `[height, width]`, radians; NaN where there is none.
    threads
        All available CPUs when None. The result does not depend on it.

    Returns
    -------
    matches
        With `sigma_alpha_2`, and its inverse as confidence. `Reason.NO_MATCH`: no window with texture, none of it near
        the pixel, no plane between d_min and d_max, two that fit alike, or a standard deviation above `max_sigma_px`.
        `Reason.INCONSISTENT`: the match back from view 2 leads elsewhere.

    Raises
    ------
    ValueError
        When an image does not have its sensor's size, or the start not the grid's.
    """
    settings = settings or Slanted()
    sizes = tuple((each.camera.height_px, each.camera.width_px) for each in sensors)
    shapes = tuple(image.shape for image in images)
    if shapes != sizes:
        raise ValueError(
            f"the images are {shapes[0]} and {shapes[1]}, the sensors {sizes[0]} and {sizes[1]} (rows, columns)"
        )
    if start_alpha_2.shape != grid.shape:
        raise ValueError(f"the start is {start_alpha_2.shape}, the panorama {grid.shape} (rows, columns)")
    # Windows, samples and whatever planes are carried over go on across the seam of images that go round.
    reach = _ACROSS_SEAM * settings.window_px
    seams = seam_px(sensors[0], reach), seam_px(sensors[1], reach)
    closed = [closed_image(*each)[:2] for each in zip(images, sensors, seams, strict=True)]
    first, second = (_view(image, known) for image, known in closed)
    forth_warp = _warp(sensors, seams, motion, closed[0][1])
    back_warp = _warp(sensors[::-1], seams[::-1], _reversed(motion), closed[1][1])
    with ThreadPoolExecutor(threads or available_cpus()) as pool:
        start = _start(start_alpha_2, forth_warp, grid)
        forth = _fit(first, second, forth_warp, start, settings, settings.iterations, grid.phi_pitch, pool)
        start = _transferred(forth, forth_warp, back_warp.valid.shape, seams[1])
        samples = _nothing(forth.w.shape)
        _sampled(forth.w, second, forth_warp, samples, pool)
        inflation = _inflation(forth, first, samples, forth_warp, pool)
        read = _on_panorama(forth, inflation, samples, forth_warp, (sensors[0], seams[0]), grid, settings)
        del forth, samples, inflation  # a field takes 128 bytes a pixel: one at a time
        reverse = _fit(second, first, back_warp, start, settings, settings.sharp_iterations, grid.phi_pitch, pool)
    return _matches(read, reverse, forth_warp, (sensors[1], seams[1]), grid, settings)


# -- Geometry and images -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Warp:
    """How points map from one view to the other, for the kernels: pixels of the one, the camera of the other."""

    t: Array
    R: Array
    s: Array
    """-R t: the derivative of q = R x + w s by the inverse range w."""
    camera: tuple[Any, FieldLimits, float, float]
    """The other view's camera model and limits of its field; if its image is periodic, the number of columns that it is
    continued by, and of those in a turn; else 0."""
    x: Array
    """`[height, width, 3]`, unit directions of the first of the two views' mirror pixels, continued across the seam."""
    valid: Mask
    """`[height, width]`: pixels of the first of the two that the sensor sees, and that are finite."""


def _warp(sensors: tuple[Sensor, Sensor], seams: tuple[int, int], motion: Motion, known: Mask) -> _Warp:
    sensor, other = sensors
    x = across_seam(pixel_directions(sensor)[0], seams[0])
    t, R = (np.ascontiguousarray(a, dtype=np.float64) for a in (motion.t_v1, motion.R_v2_from_v1))
    turn = float(other.camera.width_px) if seams[1] else 0.0
    camera = (parameters_of(other), field_of(other), float(seams[1]), turn)
    return _Warp(t, R, -R @ t, camera, x, known)


def _reversed(motion: Motion) -> Motion:
    R = motion.R_v2_from_v1
    return Motion(R_v2_from_v1=R.T, t_v1=-R @ motion.t_v1)


@dataclass(frozen=True)
class _View:
    image: Image
    coefficients: Image
    """Coefficients of the interpolating cubic B-spline; NaN where the sensor sees nothing."""


def _view(image: Image, valid: Mask) -> _View:
    spline = ndimage.spline_filter(image[nearest_known(valid)], 3, output=np.float32, mode="mirror")
    return _View(np.ascontiguousarray(image, dtype=np.float32), np.where(valid, spline, np.float32(np.nan)))


def _start(alpha_2: Array, warp: _Warp, grid: Grid) -> Array:
    """Inverse range of every mirror pixel that the panorama covers; NaN elsewhere.

    From d_1 = |t| sin(alpha_2)/sin(alpha_2 - alpha_1).
    """
    row, column, inside = pixel_that_holds(grid, np.nan_to_num(warp.x))
    with np.errstate(invalid="ignore", divide="ignore"):
        w = np.sin(alpha_2 - angle_between(directions(grid), warp.t)) / (np.linalg.norm(warp.t) * np.sin(alpha_2))
    covered = warp.valid & inside
    field = np.full(warp.valid.shape, np.nan)
    field[covered] = w[row[covered].astype(np.intp), column[covered]]
    return field


# -- Gauss-Newton ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Field:
    """Every mirror pixel's window, and the window that it takes its plane from; all `[height, width]`."""

    plane: Array
    """`[..., 3]`, m."""
    covariance: Array
    """`[..., 6]`: the inverse normal matrix in tangent coordinates, upper triangle by rows."""
    residual: Array
    """Variance in grey levels squared; infinite where there is no plane."""
    gain: Array
    offset: Array
    share: Array
    """How much of the sum of g² is noise."""
    w: Array
    """1/m, NaN where there is none."""
    chosen: NDArray[np.int64]
    """Flat index of the window; -1 where there is none."""
    rival: Array
    """How much worse the next best plane fits, as a ratio."""


@dataclass(frozen=True)
class _Samples:
    """View 2 at the field; all `[height, width]`."""

    known: Mask
    value: Image
    slope: Image
    motion: Image


def _rows(pool: ThreadPoolExecutor, height: int, work: Callable[..., None], *arguments: object) -> None:
    """Run a kernel on all bands of rows."""
    list(pool.map(lambda first: work(first, min(first + _BAND, height), *arguments), range(0, height, _BAND)))


def _sampled(w: Array, second: _View, warp: _Warp, samples: _Samples, pool: ThreadPoolExecutor) -> None:
    _rows(
        pool, len(w), _kernels.warp_rows, warp.valid, warp.x, w, warp.R, warp.s, warp.camera, second.coefficients,
        samples.known, samples.value, samples.slope, samples.motion,
    )  # fmt: skip


def _nothing(shape: tuple[int, ...]) -> _Samples:
    return _Samples(np.zeros(shape, bool), *np.zeros((3, *shape), np.float32))


def _fit(
    first: _View,
    second: _View,
    warp: _Warp,
    start: Array,
    settings: Slanted,
    iterations: int,
    pixel: float,
    pool: ThreadPoolExecutor,
) -> _Field:
    shape, half = start.shape, settings.window_px // 2
    samples = _nothing(shape)
    field = _Field(
        plane=np.zeros((*shape, 3)),
        covariance=np.zeros((*shape, 6)),
        residual=np.full(shape, np.inf),
        gain=np.ones(shape),
        offset=np.zeros(shape),
        share=np.ones(shape),
        w=np.empty(shape),
        chosen=np.full(shape, -1, np.int64),
        rival=np.full(shape, np.inf),
    )
    _rows(pool, len(start), _kernels.median_rows, _MEDIAN_REACH, warp.valid, start, field.w)
    for iteration in range(iterations):
        _sampled(field.w, second, warp, samples, pool)
        sharp = iteration >= iterations - settings.sharp_iterations
        _rows(
            pool, len(start), _kernels.fit_rows, half, _LEAST_SHARE * settings.window_px**2, _SLOPE_WEIGHT, not sharp,
            warp.valid, warp.x, field.w, first.image, samples.known, samples.value, samples.slope, samples.motion,
            field.plane, field.covariance, field.residual, field.gain, field.offset, field.share,
        )  # fmt: skip
        _rows(
            pool, len(start), _kernels.choose_rows, half, settings.patch_px // 2 if sharp else -1, _APART_PX * pixel,
            _CENTRE_BONUS, _RESIDUAL_WEIGHT, 1 / settings.d_max_m, 1 / settings.d_min_m, warp.valid, warp.x, warp.t,
            warp.R, warp.s, warp.camera, first.image, second.coefficients, field.plane, field.residual, field.gain,
            field.offset, field.w, field.chosen, field.rival,
        )  # fmt: skip
    return field


def _transferred(field: _Field, warp: _Warp, shape: tuple[int, ...], seam: int) -> Array:
    """The field seen from view 2, `shape` its image's, continued by `seam`; NaN where no point of view 1 falls."""
    w_2, misfit_2 = np.full(shape, np.nan), np.full(shape, np.inf)
    _kernels.transfer(
        warp.valid, warp.x, field.w, field.residual, field.chosen, warp.R, warp.s, warp.camera, w_2, misfit_2
    )  # fmt: skip
    return across_seam(w_2[:, seam : shape[1] - seam], seam)


# -- Matches -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Read:
    """View 1's planes in the directions of the panorama's pixels; all `[height, width]`."""

    w: Array
    """Inverse range; NaN where there is none."""
    sigma: Array
    """Standard deviation of alpha_2, radians."""
    certain: Mask
    """Within the limits, precise enough, without a rival, and with texture."""


def _on_panorama(
    forth: _Field,
    inflation: Array,
    samples: _Samples,
    warp: _Warp,
    view: tuple[Sensor, int],
    grid: Grid,
    settings: Slanted,
) -> _Read:
    """Evaluate the planes in the directions of the panorama's pixels.

    view : view 1's sensor, and how many columns its image has been continued by.
    """
    x = directions(grid)
    index, window, w = _read(forth, x, *view)
    length, across = np.linalg.norm(x - w[..., None] * warp.t, axis=-1), _across(warp, x)
    # d alpha_2/dw = |t × x|/|x - w t|²
    sigma = across / length**2 * _sigma(forth, inflation, x, window, warp, settings)
    with np.errstate(invalid="ignore"):
        certain = (w >= 1 / settings.d_max_m) & (w <= 1 / settings.d_min_m)
        certain &= (sigma <= settings.max_sigma_px * grid.phi_pitch) & (forth.rival.ravel()[index] >= _AMBIGUOUS)
        certain &= (forth.share.ravel()[window] < 1) & ~_blank(forth, samples, index, window, settings.window_px)
    return _Read(w, sigma, certain)


def _across(warp: _Warp, x: Array) -> Array:
    """|t × x|."""
    return np.asarray(np.linalg.norm(np.cross(warp.t, x), axis=-1))


def _matches(
    read: _Read, reverse: _Field, warp: _Warp, view: tuple[Sensor, int], grid: Grid, settings: Slanted
) -> Matches:
    """The planes that view 2's own confirm.

    view : view 2's sensor, and how many columns its image has been continued by.
    """
    x, w, sigma = directions(grid), read.w, read.sigma
    q = x - w[..., None] * warp.t
    length, across = np.linalg.norm(q, axis=-1), _across(warp, x)
    # The same point in view 2, at inverse range w/|q| in direction R q/|q|, and view 2's own there.
    x_2 = normalise(q @ warp.R.T)
    _, _, w_2 = _read(reverse, x_2, *view)
    apart = np.abs(w_2 - w / length) * across * length
    with np.errstate(invalid="ignore"):
        consistent = apart <= settings.consistency_px * grid.phi_pitch
    reason = np.where(consistent, np.uint8(Reason.MATCHED), np.uint8(Reason.INCONSISTENT))
    reason[~read.certain] = Reason.NO_MATCH
    reason[across <= 1e-9 * np.linalg.norm(warp.t)] = Reason.NO_EPIPOLAR_PLANE
    matched = reason == Reason.MATCHED
    sigma = np.where(matched, sigma, np.nan)
    return Matches(
        alpha_2=np.where(matched, angle_between(q, warp.t), np.nan),
        confidence=1 / sigma,
        sigma_alpha_2=sigma,
        reason=reason,
    )


def _blank(
    field: _Field, samples: _Samples, index: NDArray[np.intp], window: NDArray[np.int64], window_px: int
) -> Mask:
    """Whether pixels lie where their windows have less texture than `_TEXTURED` of their mean, significantly.

    A plane that rests on texture farther off, usually the border of another surface, is precise and may be wrong.
    Texture is the sum of g² per squared motion, over two thirds of the window's side; f of it is noise, whose mean over
    n² pixels has the relative standard deviation sqrt(2)/n.
    """
    n = 2 * (window_px // 3) + 1
    g2, motion = (np.where(samples.known, a, 0.0) for a in (np.square(samples.slope, dtype=float), samples.motion))

    def density(side: int) -> Array:
        sums = (ndimage.uniform_filter(a, side, mode="constant") for a in (g2, motion))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.divide(*sums)

    f = field.share.ravel()[window]
    with np.errstate(invalid="ignore"):
        expected = f + _TEXTURED * (1 - f) - 2 * f * np.sqrt(2) / n
        return density(n).ravel()[index] < expected * density(window_px).ravel()[window]


def _read(field: _Field, x: Array, sensor: Sensor, seam: int) -> tuple[NDArray[np.intp], NDArray[np.int64], Array]:
    """Flat index of the mirror pixel nearest to each direction, the window that it takes its plane from, and that
    plane's inverse range in the direction itself; NaN where the direction is not seen or there is no plane.
    """
    height, width = field.w.shape
    pixels, valid = project(sensor, x)
    column, row = np.moveaxis(np.rint(np.where(valid[..., None], pixels, 0)).astype(np.intp), -1, 0)
    index = np.clip(row, 0, height - 1) * width + np.clip(column + seam, 0, width - 1)
    window = field.chosen.ravel()[index]
    w = np.sum(field.plane.reshape(-1, 3)[window] * x, axis=-1)
    return index, window, np.where(valid & (window >= 0), w, np.nan)


# -- The standard deviation --------------------------------------------------------------------------------------------


def _sigma(
    field: _Field, inflation: Array, x: Array, window: NDArray[np.int64], warp: _Warp, settings: Slanted
) -> Array:
    """Standard deviation of m·x, from the residual's variance and the inverse normal matrix C: s² x^T C x, corrected.

    - What adds up in a window is not white; see `_inflation`.
    - The gradient g holds noise too. It adds to the normal matrix, not to what the normal equations say, so a step goes
      only the part 1 - f of the way, f being the noise's share in the sum of g², or 1 - f² when taken 1 + f times as
      far. What is left of the field before, f or f² of it, is smoothed over a window. So the field is the sum of the
      planes that noise alone would give, smoothed n times and less and less of each; see `_smoothed`.
    """
    # Tangents at the middle of the window, as in the kernel.
    c = warp.x.reshape(-1, 3)[window]
    sideways = np.stack([-c[..., 1], c[..., 0], np.zeros_like(c[..., 0])], axis=-1)
    cosine = np.linalg.norm(sideways, axis=-1, keepdims=True)
    e = np.where(cosine > 1e-9, sideways / np.maximum(cosine, 1e-9), [0.0, 1.0, 0.0])
    one, a, b = (np.sum(x * axis, axis=-1) for axis in (c, e, np.cross(c, e)))
    c00, c01, c02, c11, c12, c22 = np.moveaxis(field.covariance.reshape(-1, 6)[window], -1, 0)
    spread = one * (c00 * one + 2 * (c01 * a + c02 * b)) + c11 * a * a + 2 * c12 * a * b + c22 * b * b
    smoothed = polyval(field.share.ravel()[window], _smoothed(settings.iterations, settings.sharp_iterations))
    # Images in single precision are rounded by 1e-5 grey levels: no residual is less.
    residual = field.residual.ravel()[window] + 1e-10
    with np.errstate(invalid="ignore"):  # infinite or not a number where there is no window
        return np.sqrt(spread * residual * smoothed * inflation.ravel()[window])


def _smoothed(iterations: int, sharp_iterations: int) -> Array:
    """Coefficients of the variance, in units of s² C, as a polynomial of f.

    Two planes, one smoothed k times over a window and one l times, correlate as (b_n+2(0)/b_2(0))², n = k + l: planes
    of neighbouring windows share pixels, which is smoothing too, and b_m is the density of the sum of m evenly
    distributed numbers, the centred B-spline of degree m - 1.
    """
    # From the last step back: a sharp one adds f^p, one that goes farther f^p (1 + f), p = 0 for the last.
    powers = [1 if k < sharp_iterations else 2 for k in range(iterations)]
    weights = [np.repeat([0.0, 1.0], [sum(powers[:k]), powers[k]]) for k in range(iterations)]
    total = np.zeros(2 * sum(powers) - 1)
    for k, one in enumerate(weights):
        for m, other in enumerate(weights):
            product = np.convolve(one, other)
            total[: len(product)] += product * _centre_of_spline(k + m + 2) ** 2
    return total


def _centre_of_spline(m: int) -> float:
    """b_m(0) = sum_k (-1)^k C(m, k) max(m/2 - k, 0)^(m-1)/(m-1)!; 1 for m = 2."""
    total = 0.0
    for k in range((m + 1) // 2):
        term = 1.0
        for j in range(1, m):
            term *= (m / 2 - k) / j
        total += (-1) ** k * comb(m, k) * term
    return total


def _inflation(field: _Field, first: _View, samples: _Samples, warp: _Warp, pool: ThreadPoolExecutor) -> Array:
    """How much larger the variance is of a window's sums than if residuals were white, `[height, width]`.

    The larger of two. Where pixels of view 2 are larger than those of view 1, by the factor A in area, neighbouring
    samples share their noise: per sample it counts as A, where the residual shows only the spline's VALUE_NOISE². And
    what the model leaves out, the finest texture above all, is measured: the sum of g_i r_i g_j r_j over neighbours
    i, j against that over i = j (Newey and West 1987).
    """
    shape = field.w.shape
    score, area = np.zeros(shape), np.ones(shape)
    _rows(
        pool, len(score), _kernels.judge_rows, warp.valid, warp.x, warp.R, warp.s, warp.camera, first.image,
        samples.known, samples.value, samples.slope, field.plane, field.chosen, field.gain, field.offset, score, area,
    )  # fmt: skip
    visible = _kernels.VALUE_NOISE**2
    shared = (1 + np.maximum(area, visible)) / (1 + visible)
    around = ndimage.uniform_filter(score, 3, mode="constant") * 9
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = ndimage.uniform_filter(score * around, _CORRELATED_PX, mode="constant") / ndimage.uniform_filter(
            score * score, _CORRELATED_PX, mode="constant"
        )
    return np.clip(np.fmax(shared, measured), 1.0, 9.0)
