"""Settings of the slanted windows."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from harness.matching.interface import MatcherSettings, Matches, Support
from harness.matching.pair import Pair
from harness.spec import Positive


class Slanted(MatcherSettings):
    """Slanted windows, started from semi-global matching with that matcher's defaults and these limits."""

    briefs: ClassVar[Mapping[str, str]] = {"slanted": "least squares over slanted windows: the most accurate"}

    kind: Literal["slanted"] = "slanted"
    """Slanted windows fitted to the mirror images by least squares."""

    window_px: Annotated[int, Field(ge=5, le=99)] = 17
    """Side of the square window, pixels of the mirror image; odd."""
    patch_px: Annotated[int, Field(ge=1, le=31)] = 5
    """Side of the surroundings by which a pixel chooses between planes, pixels of the mirror image; odd."""
    iterations: Annotated[int, Field(ge=1, le=50)] = 8
    """Gauss-Newton steps. Without noise nothing moves after 4; noise makes them shorter (see `sigma`)."""
    narrow_iterations: Annotated[int, Field(ge=0, le=50)] = 3
    """How many of the first steps, of those that are not sharp, fit windows two thirds as wide. Wide ones lose what is
    narrower than they are to what lies beside it. Without narrow ones a third more is off by more than 1 px."""
    sharp_iterations: Annotated[int, Field(ge=1, le=50)] = 3
    """How many of the last steps look at patches; those before choose by windows alone, at a fraction of the cost,
    and go farther, so that less of the start remains."""
    consistency_px: Positive = 1.0
    """Largest difference from view 2's own match, panorama pixels."""
    max_sigma_px: Positive = 1.0
    """Largest predicted standard deviation of a match, panorama pixels; beyond it the pixel has none. The limit is the
    narrower the less the pixel's surroundings and the start bear the match out; see `doubt`."""

    @model_validator(mode="after")
    def _have_a_centre(self) -> "Slanted":
        for key in ("window_px", "patch_px"):
            if getattr(self, key) % 2 == 0:
                raise ValueError(f"{key} must be odd, so that it has a centre; found {getattr(self, key)}")
        return self

    def match(self, pair: Pair) -> Matches:
        """The matches of the mirror images; shared with trials that need the same."""
        from harness.matching.slanted.match import match_slanted

        return match_slanted(pair, self)

    def match_seconds(self, image_mp: float, curve_mp: float) -> float:
        """See `MatcherSettings.match_seconds`: a coarse search on the panorama, and windows on the image."""
        return 1.8 * image_mp * (self.window_px / 17) ** 2 + 0.5 * curve_mp

    def support(self, log_sigma_px: float) -> Support:  # noqa: ARG002 - the mirror images themselves are matched
        """The window; the start, and planes taken from beside it, are not counted."""
        return Support(self.window_px, "slanted", "mirror")
