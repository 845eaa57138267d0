"""Range from two images."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.api.loading import load_sensor
from harness.api.motion import MotionEstimate, Status, estimate_motion
from harness.api.photographs import Image, grid_of, photographs_of, side_of, smaller
from harness.api.search_limits import are_given, in_baselines, in_metres
from harness.camera.binning import binned_sensor
from harness.camera.sensor import Sensor
from harness.display import brief, coloured, grey, html_figure
from harness.errors import InputError, Notice
from harness.files import write
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching.interface import MatcherSettings
from harness.pipeline.geometry_check import Verdict
from harness.pipeline.maps import range_limits
from harness.pipeline.photographs import Estimate, Photograph, estimate, write_estimate
from harness.runs.photograph_settings import OwnSettings
from harness.spec import parse


@dataclass(frozen=True, eq=False, repr=False)
class RangeEstimate(Estimate):
    """Range from a pair of images; arrays on view 1's panorama, `[height, width]`. Missing is NaN.

    `range_m` and its predicted standard deviation `sigma_m`, metres, of the parts `sigma_matching_m` and
    `sigma_geometry_m`; `geometry`, whether motion and calibration agree with the images: its `verdict`, `lines()` and
    `table()`; `reason`, why there is no range (0: there is one); `matches` with `alpha_2`; `points_m` and `colours` of
    the point cloud.
    """

    search: str = ""
    """The origin of the search limits, in words, if they were to be estimated from the images."""

    def write(self, folder: str | Path) -> None:
        """Write arrays, point cloud and a page, `range.html`, into a folder.

        Parameters
        ----------
        folder
            Created if it does not exist.

        Raises
        ------
        InputError
            When the folder cannot be written to.
        """
        from harness.report.photographs_page import build_page

        write_estimate(self, Path(folder))
        write(Path(folder) / "range.html", build_page(self))

    def _repr_html_(self) -> str:
        """The first panorama and the range, as one sees them from inside: azimuth descends to the right."""
        low, high = range_limits(self.range_m)
        pictures = {
            "view 1": grey(self.pair.panoramas()[0].values[:, ::-1]),
            f"range, {low:.2g} (dark) to {high:.2g} m": coloured(self.range_m[:, ::-1], low, high),
        }
        return html_figure(pictures, f"{self.valid.mean():.1%} of the panorama has a range")


def estimate_range(
    left: Image,
    right: Image,
    sensor: str | Path | Mapping[str, Any] | Sensor,
    motion: Motion | Pose | MotionEstimate | Sequence[float] | None = None,
    matcher: str | Mapping[str, Any] | MatcherSettings = "slanted",
    *,
    sensor_2: str | Path | Mapping[str, Any] | Sensor | None = None,
    grid: Grid | Literal["auto"] | None = None,
    bits: int | None = None,
    scale: float = 1.0,
    fit_limits: bool = False,
) -> RangeEstimate:
    """Match two omnidirectional images and triangulate. No scene and no ground truth are needed.

    Parameters
    ----------
    left, right
        Images of view 1 and view 2: paths of image files, or arrays of the sensor's size, `[height, width]` or
        `[height, width, 3]`, both of one type: uint8; uint16, whose full scale is 65535; or floats,
        finite grey levels of 0 .. 255.
    sensor
        The sensor of both views: the path of a TOML file, a table, or a sensor.
    motion
        From view 1 to view 2: a `Motion`, view 2's pose in view 1's frame, or the position (x, y, z) of viewpoint 2 in
        view 1's frame, metres, for views that are turned alike; or what `estimate_motion` returned, whose covariance
        then counts in `sigma_m`. When None it is estimated, and ranges are in units of the baseline.
    matcher
        The kind of a matcher, a table with `kind` and its settings, or the settings of a matcher.
    sensor_2
        The sensor of view 2, if it is another one.
    grid
        The grid of the panorama; 720 x 200 pixels when None. "auto": the rows that both sensors see, at nearly their
        resolution, as the command has it; see `harness.camera.fitting_panorama`.
    bits
        White is 2^bits - 1 in files and in arrays of uint16, such as 12 of a camera that stores 12 bits in 16; when
        None the type decides.
    scale
        1, or the inverse of a whole number, such as 0.5: images are made smaller by the mean of squares of pixels
        before they are matched. The motion, if it is estimated, and the panorama come from the images as they are.
    fit_limits
        Whether `d_min_m` and `d_max_m` of the matcher, where they are not given, follow from matched keypoints: 0.6
        times the range of the nearest, 3 times that of the farthest. Needs the extra `motion`; without it, or with
        few keypoints that agree with the motion, they stay as they are. `search` of the result says so.

    Returns
    -------
    RangeEstimate
        `range_m`, `sigma_m`, `reason`, `points_m`, `colours`; `write(folder)`.

    Raises
    ------
    InputError
        One line that names the argument or the file and what would be right.

    Examples
    --------
    >>> import harness
    >>> import numpy as np
    >>> left, right = (harness.render("box", position_m=(x, 0, 1), samples=4) for x in (0, 0.5))
    >>> estimate = harness.estimate_range(left.image, right.image, left.sensor, (0.5, 0, 0), matcher="column")
    >>> error_m = estimate.range_m - left.panorama_range_m
    >>> bool(np.nanmedian(np.abs(error_m)) < 0.2)
    True
    """
    first_sensor = load_sensor(sensor)
    sensors = first_sensor, first_sensor if sensor_2 is None else load_sensor(sensor_2)
    first, second = photographs_of(left, right, sensors, bits)
    settings = _matcher(matcher)
    if motion is None:
        motion = estimate_motion(left, right, *sensors, bits=bits)
    return _estimated((first, second), sensors, motion, settings, grid, scale, fit_limits=fit_limits)


def _estimated(
    photographs: tuple[Photograph, Photograph],
    sensors: tuple[Sensor, Sensor],
    motion: Motion | Pose | MotionEstimate | Sequence[float],
    settings: MatcherSettings,
    grid: Grid | Literal["auto"] | None,
    scale: float,
    *,
    fit_limits: bool,
) -> RangeEstimate:
    """The ranges of checked photographs; see `estimate_range`."""
    first, second = photographs
    error, has_metres, search = None, True, ""
    given = are_given(settings)
    if isinstance(motion, MotionEstimate):
        if motion.status == Status.WEAK:
            reasons = "; ".join(motion.reasons)
            warnings.warn(f"the motion is unreliable, and so are ranges from it: {reasons}", Notice, stacklevel=3)
        known, error, has_metres = motion.motion, motion.error, motion.baseline_m is not None
        if not has_metres:
            settings, search = in_baselines(settings, motion, sensors[0])
    else:
        known = _motion(motion)
    if fit_limits and has_metres:
        estimated = motion if isinstance(motion, MotionEstimate) else None
        settings, search = in_metres(settings, (first.grey, second.grey), sensors, known, estimated)
    side = side_of(scale, sensors)
    grid = grid_of(grid, sensors, known)
    if side > 1:
        first, second = (smaller(each, sensor, side) for each, sensor in zip((first, second), sensors, strict=True))
        sensors = binned_sensor(sensors[0], side), binned_sensor(sensors[1], side)
        grid = Grid(**grid.model_dump())  # no longer "auto": its rows are those of the full-size images
    estimated_range = estimate(
        first,
        second,
        sensors,
        known,
        settings,
        grid,
        error,
        has_metres=has_metres,
        limits_known=given or (has_metres and not fit_limits),
    )
    return RangeEstimate(
        **{each.name: getattr(estimated_range, each.name) for each in fields(estimated_range)}, search=search
    )


def _matcher(matcher: str | Mapping[str, Any] | MatcherSettings) -> MatcherSettings:
    if isinstance(matcher, MatcherSettings):
        return matcher
    table = {"kind": matcher} if isinstance(matcher, str) else dict(matcher)
    return parse(OwnSettings, {"matching": table}, file="matcher").matching


def _motion(motion: Motion | Pose | Sequence[float] | ArrayLike) -> Motion:
    if isinstance(motion, Pose):
        motion = relative_motion(Pose(), motion)
    if not isinstance(motion, Motion):
        motion = Motion(np.eye(3), _vector(motion))
    if not 0 < motion.baseline_m < np.inf:
        raise InputError("the baseline must not be zero: two views from one point determine no range", key="motion")
    return motion


def _vector(given: Any) -> NDArray[np.float64]:
    try:
        vector = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        text = f"must be a Motion, a Pose or three finite numbers, metres; found {brief(given)}"
        raise InputError(text, key="motion")
    return vector


__all__ = ["RangeEstimate", "Verdict", "estimate_range"]
