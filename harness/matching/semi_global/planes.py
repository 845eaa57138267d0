"""Planes fitted to the matches around each: less noise, and less of what draws sub-pixel steps to whole samples.

On a plane the inverse range is linear in the unit direction, 1/d = m · x, so that a plane is a linear fit however
slanted it is. Over a few pixels of a slanted surface the fraction of the best label takes all values, and errors that
depend on it cancel.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves
from harness.geometry.panorama import Grid
from harness.matching.semi_global import _plane_kernels as kernels
from harness.threads import in_bands


def fitted_to_planes(k: Array, curves: Curves, plane_px: int, threads: int) -> Array:
    """The matches, each moved to the plane through those around it.

    Parameters
    ----------
    k
        `[height, width]`, samples of alpha_2; NaN where there is no match.
    plane_px
        Side of the square around a pixel, panorama pixels.

    Returns
    -------
    k
        `[height, width]`; NaN where no plane could be fitted.
    """
    matched, reach = np.isfinite(k), plane_px // 2
    all_sines, all_cosines = sine_and_cosine(curves)
    padded_w, padded_slope = np.empty((2, len(k), k.shape[1] + 2 * reach))

    def lay_out(first: int, end: int) -> None:
        at, sine, cosine = (each[first:end] for each in (matched, all_sines, all_cosines))
        with np.errstate(divide="ignore", invalid="ignore"):
            # From d_1 = |t| sin(alpha_2)/sin(alpha_2 - alpha_1), in units of 1/|t|.
            tangent = np.tan(np.where(at, k[first:end], 0.0) * curves.step[first:end])
            w = np.where(at, tangent / (sine + cosine * tangent), 0.0)
            # d alpha_2/dw = |t × x|/|x - w t|²
            slope = np.where(at, sine / (1.0 - 2.0 * w * cosine + w * w) / curves.grid.phi_pitch, 0.0)
        for values, padded in ((w, padded_w), (slope, padded_slope)):
            padded[first:end] = np.pad(values, ((0, 0), (reach, reach)), mode="wrap")

    offsets = _offsets(reach)
    taps = _taps(curves.grid, offsets)
    fitted = np.empty(k.shape)

    def fit(first: int, end: int) -> None:
        kernels.fit_rows(first, end, padded_w, padded_slope, offsets, taps, fitted)
        w, sine, cosine = (each[first:end] for each in (fitted, all_sines, all_cosines))
        fitted[first:end] = np.arctan2(w * sine, 1.0 - w * cosine) / curves.step[first:end]

    for work in (lay_out, fit):
        in_bands(work, len(k), threads, threads)
    return fitted


@lru_cache(maxsize=4)
def sine_and_cosine(curves: Curves) -> tuple[Array, Array]:
    """The sine and the cosine of alpha_1, `[height, width]` each; kept for the next pair of images."""
    return np.sin(curves.alpha_1), np.cos(curves.alpha_1)


def _offsets(reach: int) -> NDArray[np.intp]:
    """Rows and columns `[n, 2]` from a pixel to those that count: every eighth, since neighbours share most of what
    their costs were summed over.
    """
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.argwhere((rows % 2 == 0) & (columns % 2 == 0) & ((rows + columns) % 4 == 0)) - reach


def _taps(grid: Grid, offsets: NDArray[np.intp]) -> Array:
    """Directions `[height, n, 3]` of the pixels at these offsets from a pixel of each row, in its own axes: along its
    direction, along its parallel and along its meridian. The same for all columns, so that a turn of the panorama turns
    the result to the last bit.
    """
    turn = offsets[:, 1] * grid.phi_pitch
    z = grid.z[:, None] - offsets[:, 0] * grid.z_pitch
    away = 1 / np.hypot(1.0, z)
    along, across, up = away * np.cos(turn), away * np.sin(turn), away * z
    cosine = 1 / np.hypot(1.0, grid.z)[:, None]
    sine = cosine * grid.z[:, None]
    return np.ascontiguousarray(np.stack([cosine * along + sine * up, across, cosine * up - sine * along], axis=-1))
