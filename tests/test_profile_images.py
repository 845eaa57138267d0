"""Images in mirrors of any profile: against a slow ray tracer, and what belongs to the central camera."""

import numpy as np
import pytest
from test_reflected_images import grey_of

from harness.camera.central import central_of
from harness.camera.intrinsics import FieldOfView
from harness.camera.misalignment import Misalignment
from harness.camera.profile import Cone, Sphere
from harness.camera.sensor import Sensor, model_from_sensor
from harness.geometry.pose import Pose
from harness.pipeline.rendered_view import view_of
from harness.simulation.reflected import points_seen
from harness.simulation.render import render
from harness.simulation.scene import load_scene

VIEWPOINT_M = 0.0075
SPHERE = Sphere(radius_m=0.03, rim_m=0.024, camera_m=0.06, viewpoint_m=VIEWPOINT_M)
POSE = Pose(position_m=(0.2, 0.1, 1.2), yaw_deg=37, pitch_deg=9, roll_deg=-6)


def traced(sensor: Sensor, pose: Pose, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points `[n, 3]` in the box that pixels `[n, 2]` see in a sphere, in the world, and which side each is on: the
    roots of the sphere's quadratic, its radius for the normal, and the nearest of six planes for the room."""
    profile, camera = sensor.profile, sensor.camera
    misalignment = sensor.misalignment
    middle = np.array([0, 0, profile.radius_m - VIEWPOINT_M])
    centre = np.array([0, 0, -profile.camera_m - VIEWPOINT_M]) + misalignment.offset_m
    world, sides = [], []
    for u, v in pixels:
        d = [(u - camera.cx_px) / camera.focal_px, (v - camera.cy_px) / camera.focal_px, 1.0]
        d = misalignment.R_mirror_from_camera @ d
        out = centre - middle
        s = np.roots([d @ d, 2 * d @ out, out @ out - profile.radius_m**2]).real.min()
        p = centre + s * d
        n = (p - middle) / profile.radius_m
        to_world = pose.R_world_from_view @ model_from_sensor(sensor).T
        r, start = to_world @ (d - 2 * (d @ n) * n), np.array(pose.position_m) + to_world @ p
        with np.errstate(divide="ignore"):
            reach = (np.where(r > 0, [3, 3, 6], [-3, -3, 0]) - start) / r
        axis = int(np.argmin(reach))
        world.append(start + reach[axis] * r)
        sides.append(2 * axis + int(r[axis] > 0))
    return np.array(world), np.array(sides)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("misalignment", [Misalignment(), Misalignment(x_mm=0.8, rotation_y_deg=0.5)], ids=str)
def test_a_sphere_against_a_slow_ray_tracer(misalignment):
    sensor, scene = Sensor(profile=SPHERE, misalignment=misalignment), load_scene("box")
    image, points = render(scene, sensor, POSE, 16), points_seen(scene, sensor, POSE)
    rows, columns = np.nonzero(image)
    chosen = np.random.default_rng(5).choice(rows.size, 60, replace=False)
    pixels = np.stack([columns, rows], axis=-1)[chosen]
    world, _ = traced(sensor, POSE, pixels)
    u, v = pixels.T
    # Of metres, in float64, from a mirror that magnifies a rounding some hundred times.
    seen = points.point_m[v, u] @ POSE.R_world_from_view.T + POSE.position_m
    np.testing.assert_allclose(seen, world, rtol=0, atol=1e-10)
    np.testing.assert_allclose(points.range_m[v, u], np.linalg.norm(world - POSE.position_m, axis=-1), atol=1e-10)
    apart = np.full(len(pixels), np.inf)
    for per_side in (4, 8):  # where samples are too wide for the texture there are four times as many
        offsets = (np.arange(per_side) + 0.5) / per_side - 0.5
        grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        close = apart > 1e-3
        world, sides = traced(sensor, POSE, (pixels[close, None] + grid).reshape(-1, 2))
        mean = grey_of(scene, world, sides).reshape(-1, per_side**2).mean(axis=1)
        apart[close] = np.abs(image[v, u][close] - mean)
    assert apart.max() < 1e-3  # the textures are float32


@pytest.mark.slow
def test_a_view_has_the_panorama_of_the_central_camera_and_the_points_of_the_mirror():
    field = FieldOfView(elevation_min_deg=-60, elevation_max_deg=10)
    sensor = Sensor(profile=Cone(half_angle_deg=55, rim_m=0.0306, camera_m=0.03), camera={"focal_px": 400}, field=field)
    view = view_of(load_scene("box"), sensor, POSE, samples=1)
    assert view.points_m is not None
    known = np.isfinite(view.range_m)
    np.testing.assert_allclose(np.linalg.norm(view.points_m, axis=-1)[known], view.range_m[known], rtol=1e-14)
    assert known.mean() > 0.4
    assert np.isfinite(view.panorama).any()
    assert central_of(sensor).model.kind == "ocam"
