"""OpenCV's matchers through this program's interface: StereoBM, StereoSGBM and `omnidir.stereoReconstruct`. They need
the extra `peers`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from harness.camera.conversions import mirrored_frame
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_1
from harness.geometry.panorama import directions
from harness.geometry.triangulation import alpha_2_at_range, exact_alpha_2
from harness.matching.interface import Matches
from harness.matching.opencv.omnidir import omnidir_views
from harness.matching.opencv.rectify import (
    Rectangle,
    around_gaps,
    around_of,
    disparities,
    maps_to_view,
    on_panorama,
    rectangle_for,
    rectify,
)
from harness.matching.opencv.settings import OpenCV, StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.pair import Pair
from harness.opencv import opencv, threads

_FIXED_POINT = 16
"""OpenCV's disparities are integers, in sixteenths of a pixel; negative for no match."""


S = TypeVar("S", bound=OpenCV)


def in_opencv(pair: Pair, matcher: S, work: Callable[[Pair, S, Any], Matches]) -> Matches:
    """The matches of one of OpenCV's matchers; none of them gives a confidence, or a reason where there is no match.

    Parameters
    ----------
    work
        `work(pair, matcher, cv2)`.

    Raises
    ------
    InputError
        When OpenCV and its contributed modules are not installed, `opencv-reconstruct` is given a baseline along the
        camera's axis, or OpenCV itself refuses.
    """
    cv2 = opencv(matcher.kind)
    try:
        with threads(cv2, pair.available_threads):
            return work(pair, matcher, cv2)
    except cv2.error as error:
        message = " ".join(str(error).split())
        raise InputError(f"OpenCV rejects these settings: {message}", file=matcher.kind) from error


def block_match(pair: Pair, matcher: StereoBM | StereoSGBM, cv2: Any) -> Matches:
    """StereoBM or StereoSGBM on the rectified pair; its disparities are angles, with sixteenths of a pixel.

    OpenCV searches the same disparities at all angles to the baseline: what it finds nearer than d_min or beyond d_max
    is no match.
    """
    baseline = pair.motion.baseline_m
    step = Rectangle(around_of(pair, matcher.rectified_scale)).step
    number = disparities(matcher, baseline, step)
    # The first columns have no partner for every disparity, and no disparity therefore.
    rectangle = rectangle_for(pair, matcher.rectified_scale, number, matcher.block_px)
    rectified = pair.shared(
        "rectify",
        (rectangle, matcher.interpolation, matcher.block_px),
        lambda: rectify(pair, rectangle, matcher.interpolation, cv2, matcher.block_px),
    )
    raw = _engine(matcher, number, cv2).compute(*rectified.images)
    disparity = np.where(raw >= 0, raw / _FIXED_POINT, np.nan)
    looking = directions(pair.grid)
    a_1 = alpha_1(pair.grid, pair.t_v1)
    a_2 = a_1 + on_panorama(rectified, disparity, looking) * step
    near, far = (alpha_2_at_range(looking, d, pair.t_v1) for d in (matcher.d_min_m, matcher.d_max_m))
    return Matches(np.where((far <= a_2) & (a_2 <= near), a_2, np.nan))


def reconstruct(pair: Pair, matcher: StereoReconstruct, cv2: Any) -> Matches:
    """`cv2.omnidir.stereoReconstruct` unchanged, on all angles to the baseline and all half planes around it.

    Its points are scored as they are. It takes `|t| f/disparity`, the law of perspective cameras, for the range, which
    is off by more the farther a direction is from a right angle to the baseline: `sin alpha_2` is missing, and an angle
    stands for its sine. Triangulating its disparities would hide that. So a pixel gets the alpha_2 of a point in the
    pixel's own direction at the range of the point p that OpenCV puts there, `angle(|p| x̂_1 - t, t)`, from which the
    harness triangulates that very range.

    OpenCV 5.0 leaves out points whose disparity is 15 pixels or less, however far apart pixels are, and has no margin:
    its first columns stay empty. Some earlier releases truncate disparities to whole pixels besides.

    It projects by itself, by the unified model: what it is given of other cameras is in `omnidir`, and is said in the
    matches' `remark`.

    Raises
    ------
    InputError
        When the baseline is along the axis of the first camera, for which `cv2.omnidir.stereoRectify` divides by zero.
    """
    views = omnidir_views(pair, cv2)
    first_frame, second_frame = (view.opencv_from_sensor for view in views)
    rotation = second_frame @ pair.motion.R_v2_from_v1 @ first_frame.T
    t = -rotation @ first_frame @ pair.t_v1  # of p_v2 = R p_v1 + t
    frame, _ = cv2.omnidir.stereoRectify(rotation, t)
    if not np.isfinite(frame).all():
        raise InputError(
            "cv2.omnidir.stereoRectify does not handle a baseline along the camera's axis, such as a vertical one of a "
            "camera that looks up or down; use opencv-sgbm, or another direction",
            file=matcher.kind,
        )
    rectangle = Rectangle(around_of(pair, matcher.rectified_scale))
    _, _, _, cloud = cv2.omnidir.stereoReconstruct(
        *(view.image for view in views),
        *views[0].camera,
        *views[1].camera,
        rotation,
        t,
        cv2.omnidir.RECTIFY_LONGLATI,
        disparities(matcher, pair.motion.baseline_m, rectangle.step),
        matcher.block_px,
        newSize=rectangle.shape[::-1],
        Knew=rectangle.K,
        pointType=cv2.omnidir.XYZ,
    )
    range_m = _ranges(cloud, rectangle)
    frame = mirrored_frame(frame @ first_frame)  # as the rectangle has it, from v1's frame with z turned over
    range_m[_of_gaps(pair, matcher, rectangle, frame, range_m, cv2)] = np.nan
    looking = directions(pair.grid)
    row, column = rectangle.pixels_of(frame, looking)
    range_there = range_m[np.rint(row).astype(int) % rectangle.around, np.clip(np.rint(column).astype(int), 0, None)]
    a_2 = exact_alpha_2(range_there[..., None] * looking, pair.t_v1)
    remarks = dict.fromkeys(view.remark for view in views if view.remark)
    return Matches(a_2, remark="; ".join(remarks))


