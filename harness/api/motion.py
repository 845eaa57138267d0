"""Motion from two images."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from harness.api.loading import load_sensor
from harness.api.photographs import Image, photographs_of
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.files import write
from harness.geometry.angles import Array
from harness.geometry.motion_error import MotionError
from harness.geometry.pose import Motion, Pose
from harness.io.view_folder import pose_in
from harness.motion.calibration_error import REPORTED_PX, moved_by
from harness.motion.estimate import EstimatedMotion, estimate, scene_points
from harness.motion.floor import Floor, find_floor
from harness.motion.sparse import Freedom
from harness.motion.verdict import Status
from harness.spec import dump_toml


@dataclass(frozen=True, eq=False, repr=False)
class MotionEstimate(EstimatedMotion):
    """The motion from view 1 to view 2, its covariance and a verdict.

    `status` ("ok", "weak", "no parallax", "failed") with `reasons` in words; `R_v2_from_v1` and the unit
    `direction_v1` of t, with `covariance`; `motion` for `estimate_range`.
    """

    baseline_m: float | None
    """|t| in metres, as given or from the camera's height; None if unknown, as it does not follow from two images."""
    floor: Floor | None
    """The floor, if the camera's height above it was given."""
    calibration_px: float
    """The standard deviation of the calibration, pixels, as given."""

    def __repr__(self) -> str:
        words = [f"'{self.status}'"]
        if self.R_v2_from_v1 is not None:
            angles = self.angles_deg
            words.append(f"yaw {angles['yaw']:.3f}, pitch {angles['pitch']:.3f}, roll {angles['roll']:.3f} deg")
        if self.direction_v1 is not None:
            words.append(f"t at azimuth {angles['azimuth']:.2f}, elevation {angles['elevation']:.2f} deg")
        return f"MotionEstimate({'; '.join(words)})"

    @property
    def angles_deg(self) -> dict[str, float]:
        """`yaw`, `pitch` and `roll` of view 2 in view 1's frame; `azimuth` and `elevation` of viewpoint 2 seen from
        viewpoint 1; degrees. Unknown ones are left out.
        """
        if self.R_v2_from_v1 is None:
            return {}
        direction = np.array([1.0, 0.0, 0.0]) if self.direction_v1 is None else self.direction_v1
        pose = pose_in(Motion(self.R_v2_from_v1, direction))
        angles = {"yaw": pose.yaw_deg, "pitch": pose.pitch_deg, "roll": pose.roll_deg}
        if self.direction_v1 is not None:
            x, y, z = self.direction_v1.tolist()
            angles |= {
                "azimuth": math.degrees(math.atan2(y, x)),
                "elevation": math.degrees(math.atan2(z, math.hypot(x, y))),
            }
        return angles

    @property
    def sigmas_deg(self) -> dict[str, float]:
        """Standard deviations of the angles by which `rotation` and `direction` are off, degrees; see `covariance`."""
        if self.covariance is None:
            return {}
        return {
            name: math.degrees(math.sqrt(np.trace(self.covariance[part, part])))
            for name, part in (("rotation", slice(0, 3)), ("direction", slice(3, 6)))
        }

    @property
    def motion(self) -> Motion:
        """The motion as an argument of `estimate_range`; |t| is the given baseline, or 1.

        Raises
        ------
        InputError
            When the images do not determine the motion.
        """
        if self.R_v2_from_v1 is None or self.direction_v1 is None:
            raise InputError(self._nothing())
        return Motion(self.R_v2_from_v1, (self.baseline_m or 1.0) * self.direction_v1)

    @property
    def pose(self) -> Pose:
        """View 2's pose in view 1's frame; raises as `motion`."""
        return pose_in(self.motion)

    @property
    def error(self) -> MotionError:
        """The uncertainty of `motion`, for the ranges' standard deviation; raises the same errors as `motion`."""
        if self.covariance is None:
            raise InputError(self._nothing())
        if self.floor is None:
            return MotionError(self.covariance, np.zeros(6))
        return self.floor.error(self.covariance)

    @property
    def baseline_sigma_m(self) -> float | None:
        """Standard deviation of |t|, metres, where it follows from the camera's height; None elsewhere."""
        if self.floor is None or self.baseline_m is None or self.covariance is None:
            return None
        variance = self.floor.by_motion @ self.covariance @ self.floor.by_motion + self.floor.share**2
        return float(self.baseline_m * np.sqrt(variance))

    def _nothing(self) -> str:
        return f"no motion was estimated: {self.status}; {'; '.join(self.reasons)}"

    def summary(self) -> dict[str, Any]:
        """All results except those of single pairs, as plain values, as written by `--json`."""
        known = self.R_v2_from_v1 is not None
        return {
            "status": str(self.status),
            "reasons": list(self.reasons),
            "angles_deg": self.angles_deg,
            "sigmas_deg": {name: _finite(each) for name, each in self.sigmas_deg.items()},
            "R_v2_from_v1": self.R_v2_from_v1.tolist() if self.R_v2_from_v1 is not None else None,
            "direction_v1": self.direction_v1.tolist() if self.direction_v1 is not None else None,
            "baseline_m": self.baseline_m,
            "baseline_sigma_m": self.baseline_sigma_m,
            "calibration_px": self.calibration_px,
            "misfit_px": self.direct.misfit_px if self.direct is not None else None,
            "calibration_effects": None if self.calibration_effects is None else self.calibration_effects.tolist(),
            "covariance": None if self.covariance is None else [[_finite(x) for x in row] for row in self.covariance],
            "pairs": len(self.pairs),
            "pairs_agreeing": int(self.sparse.inlier.sum()) if self.sparse is not None else 0,
            "residual_px": self.sparse.scale_px if self.sparse is not None else None,
            "tiles": len(self.direct.tiles) if self.direct is not None else 0,
            "noise_grey": self.direct.noise_grey if self.direct is not None else None,
            "rotation_alone_px": self.rotation_px if known else None,
            "iterations": self.iterations,
        }

    def lines(self) -> list[str]:
        """The motion as lines of text, as printed by the command."""
        angles, sigmas, parts = self.angles_deg, self.sigmas_deg, []
        if angles:
            sigma = f"; sigma {sigmas['rotation']:.2g}" if sigmas else ""
            parts.append(
                f"rotation   yaw {angles['yaw']:.3f}, pitch {angles['pitch']:.3f}, roll {angles['roll']:.3f} degrees"
                f"{sigma}"
            )
        if "azimuth" in angles:
            parts.append(
                f"direction  azimuth {angles['azimuth']:.2f}, elevation {angles['elevation']:.2f} degrees; "
                f"sigma {sigmas['direction']:.2g}"
            )
            parts.append(
                "baseline   unknown, taken as 1: ranges will be in units of it"
                if self.baseline_m is None
                else f"baseline   {self.baseline_m:g} m, as given"
                if self.floor is None
                else f"baseline   {self.baseline_m:.4g} m, sigma {self.baseline_sigma_m:.2g}, by the floor that "
                f"{self.floor.points} points lie on"
            )
        agreeing = "" if self.sparse is None else f", {self.sparse.inlier.sum()} agree"
        residual = "" if self.sparse is None else f" to {self.sparse.scale_px:.2g} px"
        parts.append(f"pairs      {len(self.pairs)} keypoints match{agreeing}{residual}")
        if self.direct is not None:
            parts.append(f"direct     {len(self.direct.tiles)} tiles match to {self.direct.noise_grey:.2g} grey levels")
        parts.append(f"status     {self.status}")
        parts += [f"           {reason}" for reason in self.reasons]
        if self.calibration_effects is not None:
            rotation, direction = (math.degrees(each) for each in moved_by(self.calibration_effects))
            exact = "assume an exact calibration"
            misfit = 0.0 if self.direct is None else self.direct.misfit_px
            counted = f"include a calibration error of {self.calibration_px:g} px" if self.calibration_px else exact
            if misfit > self.calibration_px:
                counted = f"include a calibration error of {misfit:.2g} px, by which tiles miss their epipolar curves"
            parts.append(
                f"Sigmas {counted}. An error of {REPORTED_PX:g} px would shift the rotation by {rotation:.2g}, the "
                f"direction by {direction:.2g} degrees, with hardly any residual."
            )
        return parts

    def write(self, path: str | Path) -> None:
        """Write the pose of view 2 in view 1's frame as TOML, which `omnirange range --pose` reads.

        Raises
        ------
        InputError
            When there is no motion, or the file cannot be written.
        """
        comments = [*self.lines()]
        if self.baseline_m is None:
            comments.append("position_m has length 1, which is not metres.")
        text = "".join(f"# {line}\n" for line in comments)
        write(Path(path), f"{text}\n{dump_toml(self.pose)}")

    def write_json(self, path: str | Path) -> None:
        """Write `summary()` as JSON.

        Raises
        ------
        InputError
            When the file cannot be written.
        """
        write(Path(path), json.dumps(self.summary(), indent=2, allow_nan=False) + "\n")


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def estimate_motion(
    left: Image,
    right: Image,
    sensor: str | Path | Mapping[str, Any] | Sensor,
    sensor_2: str | Path | Mapping[str, Any] | Sensor | None = None,
    *,
    freedom: Freedom = "free",
    baseline_m: float | None = None,
    camera_height_m: float | None = None,
    direct: bool = True,
    calibration_px: float = 0.0,
    bits: int | None = None,
    seed: int = 0,
) -> MotionEstimate:
    """Estimate the rotation between two views and the direction from view 1 to view 2, from their images alone.

    Needs the extra: `pip install 'omnirange[motion]'`.

    Parameters
    ----------
    left, right
        Images of view 1 and view 2: paths, or arrays as in `estimate_range`.
    sensor
        The sensor of both views: the path of a TOML file, a table, or a sensor.
    sensor_2
        The sensor of view 2, if it is another one.
    freedom
        `free`; `upright`, where the sensor's z is vertical in both views; `planar`, where it also moves horizontally.
    baseline_m
        Distance of the viewpoints, metres, which images do not determine; taken as 1 when None.
    camera_height_m
        Height of view 1's viewpoint above the floor, metres, along the floor's normal; the distance of the viewpoints
        follows from it. The floor is looked for below the sensor's horizon, within 20 degrees of level.
    direct
        After the keypoints, fit the motion to the grey levels: several times more accurate, and two seconds slower.
    calibration_px
        Standard deviation of the calibration (centre along u and v, focal length, radial lens term) in pixels of the
        image, which `covariance` includes; 0 for an exact calibration.
    bits
        White is 2^bits - 1; see `estimate_range`.
    seed
        Seed of the random samples; results are reproducible to the bit.

    Returns
    -------
    MotionEstimate
        `status` and `reasons`, `R_v2_from_v1`, `direction_v1`, `covariance`, `motion`, `pose`; `write(path)`.

    Raises
    ------
    InputError
        One line that names the argument or the file and what would be right.

    Examples
    --------
    >>> import harness
    >>> left, right = (harness.render("box", position_m=(x, 0, 1), yaw_deg=40 * x, samples=4) for x in (0, 0.5))
    >>> estimate = harness.estimate_motion(left.image, right.image, left.sensor, baseline_m=0.5)
    >>> estimate.status, round(estimate.angles_deg["yaw"], 1), round(estimate.angles_deg["azimuth"], 1) + 0
    (<Status.OK: 'ok'>, 20.0, 0.0)
    """
    _check(freedom, calibration_px, baseline_m, camera_height_m)
    first_sensor = load_sensor(sensor)
    sensors = first_sensor, first_sensor if sensor_2 is None else load_sensor(sensor_2)
    first, second = photographs_of(left, right, sensors, bits)
    estimated = estimate(
        (first.grey, second.grey), sensors, freedom=freedom, direct=direct, calibration_px=calibration_px, seed=seed
    )
    values = {each.name: getattr(estimated, each.name) for each in fields(estimated)}
    baseline = None if baseline_m is None else float(baseline_m)
    floor = None
    if camera_height_m is not None and estimated.direction_v1 is not None:
        floor = _floor(estimated, estimated.direction_v1, first_sensor, seed)
        baseline = floor.length(camera_height_m)
    return MotionEstimate(**values, baseline_m=baseline, floor=floor, calibration_px=float(calibration_px))


