"""The share of rounding in the error at whole samples, which the paper calls discretization."""

import numpy as np

from harness.evaluation.pixel_errors import Errors, Reference
from harness.geometry.angles import Array


def rounding(reference: Reference, errors: Errors, k: Array) -> dict[str, float | None]:
    """Errors on walls of the domain beside those of rounding to the nearest sample alone; empty without any match.

    Parameters
    ----------
    k
        `[height, width]`: the matched samples, whole numbers; NaN where there is no match.

    Returns
    -------
    dict
        `nearest`: share of the estimates that are the sample nearest to the truth. `median_m`: median |range error|;
        `rounding_m`: the same if each estimate were the sample nearest to its truth, to first order (the law times the
        angle between the two). `steps_of_one`: of the neighbours in a row whose sample numbers differ, the share that
        differ by one, None if no numbers differ.
    """
    walls = reference.domain & reference.wall & np.isfinite(k) & np.isfinite(errors.range_m)
    if not walls.any():
        return {}
    step = 2 * reference.half_step[walls]
    off = errors.alpha_2[walls] / step
    to_nearest = np.abs(off - np.rint(off)) * step
    steps = np.abs(np.diff(k, axis=1)[walls[:, 1:] & walls[:, :-1]])
    jumps = steps[steps > 0]
    return {
        "nearest": float(np.mean(np.abs(off) <= 0.5)),
        "median_m": float(np.median(np.abs(errors.range_m[walls]))),
        "rounding_m": float(np.median(reference.law[walls] * to_nearest)),
        "steps_of_one": float(np.mean(jumps == 1)) if jumps.size else None,
    }
