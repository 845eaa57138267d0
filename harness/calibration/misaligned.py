"""What should be known of a misalignment that was found from boards."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from harness.calibration.uncertainty import Uncertainty
from harness.camera.sensor import Sensor

_TRADES_OFF = 0.98
_VAGUE = {"mm": 1.0, "deg": 0.5}
"""Standard deviations above which a number says little: those of a camera fitted with some care."""
_CHANCE = 11.07
"""The 95 % point of chi-squared with five degrees of freedom."""


def is_misalignment(key: str) -> bool:
    """Whether a dotted key is one of the misalignment's."""
    return key.startswith("misalignment.")


def significance(keys: Sequence[str], uncertainty: Uncertainty) -> float:
    """How far from aligned the numbers are together: `v^T C^-1 v` of those that were found (Wald), no unit.

    Chi-squared with as many degrees of freedom if camera and mirror are aligned.
    """
    own = [i for i, key in enumerate(keys) if is_misalignment(key)]
    values, C = uncertainty.values[own], uncertainty.covariance[np.ix_(own, own)]
    return float(values @ np.linalg.solve(C, values)) if np.isfinite(C).all() else 0.0


def misalignment_notes(keys: Sequence[str], uncertainty: Uncertainty, start: Sensor) -> Iterator[str]:
    """What should be known before the numbers are used; nothing where no misalignment was looked for."""
    own = [i for i, key in enumerate(keys) if is_misalignment(key)]
    if not own:
        return
    mirror: Any = start.model
    if "model.a_m" not in keys:
        yield (
            f"Millimetres are in proportion to the mirror, whose size was taken for granted: a_m = {mirror.a_m:.4g}; "
            "fix a_m to give it."
        )
    yield "The turn about the mirror's axis was held: it turns all boards alike, and no image tells it."
    vague = [
        keys[i].partition(".")[2]
        for i in own
        if uncertainty.sigma[i] > _VAGUE["deg" if keys[i].endswith("_deg") else "mm"]
    ]
    if vague:
        yield f"The boards hardly tell {', '.join(vague)}: rays are known better; fix what is known of the camera."
    pairs = _strongest(keys, uncertainty, own)
    if pairs:
        yield f"These trade off with each other: {'; '.join(pairs)}. Compare rays, not numbers."
    if len(own) == 5 and significance(keys, uncertainty) < _CHANCE:
        yield "The corners show no misalignment beyond chance: a central sensor explains them as well."


def _strongest(keys: Sequence[str], uncertainty: Uncertainty, own: Sequence[int]) -> list[str]:
    """For each number its strongest correlation, where it is strong, the strongest first."""
    correlation = np.nan_to_num(uncertainty.correlation) - np.eye(len(keys))
    pairs = {}
    for i in own:
        j = int(np.argmax(np.abs(correlation[i])))
        if abs(correlation[i, j]) > _TRADES_OFF:
            pairs[min(i, j), max(i, j)] = correlation[i, j]
    ordered = sorted(pairs.items(), key=lambda each: -abs(each[1]))
    return [f"{keys[j].partition('.')[2]} and {keys[i].partition('.')[2]} ({r:.4f})" for (i, j), r in ordered]
