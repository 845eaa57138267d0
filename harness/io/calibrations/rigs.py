"""The relative poses of the cameras of a calibrated rig."""

import numpy as np

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.io.calibrations.record import Calibration


def transform_between(calibration: Calibration, first: int, second: int) -> Array:
    """`[4, 4]`: takes points from the frame of one camera's lens to that of another's, metres.

    Parameters
    ----------
    first, second
        Numbers of the cameras, from 0.

    Raises
    ------
    InputError
        When there is no such camera, or the file does not contain the poses of both.
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
            raise InputError(f"does not contain the pose of camera {number}", file=calibration.file)
        transforms.append(T_cam_from_first)
    return np.asarray(transforms[1] @ np.linalg.inv(transforms[0]))
