"""Range profiles of two photographs."""

from dataclasses import dataclass
from pathlib import Path

from harness.api.ranging import RangeEstimate
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.panorama import directions
from harness.geometry.pose import Pose
from harness.mapping.range_profile import RangeProfile, range_profile
from harness.mapping.scan_files import write_scan
from harness.mapping.settings import Scan
from harness.spec import parse


@dataclass(frozen=True, eq=False, repr=False)
class RangeScan(OneLine):
    """The nearest obstacle for each bearing around view 1; arrays `[bearings]`.

    Its frame has the origin at viewpoint 1, z up in the world, and x where view 1's x axis points, projected on the
    horizontal plane. Bearings turn from x to y.
    """

    profile: RangeProfile
    settings: Scan

    @property
    def bearing(self) -> Array:
        """Middle of each bearing, radians, from -pi on."""
        return self.profile.bearing

    @property
    def range_m(self) -> Array:
        """Horizontal distance, metres; NaN where nothing is known."""
        return self.profile.range_m

    @property
    def sigma_m(self) -> Array:
        """Predicted standard deviation of that, metres."""
        return self.profile.sigma_m

    def write(self, folder: str | Path) -> None:
        """Write `scan.csv`, `scan.json` (the fields of ROS's `sensor_msgs/LaserScan`), `scan.pcd` and `scan.ply`.

        Parameters
        ----------
        folder
            Created if it does not exist.

        Raises
        ------
        InputError
            When the folder cannot be written to.
        """
        write_scan(self.profile, Path(folder), self.settings.range_max_m)


def range_scan(
    estimate: RangeEstimate,
    height_m: float,
    *,
    bearings: int = 360,
    low_m: float = 0.1,
    high_m: float = 1.8,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    range_max_m: float = 30.0,
    support_px: int = 8,
) -> RangeScan:
    """The range profile of two photographs: for each bearing the nearest obstacle in a band of heights.

    Parameters
    ----------
    estimate
        What `estimate_range` returned, in metres.
    height_m
        Height of viewpoint 1 above the floor, metres.
    bearings
        How many, evenly spaced around the view.
    low_m, high_m
        The band: heights above the floor, metres. What lies lower is floor.
    pitch_deg, roll_deg
        How view 1 is tilted against the vertical, about y, then x; positive pitch turns x down.
    range_max_m
        What is farther away is not looked at, metres.
    support_px
        Pixels of the panorama that have to agree on an obstacle.

    Returns
    -------
    RangeScan
        `bearing`, `range_m`, `sigma_m`; `write(folder)`.

    Raises
    ------
    InputError
        When an argument is invalid, or the estimate has no metres.

    Examples
    --------
    >>> import harness
    >>> left, right = (harness.render("box", position_m=(x, 0, 1), samples=4) for x in (0, 0.5))
    >>> estimate = harness.estimate_range(left.image, right.image, left.sensor, (0.5, 0, 0), matcher="sgm")
    >>> scan = harness.range_scan(estimate, height_m=1.0, bearings=4)  # of a box of 6 m
    >>> [float(each.round(0)) for each in scan.range_m]
    [4.0, 4.0, 4.0, 4.0]
    """
    settings = checked_scan(
        estimate_has_metres=estimate.has_metres,
        bearings=bearings,
        low_m=low_m,
        high_m=high_m,
        range_max_m=range_max_m,
        support_px=support_px,
    )
    pose = parse(Pose, {"position_m": [0, 0, height_m], "pitch_deg": pitch_deg, "roll_deg": roll_deg})
    rays = directions(estimate.pair.grid)
    profile = range_profile(
        rays, estimate.range_m, estimate.sigma_m, pose.R_world_from_view, pose.position_m[2], settings
    )
    return RangeScan(profile, settings)


def checked_scan(*, estimate_has_metres: bool = True, **settings: float) -> Scan:
    """The settings of a profile.

    Raises
    ------
    InputError
        When one is out of range, there are no bearings, or there are no metres to measure heights in.
    """
    scan = parse(Scan, settings)
    if not scan.bearings:
        raise InputError("must be at least 1; found 0", key="bearings")
    if not estimate_has_metres:
        raise InputError("a band of heights needs metres; give the motion, or the baseline's length", key="estimate")
    return scan


__all__ = ["RangeScan", "checked_scan", "range_scan"]
