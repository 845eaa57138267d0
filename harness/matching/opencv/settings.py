"""Settings of OpenCV's matchers. The defaults are those of OpenCV's own stereo sample (`stereo_match.cpp`)."""

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from harness.matching.interface import Limits

Percent = Annotated[int, Field(ge=0, le=100)]


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"must be odd, so that there is a centre; found {value}")
    return value


class OpenCV(Limits):
    """What all of OpenCV's matchers have: a block, on a rectified pair of some size.

    How many disparities are searched follows from `d_min_m`: see `rectify.disparities`.

    - `rectified_scale` 1: columns of the rectified pair to a column of the panorama, so that one pixel of disparity is
      one of the panorama's.
    """

    rectified_scale: Annotated[float, Field(ge=0.25, le=8)] = 1.0
    block_px: Annotated[int, Field(ge=1, le=99)] = 3

    _odd_block = field_validator("block_px")(_odd)


class Filtered(OpenCV):
    """What StereoBM and StereoSGBM have in common beyond that.

    - `interpolation` linear: what OpenCV rectifies with.
    - `uniqueness_percent`: by how much the best cost must be below the next one elsewhere.
    - `disp12_max_diff_px`: how far a match back from view 2 may miss the pixel; -1 to let any pass.
    - `speckle_px`, `speckle_range_px`: connected pixels, whose disparities differ by no more than the range from one to
      the next, are dropped if they are no more than so many; 0 pixels to keep them all.
    """

    interpolation: Literal["linear", "cubic", "lanczos4"] = "linear"
    uniqueness_percent: Percent = 10
    disp12_max_diff_px: Annotated[int, Field(ge=-1)] = 1
    speckle_px: Annotated[int, Field(ge=0)] = 100
    speckle_range_px: Annotated[int, Field(ge=0)] = 32


class StereoBM(Filtered):
    """OpenCV's block matcher: sums of absolute differences over a square, after a pre-filter along the rows.

    - `pre_filter`, `pre_filter_px`, `pre_filter_cap`: a horizontal Sobel derivative, or the grey level against the mean
      over a square of `pre_filter_px`; either clipped at plus or minus the cap.
    - `texture_threshold`: the sum of the absolute pre-filtered values over the block must reach this.
    """

    kind: Literal["opencv-bm"] = "opencv-bm"
    block_px: Annotated[int, Field(ge=5, le=99)] = 9
    pre_filter: Literal["xsobel", "normalized"] = "xsobel"
    pre_filter_px: Annotated[int, Field(ge=5, le=255)] = 9
    pre_filter_cap: Annotated[int, Field(ge=1, le=63)] = 31
    texture_threshold: Annotated[int, Field(ge=0)] = 10
    uniqueness_percent: Percent = 15

    _odd_filter = field_validator("pre_filter_px")(_odd)


class StereoSGBM(Filtered):
    """OpenCV's semi-global block matcher.

    - `p1_per_px`, `p2_per_px`: what a change of the disparity by one pixel, and by more, costs from a pixel to its
      neighbour, as multiples of the block's area: OpenCV's P1 and P2 are 8 and 32 times the area.
    - `mode`: paths of 5 directions in one pass (`sgbm`), of 8 in two (`hh`), of 3 (`3way`) or 4 (`hh4`).
    - `pre_filter_cap`: the horizontal derivative is clipped at plus or minus this, and OpenCV takes no less than 15.
    """

    kind: Literal["opencv-sgbm"] = "opencv-sgbm"
    p1_per_px: Annotated[float, Field(ge=0, le=100)] = 8.0
    p2_per_px: Annotated[float, Field(gt=0, le=200)] = 32.0
    mode: Literal["sgbm", "hh", "3way", "hh4"] = "sgbm"
    pre_filter_cap: Annotated[int, Field(ge=1, le=127)] = 63

    @model_validator(mode="after")
    def _jumps_cost_more(self) -> "StereoSGBM":
        if not self.p1_per_px < self.p2_per_px:
            raise ValueError(f"p1_per_px = {self.p1_per_px:g} must be below p2_per_px = {self.p2_per_px:g}")
        return self


class StereoReconstruct(OpenCV):
    """`cv2.omnidir.stereoReconstruct` as it comes, which has no other settings: see `matchers.reconstruct`."""

    kind: Literal["opencv-reconstruct"] = "opencv-reconstruct"
