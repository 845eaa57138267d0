"""The motion between two views from a file: a pose, a rig's calibration, or a trajectory."""

from collections.abc import Sequence
from itertools import pairwise, starmap
from pathlib import Path
from typing import Literal

import numpy as np

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.io.calibrations import READERS
from harness.io.calibrations.parsing import read_content
from harness.io.calibrations.record import Content
from harness.io.calibrations.rigs import transform_between
from harness.io.trajectories import Trajectory, is_trajectory, read_trajectory
from harness.spec import load, parse

Frame = Literal["sensor", "lens"]
"""The frame whose poses a trajectory has: the sensor's, z up; or the lens's, X along u, Y along v, Z along the axis."""

_UNKNOWN = (
    "holds no pose, no rig and no trajectory; known are view 2's pose as TOML (position_m, yaw_deg, ...), calibration "
    "files with where each camera is, and trajectories in TUM's (8 numbers a line) or KITTI's format (12)"
)

_BESIDE_A_POSE = {"panorama", "R_world_from_view"}
"""What `omnirange render` writes beside the pose of a view in the world."""
_IN_THE_WORLD = (
    "is a view's pose in the world, as omnirange render writes it, and no motion between two views; give the pose of "
    "each view: "
)
_BOTH = "--pose FIRST --pose SECOND"
_ONE_POSE = (
    "holds one pose; more than two images need a trajectory in TUM's (8 numbers a line) or KITTI's format (12), or a "
    "pose for each image (--pose A --pose B --pose C)"
)


def read_motion(
    file: Path,
    lens_from_sensor: tuple[Array, Array],
    views: tuple[int, int] | None = None,
    frame: Frame | None = None,
    both: str = _BOTH,
) -> Motion:
    """Read the motion from view 1 to view 2, told by the content: view 2's pose, a calibrated rig or a trajectory.

    Parameters
    ----------
    lens_from_sensor
        `[3, 3]` of views 1 and 2, see `harness.camera.sensor.lens_from_sensor`: they turn a motion between lenses into
        one between sensors.
    views
        Numbers of the rig's cameras, or of the trajectory's poses, from 0. When None the first two, which of a
        trajectory must be all.
    frame
        Whose poses a trajectory holds, which it does not say itself.
    both
        How the poses of two views are given, for messages.

    Raises
    ------
    InputError
        When the file cannot be read or is of no such kind, has no such view, or a choice is missing or out of place.
    """
    content = read_content(file, "pose")
    if is_trajectory(content):
        return _of_trajectory(read_trajectory(content), lens_from_sensor, views, frame)
    is_pose = _is_pose(content)
    known = next((each for each in READERS.values() if each.recognises(content)), None)
    if not is_pose and known is None:
        raise InputError(_UNKNOWN, file=file)
    if frame is not None:
        raise InputError(
            "is for trajectories; this file says itself which frames it is between", file=file, key="frame"
        )
    if known is not None:
        return motion_of(transform_between(known.read(content), *(views or (0, 1))), lens_from_sensor)
    if views is not None:
        raise InputError("are for rigs and trajectories; this file holds one pose", file=file, key="views")
    if _BESIDE_A_POSE & content.table.keys():
        raise InputError(_IN_THE_WORLD + both, file=file)
    return relative_motion(Pose(), load(Pose, file))


def motions_of_poses(files: Sequence[Path], count: int) -> list[Motion]:
    """The motions between successive ones of so many views, from files of one pose each.

    Parameters
    ----------
    files
        As many as views: the pose of each in one frame, such as the world's, as `omnirange render` writes it. One less:
        the pose of each view but the first in the frame of the one before it, as `omnirange motion` writes it.

    Raises
    ------
    InputError
        When a file holds no such pose, or they are of another number.
    """
    if len(files) not in (count, count - 1):
        problem = f"must be one trajectory or rig, or a pose for each of the {count} images; found {len(files)} files"
        raise InputError(problem, key="--pose")
    poses = [_pose(file, in_the_world=len(files) == count) for file in files]
    if len(files) == count:
        return list(starmap(relative_motion, pairwise(poses)))
    return [relative_motion(Pose(), pose) for pose in poses]


def _pose(file: Path, *, in_the_world: bool) -> Pose:
    content = read_content(file, "pose")
    if not _is_pose(content):
        raise InputError("holds no pose: TOML with position_m, yaw_deg, pitch_deg, roll_deg", file=file)
    if not in_the_world and _BESIDE_A_POSE & content.table.keys():
        raise InputError(_IN_THE_WORLD + _BOTH, file=file)
    return parse(Pose, {key: each for key, each in content.table.items() if key not in _BESIDE_A_POSE}, file=file)


def _is_pose(content: Content) -> bool:
    return content.syntax == "toml" and any(key in content.table for key in Pose.model_fields)


def read_motions(file: Path, lens_from_sensor: Array, frame: Frame | None = None) -> list[Motion]:
    """Read the motions between successive poses of a trajectory.

    Parameters
    ----------
    lens_from_sensor, frame
        As for `read_motion`; one sensor moves.

    Raises
    ------
    InputError
        When the file is no trajectory, or lacks a value that is needed.
    """
    content = read_content(file, "pose")
    if _is_pose(content):
        raise InputError(_ONE_POSE, file=file)
    if not is_trajectory(content):
        raise InputError("is no trajectory in TUM's (8 numbers a line) or KITTI's format (12)", file=file)
    trajectory = read_trajectory(content)
    count = len(trajectory.T_world_from_frame)
    return [_of_trajectory(trajectory, (lens_from_sensor,) * 2, (i, i + 1), frame) for i in range(count - 1)]


def _of_trajectory(
    trajectory: Trajectory, lens_from_sensor: tuple[Array, Array], views: tuple[int, int] | None, frame: Frame | None
) -> Motion:
    file, count = trajectory.file, len(trajectory.T_world_from_frame)
    if views is None and count != 2:
        raise InputError(f"the trajectory has {count} poses; say which two are the views'", file=file, key="views")
    if frame is None:
        problem = "a trajectory does not say which frame it moves: say sensor (z up) or lens (Z along the axis)"
        raise InputError(problem, file=file, key="frame")
    between = trajectory.transform(*(views or (0, 1)))
    return motion_of(between, lens_from_sensor if frame == "lens" else (np.eye(3), np.eye(3)))


def motion_of(T_2_from_1: Array, lens_from_sensor: tuple[Array, Array]) -> Motion:
    """The motion between two sensors from the transform between their lenses.

    With `x_2 = R x_1 + t` between lenses and M_i from sensor i's frame to its lens's, `R_v2_from_v1 = M_2^T R M_1` and
    `t_v1 = -M_1^T R^T t`.

    Parameters
    ----------
    T_2_from_1
        `[4, 4]`.
    lens_from_sensor
        `[3, 3]` each: M_1 and M_2.

    Raises
    ------
    InputError
        When one view's image is a mirror image and the other's is not: no rotation takes one into the other.
    """
    M_1, M_2 = lens_from_sensor
    # Files have few digits: the nearest rotation.
    left, _, right = np.linalg.svd(T_2_from_1[:3, :3])
    R, t = left @ right, T_2_from_1[:3, 3]
    turn = M_2.T @ R @ M_1
    if np.linalg.det(turn) < 0:
        raise InputError(
            "one view's image is mirrored and the other's is not: there is no rotation between their lenses"
        )
    return Motion(R_v2_from_v1=turn, t_v1=-M_1.T @ R.T @ t)
