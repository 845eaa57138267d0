"""The noise of one image, from what is left of it where there is least texture.

scikit-image's `estimate_sigma` takes the median over the whole image, which is the texture's where most of it has
some: 5 grey levels of the noise-free box. The fourth differences by which `harness.matching.slanted.noise` compares two
views leave less of the texture, but also less of noise that neighbouring pixels share: of a white noise that was
smoothed by (1, 2, 1)/4 along both axes they find 6 % of the standard deviation, the second ones here 15 %.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.geometry.angles import Array

_SIDE_PX = 17
_QUANTILE = 0.1
"""Share of blocks that have less."""
_LEAST_KNOWN = 0.5
_MOST_SATURATED = 0.05
"""Share of a block's pixels that are as dark or as light as any: with more, much of the noise is cut off."""
_OF_WHITE_NOISE = 0.93
"""What that quantile is of white noise's standard deviation: 289 correlated values vary by some 6 %."""
_SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0]) / np.sqrt(6.0)
"""White noise keeps its variance; grey levels that are linear in the row or in the column vanish."""


def noise_of(image: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """The standard deviation of an image's noise, in its grey levels; 0 where no block of 17 x 17 pixels is known.

    It is too large where all of the image has texture as fine as a pixel, and too small for noise that is correlated
    from pixel to pixel, as after demosaicing.

    Parameters
    ----------
    image, known
        `[height, width]`; the values of other pixels do not matter. What is not finite is not known either.

    References
    ----------
    J. Immerkær, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996), for the filter.
    """
    known = known & np.isfinite(image)
    if not known.any():
        return 0.0
    filled = np.where(known, image, 0.0).astype(np.float64)
    cut_off = known & ((filled == filled[known].min()) | (filled == filled[known].max()))
    for axis in (0, 1):
        filled = ndimage.correlate1d(filled, _SECOND_DIFFERENCE, axis)
    inside = ndimage.binary_erosion(known, np.ones((3, 3)))
    share, saturated = (_block_means(each.astype(np.float64)) for each in (inside, cut_off))
    whole = share > _LEAST_KNOWN
    usable = whole & (saturated < _MOST_SATURATED)
    usable = usable if usable.sum() > _QUANTILE * whole.sum() else whole
    variance = _block_means(np.where(inside, filled**2, 0.0))[usable] / share[usable]
    return float(np.sqrt(np.quantile(variance, _QUANTILE))) / _OF_WHITE_NOISE if variance.size else 0.0


def _block_means(values: Array) -> Array:
    rows, columns = (size // _SIDE_PX for size in values.shape)
    cut = values[: rows * _SIDE_PX, : columns * _SIDE_PX]
    return np.asarray(cut.reshape(rows, _SIDE_PX, columns, _SIDE_PX).mean(axis=(1, 3)))
