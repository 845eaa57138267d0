"""Range profiles of two photographs, and maps of several."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from harness.api.ranging import RangeEstimate
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.panorama import directions
from harness.geometry.pose import Motion, Pose
from harness.mapping.map_files import write_map
from harness.mapping.occupancy import OccupancyGrid, Place, frame_around, map_of_profiles
from harness.mapping.range_profile import RangeProfile, range_profile
from harness.mapping.scan_files import write_scan
from harness.mapping.settings import OccupancyMap, Scan
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
        The result of `estimate_range`, in metres.
    height_m
        Height of viewpoint 1 above the floor, metres.
    bearings
        Number of bearings, evenly spaced around the view.
    low_m, high_m
        The band: heights above the floor, metres. What lies lower is floor.
    pitch_deg, roll_deg
        The tilt of view 1 against the vertical, about y, then x, degrees; positive pitch turns x down.
    range_max_m
        Largest distance of obstacles that count, metres.
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


@dataclass(frozen=True, eq=False, repr=False)
class RangeMap(OneLine):
    """An occupancy grid of the surroundings of a path; arrays `[rows, columns]`, row 0 at the lowest y.

    Its frame is that of the first view's scan.
    """

    grid: OccupancyGrid
    places: tuple[Place, ...]
    """The poses at which the scans were taken."""

    @property
    def state(self) -> NDArray[np.uint8]:
        """The state of each cell, a `harness.mapping.occupancy.Cell`: unknown, free or occupied."""
        return self.grid.state

    @property
    def probability(self) -> Array:
        """The probability that a cell is occupied."""
        return self.grid.probability

    @property
    def origin_m(self) -> tuple[float, float]:
        """X and y of the lower left corner of the lower left cell, metres."""
        return self.grid.frame.origin_m

    def write(self, folder: str | Path, name: str = "map") -> None:
        """Write `map.png` and `map.yaml`, as ROS's map_server reads them.

        Parameters
        ----------
        folder
            Created if it does not exist.
        name
            What the files are called.

        Raises
        ------
        InputError
            When the folder cannot be written to.
        """
        write_map(self.state, self.grid.frame, Path(folder), name)


def range_map(
    scans: Sequence[RangeScan],
    places: Sequence[tuple[float, float, float]],
    *,
    cell_m: float = 0.05,
    prior: float = 0.2,
    false_share: float = 0.05,
) -> RangeMap:
    """The occupancy grid that follows from range scans, each weighted by its own standard deviations.

    Parameters
    ----------
    scans
        The results of `range_scan`.
    places
        The pose of each: x and y, metres, and the rotation of its frame against the map's, degrees,
        counter-clockwise.
    cell_m
        Side of a cell, metres.
    prior
        Probability that a cell is occupied before anything was measured.
    false_share
        Share of the scans' distances that are false.

    Returns
    -------
    RangeMap
        `state`, `probability`, `origin_m`; `write(folder)`.

    Raises
    ------
    InputError
        When an argument is invalid, or the map would have too many cells.

    Examples
    --------
    >>> import harness
    >>> left, right = (harness.render("box", position_m=(x, 0, 1), samples=4) for x in (0, 0.5))
    >>> estimate = harness.estimate_range(left.image, right.image, left.sensor, (0.5, 0, 0), matcher="sgm")
    >>> scan = harness.range_scan(estimate, height_m=1.0)
    >>> made = harness.range_map([scan], places=[(0, 0, 0)])
    >>> free = made.state == 1
    >>> round(0.05**2 * int(free.sum()), -1)  # square metres of 36
    30.0
    """
    if not scans or len(scans) != len(places):
        raise InputError(f"must be one for each of 1 scan or more; found {len(places)} for {len(scans)}", key="places")
    settings = parse(OccupancyMap, {"cell_m": cell_m, "prior": prior, "false_share": false_share})
    poses = [parse(Pose, {"position_m": [x, y, 0.0], "yaw_deg": turn}) for x, y, turn in places]
    where = tuple(Place(*pose.position_m[:2], math.radians(pose.yaw_deg)) for pose in poses)
    met = [
        np.vstack([scan.profile.points_m @ _turn(place.yaw).T, np.zeros(2)]) + np.array([place.x_m, place.y_m])
        for scan, place in zip(scans, where, strict=True)
    ]
    points = np.concatenate(met)
    frame = frame_around(points.min(axis=0), points.max(axis=0), settings.cell_m)
    profiles = [(scan.profile, place) for scan, place in zip(scans, where, strict=True)]
    grid = map_of_profiles(profiles, frame, prior=settings.prior, false_share=settings.false_share)
    return RangeMap(grid, where)


def _turn(yaw: float) -> Array:
    return np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])


def level_poses(motions: Sequence[Motion], first: Pose) -> list[tuple[Pose, tuple[float, float, float]]]:
    """Each view's height and tilt, as a pose without its place on the map, and where its scan is taken.

    Parameters
    ----------
    motions
        From each view to the next.
    first
        The first view's height and tilt: the map's frame is that of its scan.
    """
    turn, position = first.R_world_from_view, np.array(first.position_m)
    poses = []
    for motion in (*motions, None):
        yaw, pitch, roll = Rotation.from_matrix(turn).as_euler("ZYX", degrees=True)
        pose = Pose(position_m=(0.0, 0.0, float(position[2])), pitch_deg=float(pitch), roll_deg=float(roll))
        poses.append((pose, (float(position[0]), float(position[1]), float(yaw))))
        if motion is not None:
            position = position + turn @ motion.t_v1
            turn = turn @ motion.R_v2_from_v1.T
    return poses


__all__ = ["RangeMap", "RangeScan", "checked_scan", "level_poses", "range_map", "range_scan"]
