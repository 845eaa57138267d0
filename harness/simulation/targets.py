"""The exact pixels of the corners of a scene's chessboards, from the boards' poses and the sensor's projection."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.reflection import project_points
from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation.cast import cast
from harness.simulation.scene import Chessboard, Scene
from harness.simulation.scene_geometry import Geometry, geometry_near
from harness.simulation.truth import OCCLUSION_TOLERANCE


@dataclass(frozen=True, repr=False, eq=False)
class SeenBoard(OneLine):
    """The inner corners of one chessboard in one view, `n`; column by column along x first, then row by row."""

    name: str
    points_m: Array
    """`[n, 2]`: in the board's plane, metres; the first corner is (0, 0)."""
    points_world_m: Array
    """`[n, 3]`: in the world, metres."""
    pixels: Array
    """`[n, 2]`: (u, v), pixels; NaN outside the camera model's domain."""
    visible: NDArray[np.bool_]
    """`[n]`: in the field, on the image, and not occluded."""


def visible_boards(scene: Scene, sensor: Sensor, pose: Pose) -> tuple[SeenBoard, ...]:
    """The corners of the chessboards of a scene in a view, in the scene's order.

    Also in a misaligned mirror; whether something occludes a corner is then judged from the mirror's inner
    focus, some millimetres from where its ray leaves the mirror.
    """
    boards = [(i, each) for i, each in enumerate(scene.objects) if isinstance(each, Chessboard)]
    if not boards:
        return ()
    geometry = geometry_near(scene, pose.position_m)
    return tuple(_visible_board(geometry, sensor, pose, scene.scale, board, i) for i, board in boards)


def _visible_board(
    geometry: Geometry, sensor: Sensor, pose: Pose, scale: float, board: Chessboard, index: int
) -> SeenBoard:
    x, y = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    points = (np.stack([x, y], axis=-1).reshape(-1, 2) * board.square_m).astype(np.float64)
    flat = points - points[-1] / 2  # about the middle
    turned = flat @ board.pose.R_world_from_view[:, :2].T
    world = (turned + board.position_m) * scale
    # Relative to the viewpoint, in this order, so that no digits are lost far from the world's origin.
    in_frame = turned * scale + (np.multiply(board.position_m, scale) - pose.position_m)
    pixels, valid = project_points(sensor, in_frame @ pose.R_world_from_view)
    distance = np.linalg.norm(in_frame, axis=-1)
    visible = valid & (distance > 0)
    viewpoint = np.subtract(pose.position_m, geometry.centre)
    hits = cast(geometry, viewpoint, in_frame[visible] / distance[visible, None])
    visible[visible] = hits.range_m >= distance[visible] * (1 - OCCLUSION_TOLERANCE)
    return SeenBoard(board.name or f"object {index}", points * scale, world, pixels, visible)
