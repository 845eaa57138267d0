"""How well a matcher tells what view 2 does not see from what it merely could not match."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from harness.evaluation.regions import OCCLUDED, VISIBLE, Region


def occlusion_scores(regions: Sequence[Region], said: NDArray[np.bool_]) -> dict[str, float]:
    """Precision and recall of "hidden from view 2", over pixels at least 30° from the baseline in view 2's field.

    Parameters
    ----------
    regions
        Of the picture; see `regions.layout`.
    said
        `[height, width]`: pixels that the matcher says are hidden.

    Returns
    -------
    dict
        `occlusion_precision`, how many of those said to be hidden are, and `occlusion_recall`, how many of the hidden
        ones are said to be. Empty where nothing is said to be hidden: such a matcher does not tell. Without recall
        where nothing is hidden.
    """
    if not said.any():
        return {}
    pixels = {each.part: each.pixels for each in regions if each.part in (VISIBLE, OCCLUDED)}
    right, wrong = (int(np.count_nonzero(said.ravel()[pixels.get(part, [])])) for part in (OCCLUDED, VISIBLE))
    scores = {"occlusion_precision": right / (right + wrong)} if right + wrong else {}
    return scores | ({"occlusion_recall": right / pixels[OCCLUDED].size} if OCCLUDED in pixels else {})
