"""Uncertainty of matches, for matchers that give none: from the residuals between the two views.

Around its match a window of view 2 differs from that of view 1 by residuals r, and answers to alpha_2 with gradients g.
The least-squares estimate of alpha_2 from the window, `-Σ g r/Σ g²`, has the variance

    s² c/Σ g²,    s² = mean of r² over the window,    c = Σ over lags of rho_r rho_g,

where the correlation coefficients rho of neighbouring residuals and of neighbouring gradients enter because a filtered
and interpolated panorama has no independent pixels; they are measured over the whole panorama. Nothing is calibrated
on a truth. What this does not see is a matcher's bias, and a match that is wrong altogether.
"""

from typing import cast

import numpy as np
from scipy import ndimage

from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, angular_step
from harness.geometry.panorama import Panorama, pixel_of
from harness.matching.interface import MatcherSettings, Matches
from harness.matching.pair import Pair

_LAGS = 6
"""Largest lag of the autocorrelation, pixels: four standard deviations of the usual filter."""

_LEAST_SHARE = 0.5
"""The least share of a window's pixels that must have a match and lie in both panoramas."""


def sigma_alpha_2(pair: Pair, matcher: MatcherSettings, matches: Matches) -> Array:
    """Standard deviation of alpha_2, radians `[height, width]`; NaN without a match, or with too few pixels around it.

    The matcher's own prediction if it makes one. Whole samples add that of an even distribution over one step.
    """
    if matches.sigma_alpha_2 is not None:
        return matches.sigma_alpha_2
    window = matcher.window
    curves = matcher.curves(pair.grid, pair.t_v1)
    variance = _photometric_variance(pair, curves, matches.alpha_2, window)
    if matcher.whole_samples:
        variance = variance + angular_step(curves, matches.alpha_2) ** 2 / 12
    return cast("Array", np.sqrt(variance))


def _photometric_variance(pair: Pair, curves: Curves, alpha_2: Array, window_px: int) -> Array:
    first, second = pair.filtered()
    step = pair.grid.phi_pitch / 2
    before, after = (sampled_at(second, curves, alpha_2 + side * step) for side in (-1, 1))
    gradient = (after - before) / (2 * step)
    residual = first.values - (after + before) / 2
    usable = np.isfinite(gradient) & first.valid
    r, g = np.where(usable, residual, 0.0), np.where(usable, gradient, 0.0)
    correlation = np.sum(_autocorrelation(r) * _autocorrelation(g))

    share, r_2, g_2 = (_window_mean(each, window_px) for each in (usable.astype(np.float64), r**2, g**2))
    r_2 = np.maximum(r_2, 0.0)  # a running sum of squares may end a hair below zero
    with np.errstate(divide="ignore", invalid="ignore"):
        # Means over the whole window: r_2/share is the mean over the pixels that are there.
        variance = (r_2 / share) * max(correlation, 0.0) / (g_2 * window_px**2)
    known = np.isfinite(alpha_2) & (share >= _LEAST_SHARE) & (g_2 > 0)
    return np.where(known, variance, np.nan)


def sampled_at(panorama: Panorama, curves: Curves, alpha_2: Array) -> Array:
    """View 2's value at an angle alpha_2 on each pixel's curve, `[height, width]`; NaN outside the panorama."""
    grid = panorama.grid
    t_hat = curves.t / np.linalg.norm(curves.t)
    direction = np.cos(alpha_2)[..., None] * t_hat + np.sin(alpha_2)[..., None] * curves.m
    row, column = pixel_of(grid, direction)
    inside = np.isfinite(row) & (row >= 0) & (row <= grid.height_px - 1)
    pixels = np.stack([np.where(inside, row, 0.0), np.where(inside, column, 0.0)])
    values = ndimage.map_coordinates(panorama.values.astype(np.float64), pixels, order=3, mode="grid-wrap")
    valid = panorama.valid
    if not valid.all():
        inside &= ndimage.map_coordinates(valid.astype(np.float64), pixels, order=1, mode="grid-wrap") > 1 - 1e-9
    return np.where(inside, values, np.nan)


def _autocorrelation(values: Array) -> Array:
    """Correlation coefficients of pixels up to `_LAGS` rows and columns apart, `[2 lags + 1, 2 lags + 1]`."""
    height, width = values.shape
    spectrum = np.abs(np.fft.rfft2(values, (2 * height, width))) ** 2  # padded: columns are periodic, rows are not
    product = np.fft.irfft2(spectrum, (2 * height, width))
    rows = np.arange(-_LAGS, _LAGS + 1)
    at_lags = product[np.ix_(rows, rows)]
    return np.asarray(at_lags / at_lags[_LAGS, _LAGS] if at_lags[_LAGS, _LAGS] > 0 else np.zeros_like(at_lags))


def _window_mean(values: Array, window_px: int) -> Array:
    return np.asarray(ndimage.uniform_filter(values, window_px, mode=("constant", "wrap")))
