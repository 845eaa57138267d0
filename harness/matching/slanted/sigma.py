"""The standard deviation of what slanted windows find: that of least squares, corrected; see `sigma_of`."""

from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import product
from math import comb, factorial, prod

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.slanted import _reading_kernels
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.field import Field, Samples, Step, View, Warp, in_rows, steps_forth
from harness.matching.slanted.means import means
from harness.matching.slanted.noise import Noise
from harness.matching.slanted.settings import Slanted
from harness.matching.slanted.smoothing import noise_left, smoothed

_CORRELATED_PX = 33
"""Width of the square over which correlation is measured: four windows, as one is too few to measure it by."""

_DISAGREEMENT = 2 / 3
CONFIRMED = 0.4
"""The standard deviation is at least these parts of what the planes around differ by, and of what the match back from
view 2 misses the pixel by. With both, errors at noise 10 lie within one, two and three as often as Gaussian ones, to a
few per cent; larger parts cover more than one in 68 %."""

_BY_DOUBT = 0.2
"""The power of doubt that the standard deviation grows with: errors of doubtful matches have longer tails. With a fifth
the noisy corridor's errors lie within one and two as often as Gaussian ones, to 2 %."""


def sigma_of(
    field: Field,
    inflation: Array,
    noise: Noise,
    x: Array,
    window: NDArray[np.int32],
    warp: Warp,
    settings: Slanted,
) -> Array:
    """Standard deviation of m·x, from the residual's variance and the inverse normal matrix C: s² x^T C x, corrected.

    - What adds up in a window is not white; see `inflation_of`.
    - The gradient g holds noise too. It adds to the normal matrix, not to what the normal equations say, so a step goes
      only the part 1 - f of the way, f being the noise's share in the sum of g², or 1 - f² when taken 1 + f times as
      far. What is left of the field before, f or f² of it, is smoothed over a window. So the field is the sum of the
      planes that noise alone would give, smoothed n times and less and less of each; see `smoothed_noise`.
    """
    variance = np.empty(window.shape)
    _reading_kernels.variances(
        window.ravel(), np.ascontiguousarray(x).reshape(-1, 3), warp.x.reshape(-1, 3), field.covariance.reshape(-1, 6),
        variance.ravel(),
    )  # fmt: skip
    _reading_kernels.spread(
        window.ravel(), field.residual.ravel(), field.share.ravel(), inflation.ravel(),
        smoothed_noise(steps_forth(settings)), noise.rounding, variance.ravel(),
    )  # fmt: skip
    return variance


def at_least(sigma_w: Array, disagreement: Array) -> Array:
    """Standard deviations of inverse range, no less than two thirds of what the planes around differ by."""
    return np.asarray(np.fmax(sigma_w, _DISAGREEMENT * disagreement))


def doubted(sigma: Array, doubt: Array) -> Array:
    """Standard deviations of matches that are held to limits narrower by these factors; see `doubt`."""
    return np.asarray(sigma * np.maximum(doubt, 1.0) ** _BY_DOUBT)


@lru_cache(maxsize=8)
def smoothed_noise(steps: tuple[Step, ...]) -> Array:
    """Coefficients of the variance, in units of s² C, as a polynomial of f; read-only.

    Planes of neighbouring windows share pixels, so that each step smooths the field over its window: what is left of a
    plane's noise in the end is spread as the sum of independent numbers, each evenly distributed over the window of its
    own step or of one after it. Two planes correlate as the square of the density of the difference of two such sums at
    0, once for rows and once for columns, in units of the last window's side, whose C it is.
    """
    sides = [step.window_px / steps[-1].window_px for step in reversed(steps)]
    # From the last step back: a sharp one adds f^p, one that goes farther f^p (1 + f), p = 0 for the last.
    powers = [1 if step.sharp else 2 for step in reversed(steps)]
    weights = [np.repeat([0.0, 1.0], [sum(powers[:k]), powers[k]]) for k in range(len(steps))]
    total = np.zeros(2 * sum(powers) - 1)
    for k, one in enumerate(weights):
        for m, other in enumerate(weights):
            both = np.convolve(one, other)
            total[: len(both)] += both * density_at_0(Counter(sides[: k + 1] + sides[: m + 1])) ** 2
    total.flags.writeable = False
    return total


