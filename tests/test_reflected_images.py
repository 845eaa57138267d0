"""Images in a misaligned mirror: against the aligned one, a slow ray tracer, and the ranges that they lead to."""

import numpy as np
import pytest

import harness
from harness.camera.misalignment import Misalignment
from harness.camera.reflection import project_points, reflect
from harness.camera.sensor import Sensor, pixel_directions, unproject
from harness.errors import InputError
from harness.geometry.panorama import directions
from harness.geometry.pose import Pose
from harness.geometry.triangulation import triangulate
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.simulation.cast import cast
from harness.simulation.reflected import points_seen, reflected_image
from harness.simulation.render import render
from harness.simulation.scene import Box, Plane, Scene, load_scene
from harness.simulation.scene_geometry import geometry_near, geometry_of
from harness.simulation.shading import view_from
from harness.simulation.texture import GreyTexture, lookup
from harness.spec import parse

OFF = Misalignment(x_mm=0.8, y_mm=-0.5, z_mm=0.6, rotation_x_deg=0.4, rotation_y_deg=-0.3, rotation_z_deg=2.0)
MISALIGNED = Sensor(misalignment=OFF)
POSES = (Pose(position_m=(0, 0, 1)), Pose(position_m=(0.2, 0.1, 1.2), yaw_deg=37, pitch_deg=9, roll_deg=-6))


# --- The aligned mirror -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES, ids=["upright", "turned"])
@pytest.mark.parametrize(("name", "most"), [("box", 2), ("room", 20)])
def test_without_misalignment_it_is_the_central_picture(name, most, pose):
    """With the same samples. On an outline one may fall to the other side, in float32: found 1 and 8 at most."""
    scene = load_scene(name)
    difference = np.abs(reflected_image(view_from(scene, pose), Sensor(), 16) - render(scene, Sensor(), pose, 16))
    assert np.count_nonzero(difference > 1e-3) <= most


def test_zero_is_no_misalignment():
    """To the bit, and in the trial's key."""
    zero = Sensor(misalignment=Misalignment(x_mm=0.0, rotation_y_deg=0.0))
    np.testing.assert_array_equal(
        render(load_scene("box"), zero, POSES[0], 1), render(load_scene("box"), Sensor(), POSES[0], 1)
    )
    assert Trial(scene=load_scene("box"), sensor=zero).key == Trial(scene=load_scene("box")).key


# --- A slow ray tracer --------------------------------------------------------------------------------------------


