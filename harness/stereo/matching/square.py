"""The paper's matcher: a fixed square window on the epipolar curve, compared at the nearest pixel (section 4)."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.stereo.epipolar import Curves
from harness.stereo.matching import _kernels
from harness.stereo.matching.centres import searchable, window_centres
from harness.stereo.matching.contract import Reason
from harness.stereo.matching.window_settings import WholePixelMatches, WindowMatcher
from harness.stereo.panorama import Panorama


def search(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, threads: int
) -> WholePixelMatches:
    """The best sample of every pixel's curve; `threads` deals out rows."""
    grid = first.grid
    matchable_1, matchable_2 = (window_centres(image, matcher.window_px) for image in (first, second))
    searched, reason = searchable(curves, matchable_1)
    lost = searched & ~_extremum_inside(curves, matchable_2)
    reason[lost] = Reason.CURVE_LEAVES_IMAGE
    searched &= ~lost

    k_best = np.zeros(grid.shape, dtype=np.int32)
    costs = np.full((*grid.shape, 2 * matcher.neighbours + 1), np.nan)
    shared = _shared_arguments(first, second, matcher)

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

    rows = np.arange(grid.height_px)
    with ThreadPoolExecutor(threads) as pool:
        # Near rows cost more than far ones: deal the rows out like cards.
        list(pool.map(work, [np.ascontiguousarray(rows[i :: 4 * threads]) for i in range(4 * threads)]))
    return WholePixelMatches(curves, k_best, costs, reason)


def costs_along_curve(
    first: Panorama, second: Panorama, curves: Curves, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs."""
    grid = first.grid
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    out = np.empty(ks.size)
    matchable_2 = window_centres(second, matcher.window_px)
    shared = _shared_arguments(first, second, matcher)
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


def _shared_arguments(first: Panorama, second: Panorama, matcher: WindowMatcher) -> dict[str, Any]:
    half = matcher.window_px // 2
    return {
        "mode": {"phi": _kernels.PHI, "alpha": _kernels.ALPHA}[matcher.sampling],
        "cost": {"sad": _kernels.SAD, "ssd": _kernels.SSD}[matcher.cost],
        "first": np.pad(first.values, ((0, 0), (half, half)), mode="wrap"),
        "second": np.pad(second.values, ((0, 0), (half, half)), mode="wrap"),
        "half": half,
    }


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
