"""The motion between two cameras of a calibration file."""

import numpy as np

from harness.camera.mount import Looks, camera_from_sensor
from harness.errors import InputError
from harness.geometry.pose import Motion
from harness.io.calibrations import Calibration


def motion_between(calibration: Calibration, first: int, second: int, looks: Looks, *, mirrored: bool) -> Motion:
    """The motion from one camera to another, between the sensors' frames.

    With `x_2 = R x_1 + t` between the lenses' frames and M from a sensor's frame to its lens's,
    `R_v2_from_v1 = M^T R M` and `t_v1 = -M^T R^T t`.

    Parameters
    ----------
    first, second
        Numbers of the cameras, from 0.
    looks, mirrored
        How both are mounted.

    Raises
    ------
    InputError
        When the file does not tell where both cameras are.
    """
    cameras = calibration.cameras
    for number in (first, second):
        if not 0 <= number < len(cameras):
            there = f"0 to {len(cameras) - 1}" if len(cameras) > 1 else "0 alone"
            raise InputError(f"there is no camera {number}; the file has {there}", file=calibration.file)
    transforms = []
    for number in (first, second):
        T_cam_from_first = cameras[number].T_cam_from_first if number else np.eye(4)
        if T_cam_from_first is None:
            raise InputError(f"does not tell where camera {number} is", file=calibration.file)
        transforms.append(T_cam_from_first)
    between = transforms[1] @ np.linalg.inv(transforms[0])
    # Files have few digits: the nearest rotation.
    left, _, right = np.linalg.svd(between[:3, :3])
    R, t = left @ right, between[:3, 3]
    M = camera_from_sensor(looks, mirrored=mirrored)
    return Motion(R_v2_from_v1=M.T @ R @ M, t_v1=-M.T @ R.T @ t)
