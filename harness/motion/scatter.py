"""The part of residuals' scatter that does not depend on how well each of them is determined.

An error of the geometry moves all tiles that it reaches, whatever their texture. Noise that is larger than predicted
moves those most that are determined worst, in proportion to their standard deviations.
"""

import numpy as np

from harness.geometry.angles import Array

_FREEDOM = 3.0
"""Degrees of freedom of the t distribution of the residuals: some tiles have surfaces that are not planar."""
_FACTORS = np.geomspace(1.0, 8.0, 31)
_FACTOR_SPREAD = 0.2
"""Standard deviation of the logarithm of the factor on the noise. It decides where all tiles are determined about
equally well, and what is common cannot be told from noise: for what is common. Noise in box, room and corridor, white,
correlated, filtered, or in one of the views, is 0.75 to 1.35 of what is predicted."""
_SIZES = np.concatenate([[0.0], np.geomspace(0.1, 100.0, 60)])
"""What is common, in medians of the noise."""
_SIGNIFICANT = 6.0
"""Least gain in log-likelihood. Noise alone has none, in 84 pairs of 14 kinds of images."""


def common_scatter(left: Array, noise: Array) -> float:
    """Standard deviation that is common to residuals, beside a multiple of their noise; 0 where the noise may be all.

    Parameters
    ----------
    left, noise
        `[n]`, residuals of mean 0, and what their standard deviations are predicted to be.
    """
    if not len(left):
        return 0.0
    factors, sizes = _FACTORS[:, None], _SIZES * float(np.median(noise))
    likelihood = -0.5 * (np.log(factors) / _FACTOR_SPREAD) ** 2 + np.zeros(len(sizes))
    for i, size in enumerate(sizes):
        variance = (factors * noise) ** 2 + size**2
        terms = (_FREEDOM + 1) * np.log1p(left**2 / (_FREEDOM * variance)) + np.log(variance)
        likelihood[:, i] -= 0.5 * np.sum(terms, axis=1)
    factor, size = np.unravel_index(np.argmax(likelihood), likelihood.shape)
    if likelihood[factor, size] - likelihood[:, 0].max() <= _SIGNIFICANT:
        return 0.0
    # The distribution's width is no standard deviation: both parts are scaled to the residuals' median.
    whole = np.hypot(_FACTORS[factor] * noise, sizes[size])
    return float(sizes[size] * 1.4826 * np.median(np.abs(left) / whole))
