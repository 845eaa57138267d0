"""How noisy images are smoothed before windows are fitted to them.

The gradient that a step goes by is that of view 2's image, noise and all, and of view 1's in the match back. Where most
of it is noise a step goes only a small part of the way, so that the start stays, and its bias with it; and what the
images have in common lies at lower frequencies than the noise. So both are smoothed by the kernel (blur, 1 - 2 blur,
blur) along rows and columns, the more the larger the noise's share is. Without noise nothing is: smoothing treats two
views of one texture alike only if they show it at the same scale.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_NOISY = 0.05
"""Share of noise in squared gradients, in the middle of all windows, from which on images are smoothed. Without noise
detail finer than pixels looks like a share of 0.02 to 0.04."""

_BY_SHARE = 1 / 6
"""A neighbour's weight for a share of 1: chosen on the box, corridor and room at noises of 2 to 20 grey levels, where
weights near it have the smallest median errors (of 0.02 at a noise of 4, 0.04 to 0.1 at 10, up to 0.14 at 20)."""


_BACK = 0.5
"""How much the share of view 1's noise counts, by whose gradients nothing but the match back goes. In corridor, box and
room with a noise of 20 in view 1 alone, all of it would match 2.6, 0.3 and 0.9 % more, and in the latter two the median
error would grow by 5 %; half of it has half of either."""


def blur_for(
    share: NDArray[np.floating], residual: NDArray[np.floating], odds_of_1: NDArray[np.floating] | float = 1.0
) -> float:
    """A neighbour's weight for what a first step has found, 0 for none.

    Parameters
    ----------
    share, residual, odds_of_1
        Of every window: how much of the sum of view 2's squared gradients is noise; the residual's variance, infinite
        where there is no plane; and view 1's noise per view 2's. A share of 1 says that the two views have nothing in
        common there.
    """
    there = np.isfinite(residual) & (share < 1)
    if not there.any():
        return 0.0
    noise = float(np.median(share[there]))
    if isinstance(odds_of_1, np.ndarray):
        f = share[there].astype(np.float64)
        back = odds_of_1[there] * f
        noise = max(noise, _BACK * float(np.median(back / (back + 1 - f))))
    return _BY_SHARE * noise if noise > _NOISY else 0.0


def smoothed(image: NDArray[np.float32], blur: float) -> NDArray[np.float32]:
    """The image, smoothed."""
    kernel = (blur, 1 - 2 * blur, blur)
    rows = ndimage.correlate1d(image, kernel, axis=0, mode="nearest")
    return np.asarray(ndimage.correlate1d(rows, kernel, axis=1, mode="nearest"))


def noise_left(blur: float) -> float:
    """The variance of a smoothed pixel of white noise, as a share of what it was."""
    return ((1 - 2 * blur) ** 2 + 2 * blur**2) ** 2
