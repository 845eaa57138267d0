"""Ground truth against closed forms and against an independent ray-triangle test."""

import numpy as np
import pytest

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, pixel_directions, project
from harness.geometry.pose import Pose
from harness.simulation.cast import cast
from harness.simulation.scene import Box, Plane, Scene, load_scene
from harness.simulation.scene_geometry import geometry_of
from harness.simulation.texture import GreyTexture
from harness.simulation.truth import discontinuities, on_sensor, ranges, truth

GREY = GreyTexture(kind="grey", value=100)
FIRST, SECOND = Pose(position_m=(0, 0, 1)), Pose(position_m=(0.5, 0, 1))
BOUNDS = {
    "box": np.array([[-3.0, -3, 0], [3, 3, 6]]),
    "corridor": np.array([[-3.0, -1.5, 0], [24, 1.5, 3]]),
}


def panorama_directions(width=720, height=200, z_top=0.34):
    phi = -np.pi + (np.arange(width) + 0.5) * 2 * np.pi / width
    z = z_top - (np.arange(height) + 0.5) * 2 * np.pi / width
    phi, z = np.meshgrid(phi, z)
    d = np.stack([np.cos(phi), np.sin(phi), z], axis=-1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def slab_range(bounds, origin, directions):
    """Distance to the inside of an axis-aligned box (Kay and Kajiya's slabs)."""
    with np.errstate(divide="ignore"):
        planes = np.where(directions > 0, bounds[1] - origin, bounds[0] - origin) / directions
    return np.where(directions == 0, np.inf, planes).min(axis=-1)


def random_directions(rng, count):
    d = rng.standard_normal((count, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", ["box", "corridor"])
def test_range_is_the_slab_range_for_every_ray(name):
    rng = np.random.default_rng(1)
    scene, bounds = load_scene(name), BOUNDS[name]
    for _ in range(20):
        position = rng.uniform(bounds[0] + 0.05, bounds[1] - 0.05)
        yaw, pitch, roll = rng.uniform(-180, 180, 3)
        pose = Pose(position_m=tuple(position), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
        directions = random_directions(rng, 10_000).reshape(100, 100, 3)
        range_m = ranges(scene, pose, directions, np.ones((100, 100), dtype=bool))
        expected = slab_range(bounds, position, directions @ pose.R_world_from_view.T)
        # Float64 carries 1e-15 of 27 m through a dozen operations; a float32 range would be 1e-6 off.
        np.testing.assert_allclose(range_m, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["box", "corridor"])
def test_no_ray_is_lost_at_edges_and_corners(name):
    rng = np.random.default_rng(2)
    bounds = BOUNDS[name]
    geometry = geometry_of(load_scene(name))
    for _ in range(20):
        origin = rng.uniform(bounds[0] + 0.05, bounds[1] - 0.05)
        ends = geometry.edges[rng.integers(len(geometry.edges), size=2000)]
        share = np.round(rng.uniform(-0.1, 1.1, (2000, 1)).clip(0, 1), 3)
        points = ends[:, 0] * (1 - share) + ends[:, 1] * share
        # Exactly at the edge, a last bit beside it, and where float32 is unsure.
        points += rng.choice([0, 1e-16, 1e-12, 1e-8, 1e-7], (2000, 1)) * rng.standard_normal((2000, 3))
        diagonals = geometry.corners[:, [0, 1, 2]].mean(axis=1)
        towards = np.concatenate([points, diagonals]) - origin
        directions = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        range_m = cast(geometry, origin, directions).range_m
        np.testing.assert_allclose(range_m, slab_range(bounds, origin, directions), rtol=0, atol=1e-9)


def test_mirror_pixels_see_the_slab_range():
    directions, valid = pixel_directions(Sensor())
    pose = Pose(position_m=(0.3, -0.4, 1.2), yaw_deg=30, pitch_deg=4, roll_deg=-3)
    range_m = ranges(load_scene("box"), pose, directions, valid)
    expected = slab_range(BOUNDS["box"], pose.position_m, directions @ pose.R_world_from_view.T)
    np.testing.assert_allclose(range_m[valid], expected[valid], rtol=0, atol=1e-9)
    assert np.isnan(range_m[~valid]).all()


def test_normals_and_faces_of_the_box():
    directions = panorama_directions(90, 40)
    pose = Pose(position_m=(0.5, -1, 1), yaw_deg=40)
    result = truth(load_scene("box"), pose, directions, np.ones((40, 90), dtype=bool))
    world = directions @ pose.R_world_from_view.T
    points = pose.position_m + result.range_m[..., None] * world
    assert (np.sum(result.normal * world, axis=-1) < 0).all()
    np.testing.assert_allclose(np.linalg.norm(result.normal, axis=-1), 1, atol=1e-12)
    for axis in range(3):
        for side, sign in ((0, 1), (1, -1)):
            on_side = np.abs(points[..., axis] - BOUNDS["box"][side, axis]) < 1e-9
            expected = np.zeros(3)
            expected[axis] = sign
            # Corners of the room do not fall on this grid: every point has one side.
            np.testing.assert_allclose(
                result.normal[on_side], np.broadcast_to(expected, (on_side.sum(), 3)), atol=1e-12
            )
            assert len(np.unique(result.face[on_side])) <= 1


def brute_force_blocked(corners, origin, points):
    """Whether a triangle cuts the open segment (T. Möller and B. Trumbore, J. Graphics Tools 2 (1997) 21)."""
    blocked = np.zeros(len(points), dtype=bool)
    segment = points - origin
    for a, b, c in corners:
        e1, e2, s = b - a, c - a, origin - a
        h = np.cross(segment, e2)
        det = h @ e1
        with np.errstate(divide="ignore", invalid="ignore"):
            u = h @ s / det
            q = np.cross(s, e1)
            v = segment @ q / det
            along = (e2 @ q) / det
            blocked |= (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & (along < 1 - 1e-6)
    return blocked


def test_occlusion_is_what_brute_force_finds():
    scene = load_scene("room")
    geometry = geometry_of(scene)
    directions = panorama_directions(180, 50)
    result = truth(scene, FIRST, directions, np.ones((50, 180), dtype=bool), pose_2=SECOND)
    points = np.array(FIRST.position_m) + result.range_m[..., None] * directions
    blocked = brute_force_blocked(geometry.corners, np.array(SECOND.position_m), points.reshape(-1, 3))
    disagree = blocked.reshape(50, 180) == result.unoccluded
    # Float32 decides within 1e-7 of an outline only: no pixel of this grid is that close.
    assert disagree.sum() == 0
    assert 0.05 < blocked.mean() < 0.3


def test_field_of_the_second_view():
    sensor = Sensor()
    directions = panorama_directions(180, 50)
    second = Pose(position_m=(0.5, 0.1, 1.2), yaw_deg=20, pitch_deg=5)
    valid = np.ones((50, 180), dtype=bool)
    result = truth(load_scene("box"), FIRST, directions, valid, pose_2=second, sensor_2=sensor)
    points = np.array(FIRST.position_m) + result.range_m[..., None] * directions
    _, expected = project(sensor, (points - second.position_m) @ second.R_world_from_view)
    np.testing.assert_array_equal(result.in_field_2, expected)
    assert 0 < expected.mean() < 1
    np.testing.assert_array_equal(result.visible, result.unoccluded & expected)
    assert result.unoccluded.all()


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(),
        Sensor(lens=Lens(k1=-0.2, k2=0.05, p1=0.002, p2=-0.001, k3=0.01)),
        Sensor(camera=Camera(width_px=300, height_px=260, cx_px=170, cy_px=120, aspect=1.1)),
        Sensor(field=FieldOfView(elevation_min_deg=-40, elevation_max_deg=-5)),
    ],
)
def test_what_is_on_the_sensor_is_what_project_says(sensor):
    pose = Pose(yaw_deg=40, pitch_deg=-10, roll_deg=25)
    directions = np.random.default_rng(9).normal(size=(20_000, 3))
    expected = project(sensor, directions @ pose.R_world_from_view)[1]
    assert 500 < expected.sum() < 19_500
    np.testing.assert_array_equal(on_sensor(sensor, pose, directions), expected)


def test_room_keeps_its_promises():
    directions = panorama_directions()
    valid = np.ones(directions.shape[:2], dtype=bool)
    result = truth(load_scene("room"), FIRST, directions, valid, pose_2=SECOND, sensor_2=Sensor())
    assert 1 - result.unoccluded.mean() >= 0.05
    assert result.textureless.mean() >= 0.02
    assert 0.005 < result.discontinuity.mean() < 0.05


def test_a_floor_and_the_creases_of_a_room_are_no_discontinuity():
    directions = panorama_directions()
    valid = np.ones(directions.shape[:2], dtype=bool)
    for name in ("box", "corridor"):
        assert not truth(load_scene(name), FIRST, directions, valid).discontinuity.any()


def pillar_scene(x=2.0, y=0.0):
    return Scene(
        name="pillar",
        objects=(
            Box(kind="box", inward=True, size_m=(8, 8, 4), texture=GREY),
            Box(kind="box", name="pillar", size_m=(0.5, 0.5, 4), position_m=(x, y, 0), texture=GREY),
        ),
    )


def test_discontinuity_is_at_the_outline_and_nowhere_else():
    directions = panorama_directions(720, 60, 0.26)
    result = truth(pillar_scene(), FIRST, directions, np.ones((60, 720), dtype=bool))
    # The front face is at x = 1.75 and 0.25 m to either side of it.
    phi = -180 + (np.arange(720) + 0.5) / 2
    outline = np.degrees(np.arctan2(0.25, 1.75))
    expected = (np.abs(np.abs(phi) - outline) < 0.5) & (np.abs(phi) < 90)
    assert expected.sum() == 4
    np.testing.assert_array_equal(result.discontinuity, np.broadcast_to(expected, (60, 720)))


@pytest.mark.parametrize("wrap", [True, False])
def test_discontinuity_across_the_seam(wrap):
    directions = panorama_directions(720, 20, 0.1)
    # The right edge of the pillar, seen from the front, lies on the seam at phi = ±180 degrees.
    valid = np.ones((20, 720), dtype=bool)
    scene = pillar_scene(x=-2.0, y=0.25)
    result = truth(scene, FIRST, directions, valid, wrap_columns=wrap)
    assert result.discontinuity[:, [0, -1]].all() == wrap
    assert result.discontinuity[:, [0, -1]].any() == wrap


def test_invalid_pixels_have_no_truth_and_make_no_jump():
    directions = panorama_directions(90, 40)
    valid = np.ones((40, 90), dtype=bool)
    valid[:, 30:50] = False
    directions[~valid] = np.nan
    result = truth(load_scene("room"), FIRST, directions, valid, pose_2=SECOND, sensor_2=Sensor())
    assert np.isnan(result.range_m[~valid]).all()
    assert np.isnan(result.normal[~valid]).all()
    assert (result.face[~valid] == -1).all()
    for mask in ("unoccluded", "in_field_2", "visible", "discontinuity", "textureless"):
        assert not getattr(result, mask)[~valid].any()
    assert np.isfinite(result.range_m[valid]).all()


def test_open_scene_has_no_range_where_there_is_nothing():
    floor = Plane(kind="plane", size_m=(4, 4), texture=GREY)
    scene = Scene(name="floor", closed=False, objects=(floor,))
    directions = panorama_directions(90, 40)
    result = truth(scene, FIRST, directions, np.ones((40, 90), dtype=bool), pose_2=SECOND)
    down = directions[..., 2] < 0
    with np.errstate(divide="ignore"):
        reach = np.where(down, -1 / directions[..., 2], np.inf)
    with np.errstate(invalid="ignore"):
        hit = down & (np.abs(reach[..., None] * directions[..., :2]) < 2).all(axis=-1)
    np.testing.assert_array_equal(np.isfinite(result.range_m), hit)
    np.testing.assert_allclose(result.range_m[hit], reach[hit], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(result.unoccluded, hit)


def test_a_plane_is_seen_from_both_sides():
    floor = Plane(kind="plane", size_m=(4, 4), texture=GREY)
    geometry = geometry_of(Scene(name="floor", closed=False, objects=(floor,)))
    for height in (1.0, -1.0):
        hits = cast(geometry, [0, 0, height], [[0, 0, -np.sign(height)]])
        assert hits.range_m == pytest.approx(1.0, abs=1e-15)


def test_range_scales_with_the_world():
    directions = panorama_directions(180, 50)
    valid = np.ones((50, 180), dtype=bool)
    scene = load_scene("room")
    once = truth(scene, FIRST, directions, valid, pose_2=SECOND, sensor_2=Sensor())
    twice = truth(
        scene.model_copy(update={"scale": 2.0}),
        Pose(position_m=(0, 0, 2)),
        directions,
        valid,
        pose_2=Pose(position_m=(1, 0, 2)),
        sensor_2=Sensor(),
    )
    # Doubling is exact in binary floating point.
    np.testing.assert_array_equal(twice.range_m, 2 * once.range_m)
    np.testing.assert_array_equal(twice.visible, once.visible)
    np.testing.assert_array_equal(twice.discontinuity, once.discontinuity)


def test_threads_change_nothing():
    directions, valid = pixel_directions(Sensor())
    scene = load_scene("room")
    one, three = (ranges(scene, FIRST, directions, valid, threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_directions_must_be_of_unit_length():
    with pytest.raises(ValueError, match="unit length"):
        cast(geometry_of(load_scene("box")), (0, 0, 1), [[0.0, 0.0, 1.001]])


def test_truth_is_read_only():
    directions = panorama_directions(20, 10)
    result = truth(load_scene("box"), FIRST, directions, np.ones((10, 20), dtype=bool))
    with pytest.raises(ValueError, match="read-only"):
        result.range_m[0, 0] = 1


def test_discontinuity_of_a_single_jump():
    directions = np.array([[[1.0, -0.01, 0], [1.0, 0.01, 0]]])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    towards = np.array([[[-1.0, 0, 0], [-1.0, 0, 0]]])
    assert discontinuities(np.array([[1.0, 1.2]]), towards, directions, wrap_columns=False).all()
    assert not discontinuities(np.array([[1.0, 1.04]]), towards, directions, wrap_columns=False).any()
    assert not discontinuities(np.array([[1.0, np.nan]]), towards, directions, wrap_columns=False).any()
