"""Settings of the window matchers, and the result of the search, on which the sub-pixel step works."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, Sampling
from harness.matching.filter import kernel_reach
from harness.matching.interface import MatcherSettings, Matches, Support
from harness.matching.pair import Pair
from harness.matching.window.subpixel import Subpixel
from harness.spec import Positive


class WindowMatcher(MatcherSettings):
    """Settings of the window matchers; the paper leaves all of them open but the cost, d_min's and d_max's existence
    and the parabola over three neighbours a side.
    """

    briefs: ClassVar[Mapping[str, str]] = {
        "window": "a square window moved along the epipolar curve, as in the paper",
        "column": "a window whose columns follow their own epipolar curves, some five times as fast",
    }

    kind: Literal["window", "column"] = "window"
    """`window` moves a square along the curve of its middle, as the paper does. `column` lets each column of the
    window follow its own curve, and interpolates between rows: another definition, and some five times as fast."""
    cost: Literal["sad", "ssd", "zncc", "census"] = "sad"
    """How windows are compared, on the filtered panoramas. `sad` and `ssd`: the sum of absolute or squared
    differences of grey levels, which need the filter to take offsets out. `zncc`: 1 less the zero-mean normalised
    cross-correlation, which a gain and an offset between the views leave as it is. `census`: the number of
    different bits of census transforms (5 x 5 neighbours), which any growing function of the grey levels leaves as
    it is. `zncc` and `census` do better without the filter (`filter.log_sigma_px = 0`): on the paper's box, with
    noise of 8 grey levels, the median error on walls, after any step but `parabola`, is then a tenth to a fifth
    smaller, and fewer matches on the floor are gross."""
    window_px: Annotated[int, Field(ge=1, le=99)] = 11
    """Side of the window, panorama pixels; odd, so that it has a centre. 11 is large enough for the filtered
    texture to be distinguishable, and small enough that a window on a wall stays nearly at one disparity."""
    sampling: Sampling = "phi"
    """Whether the samples along an epipolar curve are equally spaced in phi, by columns, or in alpha_2. `column`
    needs `phi`."""
    pitch_px: Positive = 1.0
    """Distance of the samples along an epipolar curve, panorama pixels; 1 is the panorama's own resolution. Finer
    ones are for `column`, which interpolates between columns; a square at the nearest pixel is the same for
    neighbouring samples."""
    subpixel: Subpixel = "parabola"
    """The sub-pixel step. `none`; `parabola`, least squares over `neighbours` samples to each side, the paper's;
    `parabola3`, through three samples; `v`, two lines of opposite slopes through three, the shape of a minimum of
    SAD or census; `shimizu-okutomi`, the mean of three-point fits to whole and to half samples, whose errors
    cancel; `images`, which interpolates images in place of costs: Gauss-Newton steps on the squared differences of
    the two windows (after gain and offset, if the cost is indifferent to them), view 2 resampled by cubic
    B-splines."""
    neighbours: Annotated[int, Field(ge=1, le=9)] = 3
    """Samples to each side that the sub-pixel step `parabola` is fitted to."""

    @model_validator(mode="after")
    def _sensible(self) -> "WindowMatcher":
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px must be odd, so that the window has a centre; found {self.window_px}")
        if self.kind == "column":
            if self.sampling != "phi":
                raise ValueError(
                    f'kind = "column" needs sampling = "phi", in whole columns; found sampling = "{self.sampling}"'
                )
            parts = self.samples_per_column
            if parts < 1 or abs(parts * self.pitch_px - 1) > 1e-6:
                raise ValueError(
                    'kind = "column" needs pitch_px = 1/m with a whole m, such as 1, 0.5 or 0.25, so that every sample'
                    f" falls on a column; found {self.pitch_px:g}"
                )
        return self

    def match(self, pair: Pair) -> Matches:
        """The matches of the filtered panoramas; the search is shared by all sub-pixel steps."""
        from harness.matching.window.match import match_windows

        return match_windows(pair, self)

    @property
    def step(self) -> str:
        """The sub-pixel step, by its name."""
        return self.subpixel

    def match_seconds(self, image_mp: float, curve_mp: float) -> float:  # noqa: ARG002 - by the panorama alone
        """See `MatcherSettings.match_seconds`: running sums, or windows that take the longer the wider they are."""
        if self.kind == "column":
            return curve_mp * (0.27 if self.cost in ("zncc", "census") else 0.15)
        return curve_mp * (0.45 + 0.022 * self.window_px)

    @property
    def window(self) -> int:
        """Side of the window, panorama pixels."""
        return self.window_px

    def sampled(self, t_v1: Array) -> tuple[Sampling, float]:  # noqa: ARG002 - the settings say how
        """How the epipolar curves are sampled, and the distance of samples in columns."""
        return self.sampling, self.pitch_px

    @property
    def search(self) -> "WindowMatcher":
        """The search for the best whole sample, which all sub-pixel steps share."""
        return self.model_copy(update={"subpixel": "none"})

    def support(self, log_sigma_px: float) -> Support:
        """The window and the reach of the filter's kernel around it: all pixels that a match is made from."""
        return Support(max(3, self.window_px + 2 * kernel_reach(log_sigma_px)), "frontal")

    @property
    def samples_per_column(self) -> int:
        """Samples from one column to the next, rounded: m for a pitch of 1/m."""
        return round(1 / self.pitch_px)


@dataclass(frozen=True)
class WholePixelMatches:
    """The best sample of each curve and the costs around it."""

    curves: Curves
    k: NDArray[np.int32]
    costs: Array
    """`[height, width, 2 reach + 1]`, grey levels (squared with `ssd`; bits with `census`; no unit with `zncc`); NaN
    where a sample has no whole window."""
    reason: NDArray[np.uint8]
