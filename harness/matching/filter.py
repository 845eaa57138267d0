"""The Laplacian of Gaussian, for some invariance to illumination (section 4 of the paper)."""

import numpy as np
from scipy import ndimage

from harness.geometry.panorama import Panorama

_TRUNCATE = 4.0
"""The kernel is cut at four standard deviations, where the Gaussian has fallen to 3e-4 of its top."""


def kernel_reach(sigma_px: float) -> int:
    """Reach of the filter to each side, pixels."""
    return int(_TRUNCATE * sigma_px + 0.5)


def laplacian_of_gaussian(panorama: Panorama, sigma_px: float) -> Panorama:
    """`sigma² ∇²(G_sigma * I)`, scale-normalised, around the seam at phi = ±pi.

    Parameters
    ----------
    sigma_px
        Standard deviation in pixels of the panorama, the same along phi and z. 0 returns the panorama unfiltered.

    Returns
    -------
    Panorama
        Valid where every pixel under the kernel is. The panorama's own first and last rows are continued outwards.
    """
    if sigma_px == 0:
        return panorama
    mode = ("nearest", "wrap")
    # Not scipy's gaussian_laplace: given a mode for each axis it uses one of them for both axes of a derivative.
    values = sigma_px**2 * sum(
        ndimage.gaussian_filter(panorama.values, sigma_px, order=order, mode=mode, truncate=_TRUNCATE)
        for order in ((2, 0), (0, 2))
    )
    valid = panorama.valid
    if not valid.all():
        size = 2 * kernel_reach(sigma_px) + 1
        valid = ndimage.minimum_filter(valid, size=size, mode=mode)
    values = np.asarray(values, dtype=np.float32)
    values.flags.writeable = False
    return Panorama(panorama.grid, values, valid)
