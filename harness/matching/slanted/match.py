"""Slanted windows as a matcher: semi-global matching to start from, then least squares on the mirror images."""

from typing import Literal

from harness.matching.interface import Matches, Support
from harness.matching.pair import Pair
from harness.matching.semi_global import match as semi_global
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted.refine import SlantedSettings, refine_slanted


class Slanted(SlantedSettings):
    """Slanted windows, started from semi-global matching with its own settings but for the limits."""

    kind: Literal["slanted"] = "slanted"
    """Slanted windows, by least squares on the mirror images."""

    def support(self, log_sigma_px: float) -> Support:  # noqa: ARG002 - the mirror images themselves are matched
        """The window; the start, and planes taken from beside it, are not counted."""
        return Support(self.window_px, "slanted", "mirror")


def match_pair(pair: Pair, matcher: Slanted) -> Matches:
    """Match the mirror images; shared by all who ask for the same."""
    start = SemiGlobal(d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m)

    def refined() -> Matches:
        coarse = pair.shared("start", start, lambda: semi_global.match_pair(pair, start))
        return refine_slanted(
            pair.images,
            pair.sensor,
            pair.motion,
            pair.grid,
            coarse.alpha_2,
            settings=matcher,
            threads=pair.available_threads,
        )

    return pair.shared("refine", matcher, refined)
