"""Scores of a warped view against the rendered one.

Peak signal-to-noise ratio 10 log10(255^2 / mean squared error), the same with pixels weighted by their solid angle
(WS-PSNR: Y. Sun, A. Lu and L. Yu, Weighted-to-spherically-uniform quality evaluation for omnidirectional video, IEEE
Signal Processing Letters 2017), and structural similarity (scikit-image's). Holes are counted separately; the scored
view has them filled, so that no view gains from leaving out difficult parts.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from harness.geometry.angles import Array
from harness.geometry.panorama import Grid

Mask = NDArray[np.bool_]

PEAK_GREY = 255.0
MOST_DB = 99.0
"""The PSNR of two equal views: finite, so that means can be taken."""


@dataclass(frozen=True)
class ViewScore:
    """Figures of one view over the pixels that are compared."""

    psnr_db: float
    ws_psnr_db: float
    """PSNR over the compared pixels, weighted by solid angle."""
    ssim: float
    holes: float
    """Share of the pixels that were filled."""
    disoccluded: float
    """Share of the pixels that view 1 truly has not seen."""
    disoccluded_rmse_grey: float | None
    """RMSE over these pixels, grey levels; None without any."""
    seen_psnr_db: float
    """PSNR over the pixels that view 1 sees and that are no holes."""


def solid_angles(grid: Grid) -> Array:
    """Solid angle of each pixel of a panorama `[height, width]`, steradians: d phi dz / (1 + z^2)^(3/2)."""
    of_row = grid.phi_pitch * grid.z_pitch / (1 + grid.z**2) ** 1.5
    return np.broadcast_to(of_row[:, None], grid.shape)


def score_view(
    grid: Grid,
    grey: NDArray[np.floating],
    expected: NDArray[np.floating],
    compared: Mask,
    holes: Mask,
    disoccluded: Mask,
) -> ViewScore:
    """The figures of a panorama whose holes are filled.

    Parameters
    ----------
    grey, expected
        `[height, width]`, 0 .. 255; `grey` finite where it is compared.
    compared
        The pixels that count; at least one.
    holes
        The pixels of `grey` that were filled.
    disoccluded
        The pixels that view 1 does not see, by the truth.
    """
    squared = np.square(np.where(compared, np.asarray(grey, np.float64) - expected, 0.0))
    unseen = compared & disoccluded
    return ViewScore(
        psnr_db=_psnr(squared, compared.astype(np.float64)),
        ws_psnr_db=_psnr(squared, solid_angles(grid) * compared),
        ssim=_ssim(grey, expected, compared),
        holes=float((holes & compared).sum() / compared.sum()),
        disoccluded=float(unseen.sum() / compared.sum()),
        disoccluded_rmse_grey=math.sqrt(squared[unseen].mean()) if unseen.any() else None,
        seen_psnr_db=_psnr(squared, (compared & ~holes & ~disoccluded).astype(np.float64)),
    )


def _psnr(squared: Array, weights: Array) -> float:
    total = float(weights.sum())
    mean = float((squared * weights).sum()) / total if total else math.inf
    if mean == 0:
        return MOST_DB
    return min(10 * math.log10(PEAK_GREY**2 / mean), MOST_DB) if math.isfinite(mean) else math.nan


def _ssim(grey: NDArray[np.floating], expected: NDArray[np.floating], compared: Mask) -> float:
    """The mean over the compared pixels; their neighbours beyond count as equal."""
    both = [np.where(compared, each, np.where(compared, 0.0, expected)) for each in (grey, expected)]
    both = [np.nan_to_num(each) for each in both]
    wrapped = [np.pad(each, ((0, 0), (3, 3)), mode="wrap") for each in both]
    _, similarity = structural_similarity(*wrapped, data_range=PEAK_GREY, full=True)  # type: ignore[no-untyped-call]
    return float(similarity[:, 3:-3][compared].mean())
