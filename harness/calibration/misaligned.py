"""The significance and the determination of a misalignment that was estimated from boards."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from harness.calibration.uncertainty import Uncertainty
from harness.camera.sensor import Sensor
from harness.geometry.angles import Array

_TRADES_OFF = 0.98
_VAGUE = {"mm": 1.0, "deg": 0.5}
"""Standard deviations above which a number says little: those of a camera fitted with some care."""
_CHANCE = 11.07
"""The 95 % point of chi-squared with five degrees of freedom."""


def is_misalignment(key: str) -> bool:
    """Whether a dotted key is one of the misalignment's."""
    return key.startswith("misalignment.")


def significance(keys: Sequence[str], uncertainty: Uncertainty) -> float:
    """The joint significance of the estimated misalignment, `v^T C^-1 v` (Wald), no unit.

    Chi-squared with as many degrees of freedom if camera and mirror are aligned, and the covariance holds as far as
    there: boards some 0.3 m away and more determine the numbers so weakly that it does not. NaN if one is not
    determined.
    """
    own = [i for i, key in enumerate(keys) if is_misalignment(key)]
    values, C = uncertainty.values[own], uncertainty.covariance[np.ix_(own, own)]
    return float(values @ np.linalg.solve(C, values)) if np.isfinite(C).all() else np.nan


def likelihood_ratio(central_rms_px: float, residuals: Array, uncertainty: Uncertainty) -> float:
    """The increase of the sum of squared residuals with the best central sensor, over their variance; no unit.

    Chi-squared with as many degrees of freedom as misalignment has numbers if camera and mirror are aligned, however
    weakly the corners determine these.
    """
    return float(len(residuals) * central_rms_px**2 - np.sum(residuals**2)) / uncertainty.sigma_px**2


def misalignment_notes(
    keys: Sequence[str], uncertainty: Uncertainty, start: Sensor, ratio: float | None
) -> Iterator[str]:
    """Caveats about an estimated misalignment, one line each; none if no misalignment was estimated.

    Parameters
    ----------
    ratio
        `likelihood_ratio`; None where there is no central sensor to compare with.
    """
    own = [i for i, key in enumerate(keys) if is_misalignment(key)]
    if not own:
        return
    mirror: Any = start.model
    if "model.a_m" not in keys:
        yield (
            f"Millimetres are in proportion to the mirror, whose size is an assumption: a_m = {mirror.a_m:.4g}; "
            "fix a_m to give it."
        )
    yield "rotation_z_deg, about the mirror's axis, was held: it rotates all boards alike, and no image determines it."
    vague = [
        keys[i].partition(".")[2]
        for i in own
        if uncertainty.sigma[i] > _VAGUE["deg" if keys[i].endswith("_deg") else "mm"]
    ]
    if vague:
        yield (
            f"The boards hardly determine {', '.join(vague)}, of which rays are nearly independent; fix what is known "
            "of the camera."
        )
    pairs = _strongest(keys, uncertainty, own)
    if pairs:
        yield f"Strongly correlated: {'; '.join(pairs)}. Compare rays, not parameters."
    if len(own) == 5 and ratio is not None and ratio < _CHANCE:
        yield "The corners show no significant misalignment: a central sensor explains them as well."
        if significance(keys, uncertainty) >= _CHANCE:
            yield (
                "The standard deviations of the misalignment, and of what trades off with it, are too small here: the "
                "problem is not linear as far as they reach. Take boards nearer to the mirror, or fix what is known."
            )


def _strongest(keys: Sequence[str], uncertainty: Uncertainty, own: Sequence[int]) -> list[str]:
    """The strongest correlation of each number if it is a strong one, in order."""
    correlation = np.nan_to_num(uncertainty.correlation)
    np.fill_diagonal(correlation, 0.0)
    pairs = {}
    for i in own:
        j = int(np.argmax(np.abs(correlation[i])))
        if abs(correlation[i, j]) > _TRADES_OFF:
            pairs[min(i, j), max(i, j)] = correlation[i, j]
    ordered = sorted(pairs.items(), key=lambda each: -abs(each[1]))
    return [f"{keys[j].partition('.')[2]} and {keys[i].partition('.')[2]} ({r:.4f})" for (i, j), r in ordered]
