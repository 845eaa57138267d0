"""Slanted windows as a matcher: semi-global matching to start from, then least squares on the mirror images."""

from harness.matching.interface import Matches
from harness.matching.pair import Pair
from harness.matching.semi_global.match import SemiGlobal, forget_large
from harness.matching.slanted.refine import refine_slanted
from harness.matching.slanted.settings import Slanted


def match_slanted(pair: Pair, matcher: Slanted) -> Matches:
    """Match the mirror images; shared with trials that need the same."""
    start = SemiGlobal(d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m, plane_px=1)

    def refined() -> Matches:
        alpha_2 = pair.shared("start", start, lambda: start.match(pair)).alpha_2
        forget_large(pair.grid)
        return refine_slanted(
            pair.images,
            pair.sensors,
            pair.motion,
            pair.grid,
            alpha_2,
            settings=matcher,
            threads=pair.available_threads,
        )

    return pair.shared("refine", matcher, refined)