def traced(sensor: Sensor, pose: Pose, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points `[n, 3]` in the box that pixels `[n, 2]` see, in the world; which side each is on; and distances from F0.

    Polynomial roots for the mirror, its gradient for the normal, and the nearest of six planes for the room.
    """
    a, b, f = sensor.model.a_m, sensor.model.b_m, sensor.camera.focal_px
    e = np.hypot(a, b)
    miss = sensor.misalignment
    x, y, z = np.radians([miss.rotation_x_deg, miss.rotation_y_deg, miss.rotation_z_deg])
    R_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    R_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    R_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    centre = np.array([miss.x_mm, miss.y_mm, miss.z_mm]) / 1000 - [0, 0, 2 * e]
    world, sides, ranges = [], [], []
    for u, v in pixels:
        d = R_z @ R_y @ R_x @ [(u - sensor.camera.cx_px) / f, (v - sensor.camera.cy_px) / f, 1.0]
        up, out = np.poly1d([d[2], centre[2] + e]), [np.poly1d([d[i], centre[i]]) for i in (0, 1)]
        roots = (up * up / a**2 - (out[0] * out[0] + out[1] * out[1]) / b**2 - 1).roots.real
        s = min(root for root in roots if root > 0 and up(root) > 0)
        p = centre + s * d
        n = np.array([-p[0] / b**2, -p[1] / b**2, (p[2] + e) / a**2])
        n /= np.linalg.norm(n)
        r = pose.R_world_from_view @ (d - 2 * (d @ n) * n)
        start = np.array(pose.position_m) + pose.R_world_from_view @ p
        with np.errstate(divide="ignore"):
            reach = (np.where(r > 0, [3, 3, 6], [-3, -3, 0]) - start) / r
        axis = int(np.argmin(reach))
        world.append(start + reach[axis] * r)
        sides.append(2 * axis + int(r[axis] > 0))
        ranges.append(np.linalg.norm(world[-1] - pose.position_m))
    return np.array(world), np.array(sides), np.array(ranges)


def grey_of(scene: Scene, world: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The box's grey at points on its sides."""
    geometry = geometry_of(scene)
    grey = np.empty(len(world))
    for side in np.unique(sides):
        axis = side // 2
        level = np.array([[-3, 3], [-3, 3], [0, 6]])[axis, side % 2] - geometry.centre[axis]
        here = np.abs(np.abs(geometry.normals[:, axis]) - 1) < 1e-9
        here &= np.abs(geometry.offsets * np.sign(geometry.normals[:, axis]) - level) < 1e-9
        (face,) = np.flatnonzero(here)
        points = np.column_stack([world[sides == side] - geometry.centre, np.ones((sides == side).sum())])
        texels = geometry.textures[geometry.texture_of_face[face]]
        grey[sides == side] = lookup(texels, points @ geometry.uv_maps[face].T)
    return grey


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES, ids=["upright", "turned"])
def test_against_a_slow_ray_tracer(pose):
    scene, rng = load_scene("box"), np.random.default_rng(5)
    image, points = render(scene, MISALIGNED, pose, 16), points_seen(scene, MISALIGNED, pose)
    rows, columns = np.nonzero(image)
    chosen = rng.choice(rows.size, 60, replace=False)
    pixels = np.stack([columns, rows], axis=-1)[chosen]
    world, _, range_m = traced(MISALIGNED, pose, pixels)
    u, v = pixels.T
    # Of metres, in float64, from a mirror that magnifies a rounding some hundred times.
    np.testing.assert_allclose(points.range_m[v, u], range_m, rtol=0, atol=1e-10)
    seen = points.point_m[v, u] @ pose.R_world_from_view.T + pose.position_m
    np.testing.assert_allclose(seen, world, rtol=0, atol=1e-10)

    apart = np.full(len(pixels), np.inf)
    for per_side in (4, 8):  # where samples are too wide for the texture there are four times as many
        offsets = (np.arange(per_side) + 0.5) / per_side - 0.5
        grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        close = apart > 1e-3
        samples = (pixels[close, None] + grid).reshape(-1, 2)
        world, sides, _ = traced(MISALIGNED, pose, samples)
        mean = grey_of(scene, world, sides).reshape(-1, per_side**2).mean(axis=1)
        apart[close] = np.abs(image[v, u][close] - mean)
    assert apart.max() < 1e-3  # the textures are float32


@pytest.mark.slow
def test_a_face_in_the_plane_of_the_viewpoint():
    """It has no homography from there, but the mirror, which is two centimetres wide, sees it on one side."""
    wall = Plane(
        kind="plane",
        size_m=(1.0, 1.0),
        position_m=(1.0, 0.0, 1.0),
        roll_deg=90,
        texture=GreyTexture(kind="grey", value=90),
    )
    room = Box(kind="box", inward=True, size_m=(6, 6, 6), texture=GreyTexture(kind="grey", value=200))
    scene = Scene(name="edge on", objects=(room, wall))
    image = render(scene, Sensor(misalignment={"y_mm": 8.0}), Pose(position_m=(0, 0, 1)), 64)
    assert (image[image > 0] < 190).any()  # of a sliver that is thinner than a pixel
    assert image[image > 0].min() > 89.99
    assert image.max() < 200.01


# --- Ranges -------------------------------------------------------------------------------------------------------


