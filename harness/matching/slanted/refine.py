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

The standard deviation is that of least squares, from the window's own residual, with three corrections; see `sigma`. It
is no less than two thirds of what the planes around differ by, and two fifths of what the match back misses the pixel
by, and grows with doubt; see `doubt`.

After the first step it is known how noisy the images are, and they are smoothed accordingly; see `smoothing`.

The first steps fit narrow windows: what lies between two borders and is narrower than a window would be lost to what is
beside it, and with it the planes that later steps choose from. Wide windows end it, as noise asks for.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from harness.camera.fill import across_seam, closed_image
from harness.camera.sensor import Sensor, forget_directions, seam_px
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, directions, pixel_that_holds, row_bands
from harness.geometry.pose import Motion
from harness.machine import available_cpus
from harness.matching.interface import Matches, Reason
from harness.matching.slanted import _reading_kernels
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.back import Reverse, seen_back, tell_occluded
from harness.matching.slanted.doubt import Surroundings, factor, factor_by_start, surroundings_of, unlike
from harness.matching.slanted.field import (
    Field,
    Image,
    Mask,
    Part,
    Warp,
    advance,
    field_from,
    in_rows,
    in_turn,
    no_samples,
    part_of,
    read_planes,
    sample,
    steps_back,
    steps_forth,
    view_of,
    warp_between,
)
from harness.matching.slanted.noise import Noise, noise_between
from harness.matching.slanted.settings import Slanted
from harness.matching.slanted.sigma import CONFIRMED, at_least, doubted, inflation_of, sigma_of
from harness.matching.slanted.smoothing import blur_for