def _of_gaps(
    pair: Pair, matcher: StereoReconstruct, rectangle: Rectangle, frame: Array, range_m: Array, cv2: Any
) -> NDArray[np.bool_]:
    """Pixels of the rectangle whose point depends on a pixel that is not finite, in either view."""
    rotations = (np.eye(3), pair.motion.R_v2_from_v1)
    gaps = [
        around_gaps(
            image,
            sensor,
            maps_to_view(sensor, rectangle, frame.tobytes(), np.asarray(R, dtype=np.float64).tobytes(), cv2)[:2],
            matcher.block_px,
            cv2,
        )
        for image, sensor, R in zip(pair.images, pair.sensors, rotations, strict=True)
    ]
    # The disparity again, from OpenCV's own law: range = |t| f / disparity, with f = 1/step.
    rows, columns = np.indices(range_m.shape)
    disparity = np.nan_to_num(pair.motion.baseline_m / (rectangle.step * range_m), posinf=0.0)
    range_there = np.clip(np.rint(columns - disparity).astype(int), 0, range_m.shape[1] - 1)
    return gaps[0] | gaps[1][rows, range_there]


def _engine(matcher: StereoBM | StereoSGBM, number: int, cv2: Any) -> Any:
    """OpenCV's object for these settings."""
    if isinstance(matcher, StereoSGBM):
        area = matcher.block_px**2
        engine = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=number,
            blockSize=matcher.block_px,
            P1=round(matcher.p1_per_px * area),
            P2=round(matcher.p2_per_px * area),
            mode=getattr(cv2, f"STEREO_SGBM_MODE_{_MODES[matcher.mode]}"),
        )
    else:
        engine = cv2.StereoBM.create(numDisparities=number, blockSize=matcher.block_px)
        engine.setPreFilterType(getattr(cv2, f"STEREO_BM_PREFILTER_{_PRE_FILTERS[matcher.pre_filter]}"))
        engine.setPreFilterSize(matcher.pre_filter_px)
        engine.setTextureThreshold(matcher.texture_threshold)
    engine.setPreFilterCap(matcher.pre_filter_cap)
    engine.setUniquenessRatio(matcher.uniqueness_percent)
    engine.setDisp12MaxDiff(matcher.disp12_max_diff_px)
    engine.setSpeckleWindowSize(matcher.speckle_px)
    engine.setSpeckleRange(matcher.speckle_range_px)
    return engine


_MODES = {"sgbm": "SGBM", "hh": "HH", "3way": "SGBM_3WAY", "hh4": "HH4"}
_PRE_FILTERS = {"xsobel": "XSOBEL", "normalized": "NORMALIZED_RESPONSE"}


def _ranges(cloud: Any, rectangle: Rectangle) -> Array:
    """Ranges `[rows, columns]` of OpenCV's points, which are a list: each is assigned to a pixel by its direction."""
    range_m = np.full(rectangle.shape, np.nan)
    points = np.zeros((0, 3)) if cloud is None else np.asarray(cloud, dtype=np.float64).reshape(-1, 3)
    # The points are in the rectified frame: no rotation, and `pixels_of` expects our frame.
    row, column = rectangle.pixels_of(np.eye(3), mirrored_frame(points))
    rows, columns = np.rint(row).astype(int), np.rint(column).astype(int)
    range_m[rows, columns] = np.linalg.norm(points, axis=-1)
    return range_m