def _floor(estimated: EstimatedMotion, direction_v1: Array, sensor: Sensor, seed: int) -> Floor:
    floor = find_floor(*scene_points(estimated, sensor), direction_v1, seed)
    if floor is None:
        raise InputError(
            "no floor was detected: no horizontal plane below view 1 has enough points that both views see; "
            "give the distance of the viewpoints",
            key="camera_height_m",
        )
    return floor


def _check(freedom: str, calibration_px: float, baseline_m: float | None, camera_height_m: float | None) -> None:
    if freedom not in ("free", "upright", "planar"):
        raise InputError(f"must be 'free', 'upright' or 'planar'; found {freedom!r}", key="freedom")
    if not 0 <= calibration_px < math.inf:
        raise InputError(f"must be 0 or more pixels; found {calibration_px:g}", key="calibration_px")
    if baseline_m is not None and not 0 < baseline_m < math.inf:
        raise InputError(f"must be a length above 0, metres; found {baseline_m:g}", key="baseline_m")
    if camera_height_m is not None and not 0 < camera_height_m < math.inf:
        raise InputError(f"must be a length above 0, metres; found {camera_height_m:g}", key="camera_height_m")
    if camera_height_m is not None and baseline_m is not None:
        raise InputError("the distance of the viewpoints is given; leave one of them out", key="camera_height_m")


__all__ = ["MotionEstimate", "Status", "estimate_motion"]
