"""Window matching in two steps: the best whole sample of every epipolar curve, then the sub-pixel step on its costs.

How windows are laid and compared is `square`'s or `column`'s business, chosen by the matcher's `kind`.
"""

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.epipolar import epipolar_curves
from harness.geometry.panorama import Panorama
from harness.machine import available_cpus
from harness.matching import _matching_kernels
from harness.matching.interface import Matches, Reason
from harness.matching.pair import Pair
from harness.matching.window import _window_kernels
from harness.matching.window import column as column_windows
from harness.matching.window import square as square_windows
from harness.matching.window.newton import gauss_newton
from harness.matching.window.settings import WholePixelMatches, WindowMatcher
from harness.matching.window.subpixel import FROM_COSTS, cancelled_minimum, refine

__all__ = [
    "Matches",
    "Reason",
    "WholePixelMatches",
    "WindowMatcher",
    "costs_along_curve",
    "match",
    "match_whole_pixels",
    "match_windows",
    "whole_pixels",
]

_KINDS = {"window": square_windows, "column": column_windows}


def match_windows(pair: Pair, matcher: WindowMatcher) -> Matches:
    """Match the filtered panoramas; the search is shared by all sub-pixel steps."""
    whole = whole_pixels(pair, matcher)
    return pair.shared(
        "sub-pixel",
        matcher,
        lambda: match(whole, matcher, pair.filtered(), threads=pair.available_threads),
    )


def whole_pixels(pair: Pair, matcher: WindowMatcher) -> WholePixelMatches:
    """The search of `match_windows`."""
    first, second = pair.filtered()
    return pair.shared(
        "match",
        matcher.search,
        lambda: match_whole_pixels(first, second, pair.t_v1, matcher, threads=pair.available_threads),
    )


def match_whole_pixels(
    first: Panorama, second: Panorama, t_v1: Array, matcher: WindowMatcher, *, threads: int | None = None
) -> WholePixelMatches:
    """The best sample on the epipolar curve of every pixel; of equally good ones, the one nearer to infinity.

    Parameters
    ----------
    first, second
        Filtered panoramas on one grid, both in v1's orientation.
    t_v1
        `[3]`, metres.
    threads
        Number of parts of the panorama that are matched at a time; all CPUs by default. No result depends on it.
    """
    if second.grid != first.grid:
        raise ValueError("both panoramas must lie on one grid")
    curves = epipolar_curves(
        first.grid,
        t_v1,
        d_min_m=matcher.d_min_m,
        d_max_m=matcher.d_max_m,
        sampling=matcher.sampling,
        pitch_px=matcher.pitch_px,
    )
    return _KINDS[matcher.kind].search(first, second, curves, matcher, threads or available_cpus())


def match(
    whole: WholePixelMatches,
    matcher: WindowMatcher,
    images: tuple[Panorama, Panorama] | None = None,
    *,
    threads: int | None = None,
) -> Matches:
    """Apply the sub-pixel step and turn samples into angles.

    Parameters
    ----------
    images
        The filtered panoramas that were searched; for the steps that need more than the costs of whole samples.
    threads
        As in `match_whole_pixels`.

    Returns
    -------
    Matches
        Refined positions lie between d_max and d_min, as the search itself: finite limits keep every range finite. The
        confidence is the contrast of the cost's minimum, `1 - c_0/mean(c_-1, c_+1)` over those of the two neighbours
        that exist, within 0 .. 1; 0 where the costs are all alike.
    """
    curves = whole.curves
    if matcher.subpixel in FROM_COSTS:
        offset, refined = refine(whole.costs, matcher.subpixel)
    elif images is None:
        raise ValueError(f"the sub-pixel step {matcher.subpixel} needs the panoramas")
    else:
        offset, refined = _refine_on_images(whole, matcher, images, threads or available_cpus())
    shape = whole.k.shape
    k, alpha_2, confidence = np.empty(shape), np.empty(shape), np.empty(shape)
    _window_kernels.matches(
        _matching_kernels.SAMPLINGS[curves.sampling],
        whole.costs,
        whole.reason,
        whole.k,
        offset,
        refined,
        curves.grid.phi,
        curves.step,
        curves.alpha_1,
        curves.m,
        curves.n,
        curves.t / np.linalg.norm(curves.t),
        curves.k_far,
        curves.k_near,
        k,
        alpha_2,
        confidence,
    )
    return Matches(alpha_2=alpha_2, confidence=confidence, reason=whole.reason, refined=refined, k=k)


def _refine_on_images(
    whole: WholePixelMatches, matcher: WindowMatcher, images: tuple[Panorama, Panorama], threads: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Offset and validity, as from `refine`, by the steps that use the images beside the costs."""
    if matcher.subpixel == "images":
        return gauss_newton(*images, whole, matcher, threads)
    costs = _KINDS[matcher.kind].costs_of_half_samples(*images, whole, matcher, threads)
    return cancelled_minimum(costs, equiangular=matcher.cost in ("sad", "census"))


def costs_along_curve(
    first: Panorama, second: Panorama, whole: WholePixelMatches, matcher: WindowMatcher, row: int, column: int
) -> tuple[NDArray[np.int64], Array]:
    """All samples k of one pixel's search interval, and their costs, as in the paper's figure 3."""
    return _KINDS[matcher.kind].costs_along_curve(first, second, whole.curves, matcher, row, column)
