"""Corners of boards as a known sensor sees them: what calibrations are tested with."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from harness.calibration.corners import Board, Corners, corners_of
from harness.calibration.poses import BoardPoses
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import Mirror, Unified
from harness.camera.reflection import project_points, ray_directions
from harness.camera.sensor import Sensor, unproject

BOARD = Board(columns=9, rows=6, square_m=0.04)
MIRROR = Sensor(field=FieldOfView(elevation_min_deg=-75, elevation_max_deg=20))
UNIFIED = Sensor(
    model=Unified(xi=1.1),
    camera=Camera(width_px=1280, height_px=960, focal_px=420, aspect=1.002, cx_px=640, cy_px=478),
    lens=Lens(k1=-0.05, k2=0.01, p1=1e-3, p2=-5e-4),
    field=FieldOfView(elevation_min_deg=-10, elevation_max_deg=90),
)
NEARLY_PARABOLIC = Sensor(model=Mirror(b_m=0.012), camera=Camera(focal_px=1900.0))
"""xi = 0.9961."""


def visible_boards(
    sensor: Sensor,
    count: int,
    seed: int,
    *,
    board: Board = BOARD,
    range_m: tuple[float, float] = (0.08, 0.25),
    rim: bool = False,
) -> tuple[Corners, BoardPoses]:
    """Exact corners of boards in random places that are seen whole, at most 60° from being seen face on.

    Parameters
    ----------
    rim
        Keep those alone of which a corner is within 15 px of the end of the field.
    """
    rng = np.random.default_rng(seed)
    camera = sensor.camera
    points = board.points_m
    middle = points.mean(axis=0)
    result, R, t = [], [], []
    while len(result) < count:
        direction, valid = ray_directions(sensor, rng.uniform([0, 0], [camera.width_px, camera.height_px]))
        turn = Rotation.random(random_state=rng).as_matrix()
        if not valid or abs(turn[:, 2] @ direction) < 0.5:
            continue
        origin = direction * rng.uniform(*range_m) - turn[:, :2] @ middle
        pixels, visible = project_points(sensor, points @ turn[:, :2].T + origin)
        if not visible.all():
            continue
        if rim and not _near_rim(sensor, pixels):
            continue
        result.append((f"board {len(result)}", points, pixels))
        R.append(turn)
        t.append(origin)
    return corners_of(result, camera.width_px, camera.height_px), BoardPoses(np.array(R), np.array(t))


def _near_rim(sensor: Sensor, pixels: np.ndarray) -> bool:
    centre = np.array([sensor.camera.cx_px, sensor.camera.cy_px])
    radius = np.linalg.norm(pixels - centre, axis=-1, keepdims=True)
    return not unproject(sensor, pixels + (pixels - centre) / radius * 15)[1].all()


def noisy(corners: Corners, sigma_px: float, seed: int) -> Corners:
    """The same with normal noise on every coordinate."""
    noise = np.random.default_rng(seed).normal(0, sigma_px, corners.pixels.shape)
    return replace(corners, pixels=corners.pixels + noise)
