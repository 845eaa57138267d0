"""Range from two images."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.api.loading import load_sensor
from harness.api.motion import MotionEstimate, Status, estimate_motion
from harness.api.photographs import Image, photographs_of
from harness.camera.sensor import Sensor
from harness.display import brief, coloured, grey, html_figure
from harness.errors import InputError, Notice
from harness.files import write
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching.interface import MatcherSettings
from harness.motion.estimate import scene_points
from harness.pipeline.geometry_check import Verdict
from harness.pipeline.maps import range_limits
from harness.pipeline.photographs import Estimate, estimate, write_estimate
from harness.runs.photograph_settings import OwnSettings
from harness.spec import parse

_FAR_SHARE, _NEAR_SHARE = 0.02, 0.005
"""Shares of the points that the motion was estimated from, the farthest and the nearest, that set no limits."""
_BESIDE = 0.6
"""Nearest range searched, of the nearest point's; the farthest likewise."""
_FARTHEST = 200.0
"""Farthest range that counts, baselines: beyond, the parallax is below a third of a degree."""


@dataclass(frozen=True, eq=False, repr=False)
class RangeEstimate(Estimate):
    """Range from a pair of images; arrays on view 1's panorama, `[height, width]`. Missing is NaN.

    `range_m` and its predicted standard deviation `sigma_m`, metres, of the parts `sigma_matching_m` and
    `sigma_geometry_m`; `geometry`, whether motion and calibration agree with the images: its `verdict`, `lines()` and
    `table()`; `reason`, why there is no range (0: there is one); `matches` with `alpha_2`; `points_m` and `colours` of
    the point cloud.
    """

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
    grid: Grid | None = None,
    bits: int | None = None,
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
        The grid of the panorama; 720 x 200 pixels when None.
    bits
        White is 2^bits - 1 in files and in arrays of uint16, such as 12 of a camera that stores 12 bits in 16; when
        None the type decides.

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
    if isinstance(motion, MotionEstimate):
        if motion.status == Status.WEAK:
            reasons = "; ".join(motion.reasons)
            warnings.warn(f"the motion is unreliable, and so are ranges from it: {reasons}", Notice, stacklevel=2)
        if motion.baseline_m is None and motion.direction_v1 is not None:
            settings = _with_limits(settings, motion, first_sensor)
        estimated = estimate(
            first,
            second,
            sensors,
            motion.motion,
            settings,
            grid,
            motion.error,
            has_metres=motion.baseline_m is not None,
        )
    else:
        estimated = estimate(first, second, sensors, _motion(motion), settings, grid)
    return RangeEstimate(**{each.name: getattr(estimated, each.name) for each in fields(estimated)})


def _with_limits(settings: MatcherSettings, motion: MotionEstimate, sensor: Sensor) -> MatcherSettings:
    """Settings whose limits of the search are those of the scene, in baselines, where they were not given: the defaults
    are metres.
    """
    w = scene_points(motion, sensor)[1]
    farthest, nearest = np.maximum(np.quantile(w, [_FAR_SHARE, 1 - _NEAR_SHARE]), 1 / _FARTHEST)
    limits = {
        "d_min_m": float(_BESIDE / nearest),
        "d_max_m": float(max(1 / (_BESIDE * farthest), 2 * _BESIDE / nearest)),
    }
    given = settings.model_fields_set
    limits = {name: value for name, value in limits.items() if name not in given}
    changed = settings.model_copy(update=limits)
    if not changed.d_min_m < changed.d_max_m:
        raise InputError(
            f"d_min_m = {changed.d_min_m:g} and d_max_m = {changed.d_max_m:g} are in units of the baseline, which is "
            "not known; give both, or its length",
            key="matcher",
        )
    return changed


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
