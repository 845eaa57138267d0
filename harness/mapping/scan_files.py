"""Files of range profiles for other programs: CSV, ROS's `sensor_msgs/LaserScan` as JSON, PCD and PLY.

All are in the profile's frame: x forward, y left, z up, origin at the viewpoint, bearings counter-clockwise from x, as
REP 103 has it. Points lie in the plane z = 0 of that frame.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from harness.errors import InputError
from harness.files import OwnFiles, check_no_others, make_folder, write
from harness.geometry.angles import Array
from harness.mapping.range_profile import RangeProfile, bearings
from harness.mapping.settings import MOST_BEARINGS

WRITTEN = {
    "scan.csv": "bearing, distance and standard deviation",
    "scan.json": "the fields of sensor_msgs/LaserScan",
    "scan.pcd": "points for PCL, with sigma",
    "scan.ply": "the same as PLY",
}
"""The files of `write_scan`."""
OF_A_SCAN = OwnFiles(
    "scan",
    dict.fromkeys(WRITTEN)
    | {
        "scan.csv": b"bearing_deg,range_m,sigma_m\n",
        # Both times are zero in ours, and in no message of a robot.
        "scan.json": b'{\n "header": {\n  "stamp": {\n   "sec": 0,\n   "nanosec": 0\n  },\n  "frame_id": ',
    },
)
"""The same, as those of a folder."""
RANGE_MIN_M = 0.01
"""Least distance that a scan file has: nearer is the robot itself."""


def write_scan(profile: RangeProfile, folder: Path, range_max_m: float, frame_id: str = "view_1") -> None:
    """Write the files of `WRITTEN`.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    check_no_others(folder, OF_A_SCAN)
    make_folder(folder)
    contents: dict[str, str | bytes] = {
        "scan.json": json.dumps(laser_scan(profile, range_max_m, frame_id), indent=1, allow_nan=False) + "\n",
        "scan.csv": as_csv(profile),
        "scan.pcd": as_pcd(profile),
        "scan.ply": as_ply(profile),
    }
    for name, content in contents.items():
        write(folder / name, content)


def as_csv(profile: RangeProfile) -> str:
    """CSV text, one line for each bearing: degrees, range and sigma in metres; an empty field for a missing number."""
    lines = ["bearing_deg,range_m,sigma_m"]
    for bearing, distance, sigma in zip(np.degrees(profile.bearing), profile.range_m, profile.sigma_m, strict=True):
        lines.append(f"{bearing:.6g},{_text(distance)},{_text(sigma)}")
    return "\n".join(lines) + "\n"


def laser_scan(profile: RangeProfile, range_max_m: float, frame_id: str = "view_1") -> dict[str, Any]:
    """A profile as the fields of `sensor_msgs/LaserScan`, in types that JSON has.

    A bearing without an answer is None, which JSON has instead of the NaN of REP 117: nothing was measured. All is
    measured at once, so that both times are zero; so is the stamp.
    """
    known = profile.known & (profile.range_m >= RANGE_MIN_M) & (profile.range_m <= range_max_m)
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame_id},
        "angle_min": float(profile.bearing[0]),
        "angle_max": float(profile.bearing[-1]),
        "angle_increment": profile.increment,
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": RANGE_MIN_M,
        "range_max": range_max_m,
        "ranges": [float(each) if is_known else None for each, is_known in zip(profile.range_m, known, strict=True)],
        "intensities": [],
    }


def from_laser_scan(table: Mapping[str, Any], file: str | Path = "scan") -> RangeProfile:
    """The profile of a table of `sensor_msgs/LaserScan`'s fields that goes all around the view; sigma is not known.

    Raises
    ------
    InputError
        When a field is missing or wrong, or the scan does not go around once from -pi on.
    """
    try:
        range_m = np.array([math.nan if each is None else each for each in table["ranges"]], dtype=np.float64)
        low, high = float(table["range_min"]), float(table["range_max"])
        begin, step = float(table["angle_min"]), float(table["angle_increment"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"is no LaserScan: {error}", file=file) from error
    if not 1 <= range_m.size <= MOST_BEARINGS:
        raise InputError(f"must be 1 to {MOST_BEARINGS} ranges; found {range_m.size}", file=file, key="ranges")
    middle = bearings(range_m.size)
    # Single precision, in which ROS keeps them, is 2.4e-7 at pi.
    if abs(begin - middle[0]) > 1e-6 or abs(step * range_m.size - 2 * np.pi) > 1e-6 * range_m.size:
        raise InputError(
            f"must begin at {middle[0]:.6g} and go round once in {range_m.size} steps", file=file, key="angle_min"
        )
    known = np.isfinite(range_m) & (range_m >= low) & (range_m <= high)
    return RangeProfile(middle, np.where(known, range_m, np.nan), np.full(range_m.size, np.nan))


def as_pcd(profile: RangeProfile) -> str:
    """PCD text, version 0.7, ASCII: x, y, z and sigma of each point, metres; nan where sigma is not known."""
    points = _points(profile)
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z sigma",
        "SIZE 4 4 4 4",
        "TYPE F F F F",
        "COUNT 1 1 1 1",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA ascii",
    ]
    return "\n".join([*head, *(" ".join(f"{value:.7g}" for value in point) for point in points)]) + "\n"


def as_ply(profile: RangeProfile) -> bytes:
    """PLY text: points with the property `sigma`, metres."""
    points = _points(profile)
    cloud = trimesh.Trimesh(
        vertices=points[:, :3],
        faces=np.empty((0, 3), dtype=np.int64),
        vertex_attributes={"sigma": points[:, 3].astype(np.float32)},
        process=False,
    )
    exported = cloud.export(file_type="ply")
    assert isinstance(exported, bytes)
    return exported


def _points(profile: RangeProfile) -> Array:
    """`[known, 4]`: x, y, z and sigma."""
    level = profile.points_m
    return np.column_stack([level, np.zeros(len(level)), profile.sigma_m[profile.known]])


def _text(value: float) -> str:
    return f"{value:.6g}" if np.isfinite(value) else ""