def density_at_0(sides: Mapping[float, int]) -> float:
    """Density at 0 of the sum of independent numbers, of which so many are evenly distributed over -side/2 .. side/2.

    sum_signs (product of the signs) max(signs · sides/2, 0)^(n-1)/((n-1)! product of the sides), n >= 2 numbers; of
    equal sides C(m, k) choices have k minuses.
    """
    n = sum(sides.values())
    total = 0.0
    for minuses in product(*(range(m + 1) for m in sides.values())):
        choices, at = 1.0, 0.0
        for (side, m), k in zip(sides.items(), minuses, strict=True):
            choices *= (-1) ** k * comb(m, k)
            at += side * (m / 2 - k)
        total += choices * max(at, 0.0) ** (n - 1)
    return total / (factorial(n - 1) * prod(side**m for side, m in sides.items()))


def inflation_of(
    field: Field, first: View, second: View, noise: Noise, samples: Samples, warp: Warp, pool: ThreadPoolExecutor
) -> Array:
    """How much larger the variance is of a window's sums than if residuals were white, `[height, width]`.

    The larger of two. Where pixels of view 2 are larger than those of view 1, by the factor A in area, neighbouring
    samples share their noise: per sample it counts as A, where the residual shows only what the spline leaves. Pixels
    of smoothed images share theirs too, in both views. Each view counts as much as it is noisy. And what the model
    leaves out, the finest texture above all, is measured: the sum of g_i r_i g_j r_j over neighbours i, j against that
    over i = j (Newey and West 1987).
    """
    shape = field.w.shape
    smooth = _through_smoothing(samples, second.blur, pool) if second.blur else None
    score, area = np.zeros(shape), np.ones(shape)
    in_rows(
        pool, len(score), _kernels.judge_rows, warp.valid, warp.x, warp.R, warp.s, warp.camera, first.image,
        samples.known, samples.value, samples.slope, field.plane, field.chosen, field.gain, field.offset, score, area,
    )  # fmt: skip
    visible = second.noise[0] ** 2
    measured = means(score, 3, pool, np.empty(shape))

    # In place, as these are as large as the image.
    def neighbours(first: int, end: int) -> None:
        measured[first:end] *= 9
        measured[first:end] *= score[first:end]
        score[first:end] *= score[first:end]

    def larger(first: int, end: int) -> None:
        alike = smooth[first:end] if smooth is not None else 1.0
        shared, of_all = area[first:end], measured[first:end]
        of_1 = noise.odds_of_1(field.residual[first:end], second.noise[0])
        shared *= alike
        np.maximum(shared, visible, out=shared)
        shared += of_1 * alike
        shared /= of_1 + visible
        with np.errstate(invalid="ignore", divide="ignore"):
            of_all /= score[first:end]
        np.clip(np.fmax(shared, of_all, out=of_all), 1.0, 9.0, out=of_all)

    in_rows(pool, len(score), neighbours)
    means(measured, _CORRELATED_PX, pool, measured)
    means(score, _CORRELATED_PX, pool, score)
    in_rows(pool, len(score), larger)
    return measured


def _through_smoothing(samples: Samples, blur: float, pool: ThreadPoolExecutor) -> Array:
    """How much larger the variance of a sum of g n is than if the pixels' smoothed noise n were white.

    With noise N that was white, of variance s² before it was smoothed by K, the sum is that of g (K N), or of (K g) N:
    its variance is s² times the sum of (K g)², where that of white noise as large would be s² |K|² times the sum of g².
    """
    slope = np.where(samples.known, samples.slope, np.float32(0))
    left = np.square(smoothed(slope, blur), dtype=np.float64)
    means(left, _CORRELATED_PX, pool, left)
    all_of_it = np.square(slope, dtype=np.float64)
    del slope
    with np.errstate(invalid="ignore", divide="ignore"):
        left /= means(all_of_it, _CORRELATED_PX, pool, all_of_it)
    left /= noise_left(blur)
    return np.nan_to_num(left, copy=False, nan=1.0, posinf=1.0)
