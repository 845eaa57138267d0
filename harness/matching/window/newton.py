"""Sub-pixel by Gauss-Newton steps on the images themselves, in place of a fit to costs.

From the best whole sample on, each step is the shift along the curve that makes the squared differences of the two
windows least, view 2 taken to be linear in it (Lucas and Kanade 1981). View 2 is resampled at every step by cubic
B-splines, so that no interpolation of costs is left whose error depends on the fraction of a sample.

A step that leads farther from the best sample than a sample or a column, whichever is more, or a window that leaves the
image, says nothing; the whole sample then stands.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array, wrap_angle
from harness.geometry.panorama import Grid, Panorama
from harness.matching import _matching_kernels
from harness.matching.interface import Reason
from harness.matching.window import _newton_kernels
from harness.matching.window.centres import whole_windows
from harness.matching.window.settings import WholePixelMatches, WindowMatcher
from harness.matching.window.square import in_interleaved_rows


def gauss_newton(
    first: Panorama, second: Panorama, whole: WholePixelMatches, matcher: WindowMatcher, threads: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Offset from the best whole sample.

    Gain and offset of view 1 are fitted along if the matcher's cost is indifferent to them.

    Returns
    -------
    offset, refined
        `[height, width]`, samples; and bool, as of `subpixel.refine`.
    """
    grid, curves = first.grid, whole.curves
    half = matcher.window_px // 2
    farthest = max(1.0, 1 / matcher.pitch_px)
    invariant = matcher.cost in ("zncc", "census")
    offset, refined = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    matched = whole.reason == Reason.MATCHED
    padded_1 = np.pad(first.values, ((0, 0), (half, half)), mode="wrap")
    spline = _coefficients(second)

    if matcher.kind == "window":
        padded = np.pad(spline, ((0, 0), (half + 2, half + 2)), mode="wrap")
        usable = whole_windows(second.valid, matcher.window_px + 4)

        def work(rows: NDArray[np.intp]) -> None:
            _newton_kernels.refine_squares(
                rows,
                _matching_kernels.SAMPLINGS[matcher.sampling],
                invariant,
                farthest,
                padded_1,
                padded,
                matched,
                usable,
                half,
                grid.phi,
                curves.alpha_1,
                curves.step,
                curves.t / np.linalg.norm(curves.t),
                curves.m,
                curves.n,
                grid.z_max,
                grid.z_pitch,
                grid.phi_pitch,
                whole.k,
                offset,
                refined,
            )

    else:
        away, cotangent, lift = _epipolar_maps(grid, curves.t)
        by_columns = np.ascontiguousarray(np.pad(spline, ((0, 0), (1, 2)), mode="wrap").T)
        taps = np.ascontiguousarray(whole_windows(second.valid, 5).T)

        def work(rows: NDArray[np.intp]) -> None:
            _newton_kernels.refine_columns(
                rows,
                invariant,
                farthest,
                padded_1,
                by_columns,
                matched,
                taps,
                half,
                np.where(curves.step[0] < 0, -1, 1),
                away,
                cotangent,
                lift,
                grid.phi_pitch / matcher.samples_per_column,
                grid.z_max,
                grid.z_pitch,
                grid.phi_pitch,
                whole.k,
                offset,
                refined,
            )

    in_interleaved_rows(work, grid.height_px, threads)
    return offset, refined


def _epipolar_maps(grid: Grid, t: Array) -> tuple[Array, Array, Array]:
    """Azimuth of each column away from t, its cotangent, and the shift of rows by t_z, `[width]` each."""
    away = np.abs(wrap_angle(grid.phi - np.arctan2(t[1], t[0])))
    with np.errstate(divide="ignore", invalid="ignore"):  # a column along t has no map, and no matches
        lift = -t[2] / (np.hypot(t[0], t[1]) * np.sin(away))
        return away, 1 / np.tan(away), lift


def _coefficients(panorama: Panorama) -> Array:
    """Cubic B-spline coefficients through all pixels, around the seam; beyond the first and last row it is mirrored."""
    rows = ndimage.spline_filter1d(panorama.values, order=3, axis=0, mode="mirror", output=np.float64)
    return np.asarray(ndimage.spline_filter1d(rows, order=3, axis=1, mode="grid-wrap", output=np.float64))
