"""Settings of OpenCV's matchers. The defaults are those of OpenCV's own stereo sample (`stereo_match.cpp`)."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from harness.matching.interface import MatcherSettings, Matches
from harness.matching.pair import Pair

Percent = Annotated[int, Field(ge=0, le=100)]


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"must be odd, so that it has a centre; found {value}")
    return value


class OpenCV(MatcherSettings):
    """Base of the settings of OpenCV's matchers: a block, on a rectified pair of some size.

    How many disparities are searched follows from `d_min_m`: see `rectify.disparities`.
    """

    rectified_scale: Annotated[float, Field(ge=0.25, le=8)] = 1.0
    """Columns of the rectified pair to a column of the panorama, no unit: at 1 one pixel of disparity is one of the
    panorama's."""
    block_px: Annotated[int, Field(ge=1, le=99)] = 3
    """Side of the block that is compared, rectified pixels; odd."""

    _odd_block = field_validator("block_px")(_odd)

    def match_seconds(self, image_mp: float, curve_mp: float) -> float:  # noqa: ARG002 - by the rectified pair alone
        """See `MatcherSettings.match_seconds`: columns and rows of the rectified pair."""
        return 0.6 * curve_mp * self.rectified_scale**2

    @property
    def extra(self) -> str:
        """The extra that installs OpenCV."""
        return "peers"


class Filtered(OpenCV):
    """Base of the settings of StereoBM and StereoSGBM."""

    interpolation: Literal["linear", "cubic", "lanczos4"] = "linear"
    """How the rectified pair is interpolated; OpenCV itself rectifies with `linear`."""
    uniqueness_percent: Percent = 10
    """Least margin of the best cost below the next best, per cent."""
    disp12_max_diff_px: Annotated[int, Field(ge=-1)] = 1
    """Largest miss of a match back from view 2, rectified pixels; -1 for no limit."""
    speckle_px: Annotated[int, Field(ge=0)] = 100
    """Connected regions of no more than this many pixels are dropped; 0 keeps them all."""
    speckle_range_px: Annotated[int, Field(ge=0)] = 32
    """Largest difference of disparity between neighbouring pixels of one connected region, rectified pixels."""


class StereoBM(Filtered):
    """OpenCV's block matcher: sums of absolute differences over a square, after a pre-filter along the rows."""

    briefs: ClassVar[Mapping[str, str]] = {"opencv-bm": "OpenCV's StereoBM on a rectified pair"}

    kind: Literal["opencv-bm"] = "opencv-bm"
    """OpenCV's StereoBM."""
    block_px: Annotated[int, Field(ge=5, le=99)] = 9
    """Side of the block that is compared, rectified pixels; odd."""
    pre_filter: Literal["xsobel", "normalized"] = "xsobel"
    """`xsobel`: a horizontal Sobel derivative; `normalized`: the grey level against the mean over a square."""
    pre_filter_px: Annotated[int, Field(ge=5, le=255)] = 9
    """Side of the square of `normalized`, rectified pixels; odd."""
    pre_filter_cap: Annotated[int, Field(ge=1, le=63)] = 31
    """The pre-filtered values are clipped at plus or minus this, grey levels."""
    texture_threshold: Annotated[int, Field(ge=0)] = 10
    """The sum of the absolute pre-filtered values over the block must reach this, grey levels."""
    uniqueness_percent: Percent = 15
    """Least margin of the best cost below the next best, per cent."""

    def match(self, pair: Pair) -> Matches:
        """The matches of the rectified pair."""
        from harness.matching.opencv.match import block_match, in_opencv

        return in_opencv(pair, self, block_match)

    _odd_filter = field_validator("pre_filter_px")(_odd)


class StereoSGBM(Filtered):
    """OpenCV's semi-global block matcher."""

    briefs: ClassVar[Mapping[str, str]] = {"opencv-sgbm": "OpenCV's StereoSGBM on a rectified pair"}

    kind: Literal["opencv-sgbm"] = "opencv-sgbm"
    """OpenCV's StereoSGBM."""
    p1_per_px: Annotated[float, Field(ge=0, le=100)] = 8.0
    """Cost of a change of the disparity by one pixel from a pixel to its neighbour, as a multiple of the block's
    area: OpenCV's P1 is 8 times the area."""
    p2_per_px: Annotated[float, Field(gt=0, le=200)] = 32.0
    """Cost of a larger change, as a multiple of the block's area: OpenCV's P2 is 32 times the area."""
    mode: Literal["sgbm", "hh", "3way", "hh4"] = "sgbm"
    """Paths of 5 directions in one pass (`sgbm`), of 8 in two (`hh`), of 3 (`3way`) or 4 (`hh4`)."""
    pre_filter_cap: Annotated[int, Field(ge=1, le=127)] = 63
    """The horizontal derivative is clipped at plus or minus this, grey levels; OpenCV takes no less than 15."""

    def match(self, pair: Pair) -> Matches:
        """The matches of the rectified pair."""
        from harness.matching.opencv.match import block_match, in_opencv

        return in_opencv(pair, self, block_match)

    @model_validator(mode="after")
    def _jumps_cost_more(self) -> "StereoSGBM":
        if not self.p1_per_px < self.p2_per_px:
            raise ValueError(f"p1_per_px = {self.p1_per_px:g} must be below p2_per_px = {self.p2_per_px:g}")
        return self


class StereoReconstruct(OpenCV):
    """`cv2.omnidir.stereoReconstruct` unchanged; it has no other settings: see `matchers.reconstruct`."""

    briefs: ClassVar[Mapping[str, str]] = {"opencv-reconstruct": "OpenCV's omnidir.stereoReconstruct"}

    kind: Literal["opencv-reconstruct"] = "opencv-reconstruct"
    """OpenCV's `omnidir.stereoReconstruct`."""

    def match(self, pair: Pair) -> Matches:
        """The matches that follow from OpenCV's points."""
        from harness.matching.opencv.match import in_opencv, reconstruct

        return in_opencv(pair, self, reconstruct)
