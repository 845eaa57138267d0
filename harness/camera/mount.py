"""The mount of a camera: the direction in which it looks, whether its image is a mirror image, and its rotation."""

from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.intrinsics import FieldEdge, FieldOfView
from harness.geometry.angles import Array
from harness.spec import Finite, Spec

Looks = Literal["up", "down", "forward"]

_CAMERA_FROM_SENSOR: dict[tuple[str, bool], list[list[float]]] = {
    ("up", False): [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ("up", True): [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
    ("down", False): [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    ("down", True): [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ("forward", False): [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    ("forward", True): [[0, 1, 0], [0, 0, -1], [1, 0, 0]],
}
"""Rows X, Y, Z of the camera's frame (X along u, Y along v, Z along the optical axis) in the untilted sensor's."""


class Mount(Spec):
    """The camera's mount in the sensor's frame (z up): the direction of its optical axis, then a rotation."""

    looks: Looks | None = None
    """Where the optical axis points before the sensor is turned: along z, against it, or along x. By default as the
    camera model does: a hyperboloid mirror looks down, lenses look up."""
    mirrored: bool | None = None
    """Whether the image is a mirror image, reversed from left to right. By default as the camera model's are: those of
    mirrors are, those of lenses are not."""
    yaw_deg: Finite = 0.0
    """Rotation about z, degrees, counter-clockwise seen from above; applied last, as in a pose."""
    pitch_deg: Finite = 0.0
    """Rotation about y, degrees; positive turns x down."""
    roll_deg: Finite = 0.0
    """Rotation about x, degrees; applied first."""

    @property
    def R_sensor_from_untilted(self) -> Array:
        """Rotation matrix `[3, 3]` of yaw, pitch and roll, from the untilted to the sensor's frame."""
        if not (self.yaw_deg or self.pitch_deg or self.roll_deg):
            return np.eye(3)
        angles = [self.yaw_deg, self.pitch_deg, self.roll_deg]
        return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())


def edge_of(field: FieldOfView, looks: Looks) -> FieldEdge:
    """The largest angle off the optical axis in the field of view of a camera that looks up, down or forward."""
    lowest, highest = field.elevation_min_deg, field.elevation_max_deg
    if looks == "up":
        edge = FieldEdge(90 - lowest, "elevation_min_deg", lowest)
    elif looks == "down":
        edge = FieldEdge(90 + highest, "elevation_max_deg", highest)
    else:  # straight behind, or as near to it as elevations allow
        nearest = 0.0 if lowest <= 0 <= highest else min(abs(lowest), abs(highest))
        edge = FieldEdge(180 - nearest, "angle_max_deg", field.angle_max_deg)
    if field.angle_max_deg < edge.angle_deg:
        return FieldEdge(field.angle_max_deg, "angle_max_deg", field.angle_max_deg)
    return edge


def camera_from_sensor(looks: Looks, *, mirrored: bool) -> Array:
    """`[3, 3]`, orthogonal: turns directions of the untilted sensor's frame into the camera's; det -1 if mirrored.

    The camera's frame is the usual one: X along u, Y along v, Z along the optical axis, into the scene. Up: X = x,
    Y = y, Z = z. Down: X = x, Y = -y, Z = -z. Forward: X = -y, Y = -z, Z = x. A mirror image negates Y, or X for a
    camera that looks forward.
    """
    return np.array(_CAMERA_FROM_SENSOR[looks, mirrored], dtype=np.float64)
