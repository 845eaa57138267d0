"""Poses and motions against matrices written out, and the paper's geometry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.geometry.pose import Pose, relative_motion, translated

degrees = st.floats(-360, 360)
metres = st.floats(-10, 10)
poses = st.builds(
    Pose, position_m=st.tuples(metres, metres, metres), yaw_deg=degrees, pitch_deg=degrees, roll_deg=degrees
)
# A rotation matrix from a quaternion carries a few roundings; positions are at most 10 m.
ROUNDING = 1e-13


def matrices(pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    yaw, pitch, roll = np.radians([pose.yaw_deg, pose.pitch_deg, pose.roll_deg])
    c, s = np.cos, np.sin
    about_z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    about_y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    about_x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    return about_z, about_y, about_x


@given(poses)
def test_rotation_is_yaw_then_pitch_then_roll(pose: Pose) -> None:
    about_z, about_y, about_x = matrices(pose)
    np.testing.assert_allclose(pose.R_world_from_view, about_z @ about_y @ about_x, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("turn", "before", "after"),
    [
        ({"yaw_deg": 90}, [1, 0, 0], [0, 1, 0]),  # to the left, seen from above
        ({"pitch_deg": 90}, [1, 0, 0], [0, 0, -1]),  # nose down
        ({"roll_deg": 90}, [0, 1, 0], [0, 0, 1]),  # left side up
        ({}, [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
    ],
)
def test_sense_of_each_turn(turn: dict, before: list, after: list) -> None:
    np.testing.assert_allclose(Pose(**turn).R_world_from_view @ before, after, rtol=0, atol=1e-15)


@given(poses, poses, st.tuples(metres, metres, metres))
def test_motion_takes_points_from_view_1_to_view_2(view_1: Pose, view_2: Pose, p_world: tuple) -> None:
    p_v1, p_v2 = (v.R_world_from_view.T @ np.subtract(p_world, v.position_m) for v in (view_1, view_2))
    motion = relative_motion(view_1, view_2)
    np.testing.assert_allclose(motion.apply(p_v1), p_v2, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(motion.R_v2_from_v1 @ (p_v1 - motion.t_v1), p_v2, rtol=0, atol=ROUNDING)
    # t is viewpoint 2 seen from viewpoint 1, so it lands on the origin of view 2, and the inverse motion undoes it all.
    np.testing.assert_allclose(motion.apply(motion.t_v1), 0, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(relative_motion(view_2, view_1).apply(p_v2), p_v1, rtol=0, atol=ROUNDING)


@given(poses, poses)
def test_baseline_is_the_distance_of_the_viewpoints(view_1: Pose, view_2: Pose) -> None:
    distance = np.linalg.norm(np.subtract(view_2.position_m, view_1.position_m))
    assert relative_motion(view_1, view_2).baseline_m == pytest.approx(distance, abs=ROUNDING)


@given(poses, st.tuples(metres, metres, metres))
def test_views_turned_alike_have_no_rotation_between_them(view_1: Pose, position_m: tuple) -> None:
    motion = relative_motion(view_1, view_1.model_copy(update={"position_m": position_m}))
    np.testing.assert_array_equal(motion.R_v2_from_v1, np.eye(3))


def test_motion_applies_to_arrays_of_any_shape() -> None:
    motion = relative_motion(Pose(yaw_deg=20), Pose(position_m=(0.5, 0, 0.1), roll_deg=-5))
    points = np.random.default_rng(0).normal(size=(2, 3, 4, 3))
    each = np.array([motion.apply(p) for p in points.reshape(-1, 3)]).reshape(points.shape)
    np.testing.assert_allclose(motion.apply(points), each, rtol=0, atol=1e-15)


def test_world_sense_of_a_translation() -> None:
    """A turned robot that moves along the world's x: the offset is the world's, t_v1 the view's."""
    view_1 = Pose(position_m=(1, 2, 3), yaw_deg=90)
    view_2 = translated(view_1, (0.5, 0, 0))
    assert view_2 == Pose(position_m=(1.5, 2, 3), yaw_deg=90)
    np.testing.assert_allclose(relative_motion(view_1, view_2).t_v1, [0, -0.5, 0], rtol=0, atol=1e-15)
