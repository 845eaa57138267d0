"""The efficiency of a matcher: its spread over draws of the noise over the Cramér-Rao bound, pixel by pixel.

Spread and bias are separated, and gross errors from both: a matcher that takes one brick for another is not imprecise
but wrong, and a bound on precision does not apply.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special

from harness.geometry.angles import Array

GROSS_PX = 3.0
"""An error beyond this is a wrong match, not an imprecise one."""

MIN_DRAWS = 0.5
"""The least share of a pixel's draws that must have an estimate without gross error for its spread to count."""


@dataclass(frozen=True)
class Efficiency:
    """Spread and bias over the draws of one condition; medians are over pixels."""

    draws: int
    pixels: int
    """Pixels with enough draws, and with a bound if bounds are given."""
    density: float
    """Share of the sampled pixels and draws that have an estimate."""
    gross: float
    """Share of the estimates that are off by more than `GROSS_PX`."""
    std_px: float
    """Median standard deviation over draws."""
    bias_px: float
    """Median of |mean error over draws|; the mean itself is uncertain by std/√draws, which is subtracted in squares."""
    std_over_bound: float | None
    """Median of the ratio, pixel by pixel; None without a bound."""
    std_over_bound_quartiles: tuple[float, float] | None
    rms_over_bound: float | None
    """Median of the ratio with the bias included, √(std² + bias²); None without a bound."""


def efficiency(errors_px: Array, bound_px: Array | None) -> Efficiency | None:
    """Compare spread with bound.

    Parameters
    ----------
    errors_px
        `[draws, pixels]`: errors of alpha_2 in pixels of disparity under independent draws of the noise, all else being
        equal; NaN where there is no estimate.
    bound_px
        `[pixels]`, the smallest standard deviation possible; NaN where no bound is known.

    Returns
    -------
    Efficiency or None
        None with fewer than 3 draws, or when no pixel has enough of them.
    """
    draws = errors_px.shape[0]
    if draws < 3 or errors_px.shape[1] == 0:
        return None
    finite = np.isfinite(errors_px)
    fine = finite & (np.abs(np.where(finite, errors_px, 0.0)) <= GROSS_PX)
    count = fine.sum(axis=0)
    enough = count >= max(3, int(np.ceil(MIN_DRAWS * draws)))
    bounded = np.ones(count.size, dtype=bool) if bound_px is None else np.isfinite(bound_px) & (bound_px > 0)
    use = enough & bounded
    if not use.any():
        return None
    used_errors = np.where(fine[:, use], errors_px[:, use], 0.0)
    n = count[use]
    mean = used_errors.sum(axis=0) / n
    variance = np.where(fine[:, use], (used_errors - mean) ** 2, 0.0).sum(axis=0) / (n - 1)
    # The median of a chi-squared variable lies below its mean: few draws would flatter the median spread.
    median_of_chi_2 = 2 * special.gammaincinv((n - 1) / 2, 0.5)
    std = np.sqrt(variance / (median_of_chi_2 / (n - 1)))
    bias_2 = np.maximum(mean**2 - variance / n, 0.0)
    ratio = quartiles = rms = None
    if bound_px is not None:
        each = std / bound_px[use]
        low, middle, high = np.percentile(each, [25, 50, 75]).tolist()
        ratio, quartiles = middle, (low, high)
        rms = float(np.median(np.sqrt(variance + bias_2) / bound_px[use]))
    return Efficiency(
        draws=draws,
        pixels=int(use.sum()),
        density=float(finite.mean()),
        gross=float((finite & ~fine).sum() / max(finite.sum(), 1)),
        std_px=float(np.median(std)),
        bias_px=float(np.median(np.sqrt(bias_2))),
        std_over_bound=ratio,
        std_over_bound_quartiles=quartiles,
        rms_over_bound=rms,
    )


def within_without_bias(errors_px: Array, sigma_px: Array) -> tuple[float, float, float] | None:
    """Share of errors within 1, 2 and 3 predicted standard deviations once each pixel's own bias is subtracted.

    A predicted standard deviation is about noise. Beside the share with the bias left in (`confidence.calibration`)
    this one shows whether a share that looks right is right for the right reason: a sigma that is too large can hide a
    bias.

    Parameters
    ----------
    errors_px, sigma_px
        `[draws, pixels]`: errors and predicted standard deviations under independent draws of the noise, NaN where
        there is no estimate.

    Returns
    -------
    tuple or None
        None with fewer than 3 draws, or when no pixel has enough of them (see `efficiency`).
    """
    draws = errors_px.shape[0]
    if draws < 3:
        return None
    with np.errstate(invalid="ignore"):
        fine = (np.abs(errors_px) <= GROSS_PX) & (sigma_px > 0) & np.isfinite(sigma_px)
    count = fine.sum(axis=0)
    use = count >= max(3, int(np.ceil(MIN_DRAWS * draws)))
    if not use.any():
        return None
    finite, n = fine[:, use], count[use]
    errors = np.where(finite, errors_px[:, use], 0.0)
    mean = errors.sum(axis=0) / n
    # The mean of n draws follows them: deviations from it have (n - 1)/n of the variance.
    scaled = (errors - mean) / (np.where(finite, sigma_px[:, use], 1.0) * np.sqrt((n - 1) / n))
    one, two, three = (float((np.abs(scaled[finite]) <= k).mean()) for k in (1, 2, 3))
    return one, two, three