_ACROSS_SEAM = 6
"""How many windows a periodic image is continued by on both sides."""


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
        With `sigma_alpha_2`, and its inverse as confidence. `Reason.NO_MATCH`: no plane between d_min and d_max, or a
        standard deviation above `max_sigma_px`, which a doubtful match reaches earlier; see `doubt`.
        `Reason.INCONSISTENT`: the match back from view 2 leads elsewhere.

    Raises
    ------
    ValueError
        When an image does not have its sensor's size, or the start not the grid's.
    """
    settings = settings or Slanted()
    _check_sizes(images, sensors, grid, start_alpha_2)
    # Windows, samples and whatever planes are carried over go on across the seam of images that go round.
    reach = _ACROSS_SEAM * settings.window_px
    seams = seam_px(sensors[0], reach), seam_px(sensors[1], reach)
    closed = [closed_image(*each)[:2] for each in zip(images, sensors, seams, strict=True)]
    part_1, part_2 = (part_of(sensors[i], seams[i], closed[i][1]) for i in (0, 1))
    with ThreadPoolExecutor(threads or available_cpus()) as pool:
        views = pool.map(view_of, *zip(*closed, strict=True), (part_1, part_2))
        forth_warp = warp_between(part_1, part_2, motion, closed[0][1])
        forget_directions(sensors[0])
        first, second = views
        forth = field_from(_start(start_alpha_2, forth_warp, grid, pool), forth_warp, pool)
        noise = noise_between(
            *((image[part.at], known[part.at]) for (image, known), part in zip(closed, (part_1, part_2), strict=True))
        )
        steps = steps_forth(settings)
        advance(forth, first, second, forth_warp, noise, settings, steps[:1], grid.phi_pitch, pool)
        share, residual = forth.share[:, part_1.once], forth.residual[:, part_1.once]
        if blur := blur_for(share, residual, noise.odds_of_1(residual, second.noise[0])):
            del first, second, views
            first, second = pool.map(view_of, *zip(*closed, strict=True), (part_1, part_2), (blur, blur))
            noise = noise.smoothed(blur)
        advance(forth, first, second, forth_warp, noise, settings, steps[1:], grid.phi_pitch, pool)
        # Arrays as large as the image go as soon as they can: they are what memory a large one takes.
        samples = no_samples(forth.w.shape)
        sample(forth.w, second, forth_warp, samples, pool)
        inflation = inflation_of(forth, first, second, noise, samples, forth_warp, pool)
        around = surroundings_of(forth, first, noise, samples, forth_warp, settings.window_px, pool)
        del samples
        read = _on_panorama(forth, inflation, noise, around, start_alpha_2, forth_warp, part_1, grid, settings, pool)
        del inflation, around
        start = _transferred(forth, forth_warp, part_2, closed[1][1].shape)
        del forth, forth_warp  # a field takes 76 bytes a pixel, and a warp 25: one at a time
        back_warp = warp_between(part_2, part_1, _reversed(motion), closed[1][1])
        forget_directions(sensors[1])
        reverse = field_from(start, back_warp, pool, covariance=False)
        del start
        advance(reverse, second, first, back_warp, noise.turned(), settings, steps_back(settings), grid.phi_pitch, pool)
        del first, second, back_warp
        return _matches(read, start_alpha_2, Reverse(reverse, part_2, motion), grid, settings, pool)


def _check_sizes(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], grid: Grid, start_alpha_2: Array) -> None:
    """Refuse images and starts of other sizes; see `refine_slanted`."""
    sizes = tuple((each.camera.height_px, each.camera.width_px) for each in sensors)
    shapes = tuple(image.shape for image in images)
    if shapes != sizes:
        raise ValueError(
            f"the images are {shapes[0]} and {shapes[1]}, the sensors {sizes[0]} and {sizes[1]} (rows, columns)"
        )
    if start_alpha_2.shape != grid.shape:
        raise ValueError(f"the start is {start_alpha_2.shape}, the panorama {grid.shape} (rows, columns)")


def _reversed(motion: Motion) -> Motion:
    R = motion.R_v2_from_v1
    return Motion(R_v2_from_v1=R.T, t_v1=-R @ motion.t_v1)


def _start(alpha_2: Array, warp: Warp, grid: Grid, pool: ThreadPoolExecutor) -> Array:
    """Inverse range of every mirror pixel that the panorama covers; NaN elsewhere.

    From d_1 = |t| sin(alpha_2)/sin(alpha_2 - alpha_1).
    """
    w, field = np.empty(grid.shape), np.empty(warp.valid.shape)
    baseline, panorama = np.linalg.norm(warp.t), directions(grid)

    def reach(rows: slice) -> None:
        with np.errstate(invalid="ignore", divide="ignore"):
            alpha_1 = np.arctan2(*_across_and_along(warp.t, panorama[rows]))
            w[rows] = np.sin(alpha_2[rows] - alpha_1) / (baseline * np.sin(alpha_2[rows]))

    in_turn(pool, row_bands(grid), reach)

    def cover(first: int, end: int) -> None:
        row, column, inside = pixel_that_holds(grid, np.nan_to_num(warp.x[first:end]))
        _reading_kernels.cover(warp.valid[first:end], row, column, inside, w, field[first:end])

    in_rows(pool, len(field), cover)
    return field


def _transferred(field: Field, warp: Warp, part: Part, shape: tuple[int, ...]) -> Array:
    """The field seen from view 2, in its part of an image of that shape; NaN where no point of view 1 falls."""
    w_2, misfit_2 = np.full(shape, np.nan), np.full(shape, np.inf)
    _kernels.transfer(
        warp.valid, warp.x, field.w, field.residual, field.chosen, warp.R, warp.s, warp.camera, w_2, misfit_2
    )  # fmt: skip
    seam = part.seam
    return np.ascontiguousarray(across_seam(w_2[:, seam : shape[1] - seam], seam)[part.at])


# -- Matches -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Read:
    """View 1's planes in the directions of the panorama's pixels; all `[height, width]`."""

    w: Array
    """Inverse range; NaN where there is none."""
    sigma: Array
    """Standard deviation of alpha_2, radians."""
    doubt: Array
    """See `doubt`; infinite outside the limits."""
    unlike: Mask
    """See `doubt.unlike`."""


def _on_panorama(
    forth: Field,
    inflation: Array,
    noise: Noise,
    around: Surroundings,
    start_alpha_2: Array,
    warp: Warp,
    part: Part,
    grid: Grid,
    settings: Slanted,
    pool: ThreadPoolExecutor,
) -> _Read:
    """Evaluate the planes in the directions of the panorama's pixels."""
    result = _Read(np.empty(grid.shape), np.empty(grid.shape), np.empty(grid.shape), np.empty(grid.shape, bool))
    unexplained = unlike(forth, around).ravel()
    panorama = directions(grid)

    def read(rows: slice) -> None:
        x = panorama[rows]
        index, window, w = read_planes(forth, x, part)
        # q = x - w t is the point from viewpoint 2; q × t = x × t.
        across, along = _across_and_along(warp.t, x)
        ahead = along - w * (warp.t @ warp.t)
        from_start = np.abs(np.arctan2(across, ahead) - start_alpha_2[rows]) / grid.phi_pitch
        sigma_w = sigma_of(forth, inflation, noise, x, window, warp, settings)
        # d alpha_2/dw = |t × x|/|q|²
        alpha_2_by_w = across * (warp.t @ warp.t) / (across * across + ahead * ahead)
        sigma = alpha_2_by_w * at_least(sigma_w, around.disagreement.ravel()[index])
        with np.errstate(invalid="ignore"):
            within = (w >= 1 / settings.d_max_m) & (w <= 1 / settings.d_min_m)
        result.w[rows], result.sigma[rows], result.unlike[rows] = w, sigma, unexplained[index]
        doubt = factor(around, index, window) * factor_by_start(from_start, forth.share.ravel()[window] < 1)
        result.doubt[rows] = np.where(within, doubt, np.inf)

    in_turn(pool, row_bands(grid), read)
    return result


