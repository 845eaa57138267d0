"""The figures that sum up an estimate. A pixel without an estimate counts in the density and nowhere else."""

import numpy as np
from numpy.typing import NDArray

from harness.evaluation.errors import Errors

Measures = dict[str, float | None]


def measure(domain: NDArray[np.bool_], valid: NDArray[np.bool_], found: Errors) -> Measures:
    """Figures over the valid pixels of a domain; None where there are none.

    Parameters
    ----------
    domain
        `[height, width]`: the pixels spoken of.
    valid
        `[height, width]`: those with an estimate.

    Returns
    -------
    dict
        `density` (valid / domain), `disparity_median_abs_px`, `disparity_rmse_px`, `bad_1px` (share of absolute
        errors above one pixel), `range_median_abs_m`, `range_mae_m`, `range_rmse_m`, `range_bias_m` (mean, signed).
    """
    pixels = domain & valid
    disparity, distance = found.disparity_px[pixels], found.range_m[pixels]
    measures: Measures = {"density": float(pixels.sum() / domain.sum()) if domain.any() else None}
    if not pixels.any():
        return measures | dict.fromkeys(_FIGURES)
    return measures | {
        "disparity_median_abs_px": float(np.median(np.abs(disparity))),
        "disparity_rmse_px": float(np.sqrt(np.mean(disparity**2))),
        "bad_1px": float(np.mean(np.abs(disparity) > 1)),
        "range_median_abs_m": float(np.median(np.abs(distance))),
        "range_mae_m": float(np.mean(np.abs(distance))),
        "range_rmse_m": float(np.sqrt(np.mean(distance**2))),
        "range_bias_m": float(np.mean(distance)),
    }


_FIGURES = (
    "disparity_median_abs_px",
    "disparity_rmse_px",
    "bad_1px",
    "range_median_abs_m",
    "range_mae_m",
    "range_rmse_m",
    "range_bias_m",
)