def assumed_range(trial: Trial, geometry) -> np.ndarray:
    """What perfect matching with the aligned sensor makes of every pixel of the panorama, metres.

    The pixel's ray as it truly is, the point that it meets, the pixel at which view 2 has that point by Fermat's
    principle, and the direction in which the aligned sensor has this; without what lies across the epipolar plane.
    """
    first, _ = trial.poses
    sensor, assumed = trial.sensor, trial.sensor.aligned
    looking = directions(trial.panorama)
    pixels = project_points(assumed, looking)[0]
    begin, towards, _ = reflect(sensor, pixels)
    unknown = ~np.isfinite(begin).all(axis=-1)
    begin[unknown], towards[unknown] = 0.0, [1.0, 0.0, 0.0]
    origin = np.array(first.position_m) - geometry.centre
    points = begin + cast(geometry, origin + begin, towards).range_m[..., None] * towards
    t = trial.true_motion.t_v1
    x_2, _ = unproject(assumed, project_points(sensor, points - t)[0])
    normal = np.cross(t, looking)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    x_2 = x_2 - np.sum(x_2 * normal, axis=-1, keepdims=True) * normal
    angles = [np.arctan2(np.linalg.norm(np.cross(x, t), axis=-1), x @ t) for x in (looking, x_2)]
    return np.where(unknown, np.nan, triangulate(*angles, trial.true_motion.baseline_m)[0])


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("misalignment", [{"y_mm": 0.3}, {"z_mm": 0.5}, {"x_mm": 0.2, "rotation_x_deg": -0.1}])
def test_ranges_are_wrong_by_what_geometry_says(misalignment):
    """Rendering, unwrapping and matching on one side, points and rays alone on the other."""
    trial = parse(
        Trial,
        {
            "scene": load_scene("box").model_dump(mode="json"),
            "sensor": {"misalignment": misalignment},
            "matching": {"kind": "slanted"},
        },
    )
    outcome = run_trial(trial, StageCache())
    true = outcome.reference
    expected = assumed_range(trial, geometry_near(trial.scene, trial.view_1.position_m))
    where = outcome.valid & true.domain & (np.sin(true.alpha_1) > 0.5) & np.isfinite(expected)
    assert where.mean() > 0.5
    error, wrong = (outcome.range_m - true.range_m)[where], (expected - true.range_m)[where]
    assert np.median(np.abs(wrong)) > 0.01
    # Found: 8, 6 and 14 %. A match that lies beside its epipolar curve is drawn along it by the texture's slant.
    assert np.median(np.abs(error - wrong)) < 0.2 * np.median(np.abs(wrong))


def test_matchers_and_truth_have_the_aligned_sensor():
    scene = load_scene("box").model_dump(mode="json")
    small = {"camera": {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}}
    table = {"scene": scene, "panorama": {"width_px": 90, "height_px": 25}, "render": {"samples": 1}}
    table |= {"noise": {"sigma_grey": 2.0}, "matching": {"kind": "column"}}
    cache = StageCache()
    plain, off = (
        run_trial(parse(Trial, table | {"sensor": small | {"misalignment": each}}), cache)
        for each in ({}, {"x_mm": 1.0, "rotation_y_deg": 0.5})
    )
    assert off.pair.sensors == plain.pair.sensors
    assert off.trial.key != plain.trial.key
    assert off.truth is plain.truth  # not made twice
    both = pixel_directions(plain.trial.sensor)[1] & (off.clean[0] > 0)
    # The same draws; single precision of grey levels up to 255.
    noises = [(outcome.images[0] - outcome.clean[0])[both] for outcome in (plain, off)]
    np.testing.assert_allclose(*noises, rtol=0, atol=5e-5)
    assert np.abs(off.clean[0] - plain.clean[0])[both].max() > 20


def test_a_camera_that_looks_past_its_mirror_is_refused():
    table = {"scene": load_scene("box").model_dump(mode="json"), "sensor": {"misalignment": {"rotation_x_deg": 60}}}
    with pytest.raises(InputError, match="no pixel of the image sees the mirror") as caught:
        run_trial(parse(Trial, table))
    assert caught.value.key == "trial.sensor.misalignment"


@pytest.mark.slow
def test_a_view_of_its_own(tmp_path):
    view = harness.render("box", sensor={"misalignment": {"x_mm": 1.0}}, samples=1)
    np.testing.assert_allclose(np.linalg.norm(view.points_m, axis=-1), view.range_m)
    view.write(tmp_path)
    np.testing.assert_array_equal(np.load(tmp_path / "points.npy"), view.points_m)
    assert "misaligned with its mirror" in (tmp_path / "README.txt").read_text()
    assert "x_mm = 1.0" in (tmp_path / "sensor.toml").read_text()
    aligned = harness.render("box", samples=1)
    np.testing.assert_array_equal(view.panorama_range_m, aligned.panorama_range_m)
    assert aligned.points_m is None
