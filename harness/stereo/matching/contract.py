"""What every window matcher takes and gives: its settings, and the matches or the reasons why there are none."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from harness.camera.angles import Array
from harness.spec import Positive, Spec
from harness.stereo.epipolar import Curves, Sampling
from harness.stereo.matching.subpixel import Subpixel


class WindowMatcher(Spec):
    """Settings of the window matchers; the paper leaves all of them open but the cost, d_min's and d_max's existence
    and the parabola over three neighbours a side.

    - `kind`: `window` moves a square along the curve of its middle, as the paper does. `column` lets each column of the
      window follow its own curve, and interpolates between rows: another definition, and some twenty times as fast.
    - `window_px` 11: large enough for the LoG texture to be told apart, small enough that a window on a wall stays
      nearly at one disparity. Odd, so that it has a centre.
    - `sampling`, `pitch_px`: one sample a column, the panorama's own resolution.
    - `d_min_m` 1: the floor is nearest at the bottom row, 1.22 m away under a sensor 1 m high.
    - `d_max_m` 10: more than twice the farthest point of the paper's box (4.5 m), so that the limit hides no error,
      yet finite, so that every matched pixel has a range.
    """

    kind: Literal["window", "column"] = "window"
    cost: Literal["sad", "ssd"] = "sad"
    window_px: Annotated[int, Field(ge=1, le=99)] = 11
    sampling: Sampling = "phi"
    pitch_px: Positive = 1.0
    d_min_m: Positive = 1.0
    d_max_m: Annotated[float, Field(gt=0)] = 10.0
    subpixel: Subpixel = "parabola"
    neighbours: Annotated[int, Field(ge=1, le=9)] = 3

    @model_validator(mode="after")
    def _sensible(self) -> "WindowMatcher":
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px must be odd, so that the window has a centre; found {self.window_px}")
        if not self.d_min_m < self.d_max_m:
            raise ValueError(f"d_min_m = {self.d_min_m:g} must be below d_max_m = {self.d_max_m:g}")
        if self.kind == "column":
            if self.sampling != "phi":
                raise ValueError(
                    f'kind = "column" needs sampling = "phi", which goes by columns; found sampling = "{self.sampling}"'
                )
            parts = self.samples_per_column
            if parts < 1 or abs(parts * self.pitch_px - 1) > 1e-6:
                raise ValueError(
                    'kind = "column" needs pitch_px = 1/m with a whole m, such as 1, 0.5 or 0.25, so that every sample'
                    f" falls on a column; found {self.pitch_px:g}"
                )
        return self

    @property
    def samples_per_column(self) -> int:
        """Samples from one column to the next, rounded: m for a pitch of 1/m."""
        return round(1 / self.pitch_px)


class Reason(IntEnum):
    """Why a pixel has no match (0: it has one)."""

    MATCHED = 0
    CURVE_LEAVES_IMAGE = 1
    """A sample of the curve, or its extremum, has no whole window in the second panorama."""
    WINDOW_LEAVES_IMAGE = 2
    """The pixel's own window is not whole in the first panorama."""
    NO_EPIPOLAR_PLANE = 3
    """The pixel looks along t, or n_z vanishes and phi cannot follow the curve."""
    NO_SAMPLE = 4
    """The search interval falls between two samples of the curve."""
    BEYOND_INFINITY = 5
    """There is a match, but its rays are parallel or diverge: no range."""


@dataclass(frozen=True)
class Matches:
    """What a matcher found: an angle for each pixel of view 1's panorama."""

    alpha_2: Array
    """`[height, width]`, radians; NaN where there is no match."""
    reason: NDArray[np.uint8]
    """`[height, width]`, `Reason`."""
    refined: NDArray[np.bool_]
    """`[height, width]`: moved off the whole sample by the sub-pixel step."""
    k: Array
    """`[height, width]`, position on the curve in samples; NaN where there is no match."""


@dataclass(frozen=True)
class WholePixelMatches:
    """The best sample of each curve and the costs around it: all that a sub-pixel step needs."""

    curves: Curves
    k: NDArray[np.int32]
    costs: Array
    """`[height, width, 2 reach + 1]`, grey levels (squared with `ssd`); NaN where a sample has no whole window."""
    reason: NDArray[np.uint8]