def _across_and_along(t: Array, x: Array) -> tuple[Array, Array]:
    """|t × x| and t·x, `[...]`, of directions `[..., 3]`."""
    across, along = np.empty((2, *x.shape[:-1]))
    t, x = (np.ascontiguousarray(a, np.float64) for a in (t, x))
    _reading_kernels.across_and_along(x.reshape(-1, 3), t, across.ravel(), along.ravel())
    return across, along


def _matches(
    read: _Read, start_alpha_2: Array, reverse: Reverse, grid: Grid, settings: Slanted, pool: ThreadPoolExecutor
) -> Matches:
    """The planes that view 2's own confirm, and reasons for the rest."""
    alpha_2, sigma_2, reasons = np.empty(grid.shape), np.empty(grid.shape), np.empty(grid.shape, np.uint8)
    limit, apart = settings.max_sigma_px * grid.phi_pitch, settings.consistency_px * grid.phi_pitch
    t, panorama = reverse.motion.t_v1, directions(grid)

    def confirm(rows: slice) -> None:
        x = panorama[rows]
        alpha, nearer = seen_back(x, read.w[rows], reverse)
        missed = np.abs(nearer)
        sigma = np.fmax(read.sigma[rows], CONFIRMED * missed)
        with np.errstate(invalid="ignore"):
            reason = np.where(missed <= apart, np.uint8(Reason.MATCHED), np.uint8(Reason.INCONSISTENT))
            reason[~(read.doubt[rows] * read.sigma[rows] <= limit)] = Reason.NO_MATCH
            reason[(reason == Reason.MATCHED) & ~(read.doubt[rows] * sigma <= limit)] = Reason.NO_MATCH
        reason[_across_and_along(t, x)[0] <= 1e-9 * np.linalg.norm(t)] = Reason.NO_EPIPOLAR_PLANE
        matched = reason == Reason.MATCHED
        alpha_2[rows], reasons[rows] = np.where(matched, alpha, np.nan), reason
        sigma_2[rows] = np.where(matched, doubted(sigma, read.doubt[rows]), np.nan)

    in_turn(pool, row_bands(grid), confirm)
    tell_occluded(reasons, read.w, read.unlike, start_alpha_2, reverse, grid, apart)
    return Matches(alpha_2=alpha_2, confidence=1 / sigma_2, sigma_alpha_2=sigma_2, reason=reasons)
