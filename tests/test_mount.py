"""How a camera is mounted: against turned poses and flipped images, and that every compiled loop knows of it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import Equirectangular, Unified
from harness.camera.mount import Mount, camera_from_sensor, edge_of
from harness.camera.sensor import (
    Sensor,
    field_of,
    in_field,
    jacobian,
    model_from_sensor,
    parameters_of,
    pixel_directions,
    project,
    unproject,
)
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.pipeline import sight
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import Outcome, run_trial
from harness.simulation.render import render, render_every_sample
from harness.simulation.scene import load_scene
from harness.simulation.truth import on_sensor
from harness.spec import dump_toml, parse
from harness.toml import parse_toml

SMALL = Camera(width_px=160, height_px=120, focal_px=153.53, aspect=1.01, cx_px=80.5, cy_px=59)
TRIED = {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}
WIDE = FieldOfView(elevation_min_deg=-90, elevation_max_deg=90, angle_max_deg=70)
BENT = Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3)
MIRROR = Sensor(camera=SMALL, lens=BENT)
PINHOLE = Sensor(model=Unified(xi=0), camera=SMALL, field=WIDE)

looks = st.sampled_from(["up", "down", "forward"])
turns = st.floats(-180, 180)
mounts = st.builds(Mount, looks=looks, mirrored=st.booleans(), yaw_deg=turns, pitch_deg=turns, roll_deg=turns)


def mounted(sensor: Sensor, **keys: object) -> Sensor:
    return Sensor(**{**dict(sensor), "mount": Mount(**keys)})


def directions_seen(sensor: Sensor) -> np.ndarray:
    directions, valid = pixel_directions(sensor)
    return directions[valid]


# --- The matrices, against the words that define them -------------------------------------------------------------

AXES = {"up": (0, 0, 1), "down": (0, 0, -1), "forward": (1, 0, 0)}


@pytest.mark.parametrize("which", AXES)
def test_what_looks_means(which: str) -> None:
    """Right-handed unless mirrored, the optical axis where it says; a forward picture's up is up."""
    for mirrored in (False, True):
        matrix = camera_from_sensor(which, mirrored=mirrored)
        assert np.linalg.det(matrix) == (-1 if mirrored else 1)
        assert (matrix @ matrix.T == np.eye(3)).all()
        assert (matrix[2] == AXES[which]).all()
    if which == "forward":
        assert (matrix[1] == [0, 0, -1]).all()  # v runs down
        assert (camera_from_sensor(which, mirrored=False) @ [0, -1, 0] == [1, 0, 0]).all()  # y is to the left


def test_mirrors_at_their_default_are_not_turned() -> None:
    sensor = Sensor()
    assert (sensor.looks, sensor.mirrored) == ("down", True)
    assert (model_from_sensor(sensor) == np.eye(3)).all()
    assert type(parameters_of(sensor)).__name__ == "HyperboloidCamera"
    assert parameters_of(mounted(sensor, looks="down", mirrored=True)) == parameters_of(sensor)
    assert type(parameters_of(mounted(sensor, roll_deg=1e-9))).__name__ == "MountedCamera"
    assert (model_from_sensor(PINHOLE) == np.eye(3)).all()
    around = Sensor(model=Equirectangular(), camera=Camera(focal_px=320 / math.pi, aspect=1.5))
    assert (around.looks, around.mirrored) == ("forward", False)
    assert (model_from_sensor(around) == np.eye(3)).all()
    ahead = [1.0, 0.1, 0.02]  # its own axes are the sensor's, and it sees as other lenses do that look ahead
    shifted = np.sign(project(around, ahead)[0] - [319.5, 239.5])
    assert (shifted == np.sign(project(mounted(PINHOLE, looks="forward"), ahead)[0] - [80.5, 59])).all()


@pytest.mark.slow
def test_a_mirror_that_hangs_is_one_turned_over() -> None:
    """Upside down the mirror looks up: the same as a roll of 180°, which takes y and z to their negatives."""
    field = FieldOfView(elevation_min_deg=-20, elevation_max_deg=75)
    hangs = Sensor(camera=SMALL, mount=Mount(looks="up"), field=field)
    assert hangs.mirrored
    rolled = Sensor(camera=SMALL, mount=Mount(roll_deg=180))
    d = directions_seen(hangs)
    # Elevations are measured before the tilt: -75 .. 20 of the one are -20 .. 75 of the other.
    assert len(d) == len(directions_seen(rolled)) > 5000
    np.testing.assert_allclose(project(hangs, d)[0], project(rolled, d)[0], rtol=0, atol=1e-11)  # sin(180°) is 1e-16


# --- Properties of any mount --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [MIRROR, PINHOLE], ids=["mirror", "pinhole"])
@settings(deadline=None)  # the first call loads the compiled loops
@given(mount=mounts)
def test_there_and_back_and_derivatives(sensor: Sensor, mount: Mount) -> None:
    """As without a mount: the lens is undone to 1e-13 of the radius; central differences are good to 1e-8."""
    sensor = sensor.model_copy(update={"mount": mount, "field": FieldOfView(elevation_min_deg=-90, angle_max_deg=70)})
    u, v = np.meshgrid(np.arange(0, 160, 13.7), np.arange(0, 120, 11.3))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    d, valid = unproject(sensor, pixels)
    again, visible = project(sensor, 3.7 * d)
    np.testing.assert_allclose(again, pixels, rtol=0, atol=1e-8)
    assert np.mean(visible == valid) > 0.98  # but for rounding at the edge
    step = 1e-4
    for axis in range(3):
        moved = step * np.eye(3)[axis]
        numeric = (project(sensor, d + moved)[0] - project(sensor, d - moved)[0]) / (2 * step)
        np.testing.assert_allclose(jacobian(sensor, d)[..., axis], numeric, rtol=0, atol=1e-5 * SMALL.focal_px)


@pytest.mark.slow
@settings(deadline=None)  # the first call loads the compiled loops
@given(mount=mounts, far=st.floats(0.1, 10))
def test_a_turned_mount_is_a_turned_pose(mount: Mount, far: float) -> None:
    """Pixels, field and the compiled mask of the second view. A rotation written as a product rounds otherwise: 1e-15
    of a direction, 1e-12 px."""
    angles = {"yaw_deg": mount.yaw_deg, "pitch_deg": mount.pitch_deg, "roll_deg": mount.roll_deg}
    flat = PINHOLE.model_copy(update={"mount": mount.model_copy(update=dict.fromkeys(angles, 0.0))})
    turned = PINHOLE.model_copy(update={"mount": mount})
    pose = Pose(**angles)
    d = far * np.random.default_rng(0).normal(size=(2000, 3))
    pixels, visible = project(turned, d)
    expected, seen_so = project(flat, d @ pose.R_world_from_view)
    ahead = np.isfinite(expected).all(axis=-1)
    assert (np.isfinite(pixels).all(axis=-1) == ahead).all()
    assert (visible == seen_so).all()
    np.testing.assert_allclose(pixels[visible], expected[visible], rtol=0, atol=1e-10)
    assert (in_field(turned, d) == in_field(flat, d @ pose.R_world_from_view)).all()
    assert (on_sensor(turned, Pose(), d) == visible).all()
    assert (on_sensor(flat, pose, d) == visible).all()


@pytest.mark.parametrize("which", AXES)
def test_mirrored_flips_the_image(which: str) -> None:
    """Left and right of a camera that looks ahead; one that looks up or down, whose picture has no up, from top to
    bottom."""
    camera = SMALL.model_copy(update={"cx_px": 79.5, "cy_px": 59.5})
    plain = Sensor(
        model=Unified(xi=0), camera=camera, field=WIDE, mount=Mount(looks=which, mirrored=False, pitch_deg=20)
    )
    flipped = Sensor(
        model=Unified(xi=0), camera=camera, field=WIDE, mount=Mount(looks=which, mirrored=True, pitch_deg=20)
    )
    d = directions_seen(plain)
    (u, v), (u_flipped, v_flipped) = project(plain, d)[0].T, project(flipped, d)[0].T
    expected = (159 - u, v) if which == "forward" else (u, 119 - v)
    np.testing.assert_allclose([u_flipped, v_flipped], expected, rtol=0, atol=1e-10)


# --- Rendering ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{"yaw_deg": 30.0}, {"yaw_deg": -70.0, "pitch_deg": 12.0, "roll_deg": -8.0}])
def test_rendered_through_a_turned_mount_and_from_a_turned_pose(keys: dict[str, float]) -> None:
    """Rays are turned by the mount and then by no pose, or by the pose alone: they differ by 1e-16, and so may which
    of two touching faces a sample falls on. One sample of 16 at full contrast would be 16 grey levels."""
    scene = load_scene("room")
    sensor = Sensor(camera=SMALL)
    one = render(scene, mounted(sensor, **keys), Pose(position_m=(0.2, 0.1, 1.2)))
    other = render(scene, sensor, Pose(position_m=(0.2, 0.1, 1.2), **keys))
    assert ((one == 0) == (other == 0)).all()
    difference = np.abs(one - other)
    assert np.count_nonzero(difference > 1e-3) <= 3
    assert difference.max() < 16


@pytest.mark.slow
@pytest.mark.parametrize("which", AXES)
def test_shortcut_equals_every_sample_through_any_mount(which: str) -> None:
    """Outlines are found where a mounted camera sees them: a missed one would show as half its contrast."""
    sensor = mounted(PINHOLE, looks=which, mirrored=which == "down", yaw_deg=25, pitch_deg=15, roll_deg=-40)
    pose = Pose(position_m=(0.2, 0.1, 1.2), yaw_deg=10, pitch_deg=5)
    image = render(load_scene("room"), sensor, pose)
    assert np.mean(image > 0) > 0.5
    assert np.abs(image - render_every_sample(load_scene("room"), sensor, pose)).max() <= 1e-3


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["column", "sgm", "slanted"])
def test_a_trial_through_a_turned_mount_and_from_turned_poses(kind: str) -> None:
    """Rendered, unwrapped, matched, with truth and bound: 30° of yaw are 15 columns of the panorama, and nothing else.

    The true range is that of rays which differ by 1e-16, the bound has derivatives of step 1e-3 px. Draws of the noise,
    of 0.001 grey levels, are others: they move a match by 1e-4 px, and a few near a tie by more.
    """

    def outcome(sensor: dict[str, object], yaw_deg: float) -> Outcome:
        table = {
            "scene": load_scene("box").model_dump(mode="json"),
            "sensor": {"camera": TRIED, **sensor},
            "view_1": {"position_m": [0.1, 0.05, 1.0], "yaw_deg": yaw_deg},
            "view_2": {"baseline_m": 0.5, "yaw_deg": yaw_deg},
            "panorama": {"width_px": 180, "height_px": 50},
            "render": {"samples": 4},
            "noise": {"sigma_grey": 1e-3},
            "scoring": {"bound": True},
            "matching": {"kind": kind},
        }
        return run_trial(parse(Trial, table), StageCache())

    def rolled(array: np.ndarray) -> np.ndarray:
        return np.roll(array, 15, axis=1)

    by_mount, by_pose = outcome({"mount": {"yaw_deg": 30.0}}, 0.0), outcome({}, 30.0)
    np.testing.assert_allclose(by_mount.truth.range_m, rolled(by_pose.truth.range_m), rtol=1e-12)
    assert (by_mount.truth.visible == rolled(by_pose.truth.visible)).mean() > 0.999
    one, other = by_mount.range_m, rolled(by_pose.range_m)
    assert (np.isfinite(one) == np.isfinite(other)).mean() > 0.995
    apart = np.abs(one / other - 1)
    assert np.nanmedian(apart) < 1e-4
    assert np.nanpercentile(apart, 99) < 0.02
    if by_mount.bound_px is not None:
        bounds = np.isfinite(by_mount.bound_px) & np.isfinite(rolled(by_pose.bound_px))
        assert bounds.sum() > 400
        assert np.abs(by_mount.bound_px / rolled(by_pose.bound_px) - 1)[bounds].max() < 1e-6


# --- The field of view --------------------------------------------------------------------------------------------


def test_edge_of_a_field() -> None:
    field = FieldOfView(elevation_min_deg=-75, elevation_max_deg=20)
    assert edge_of(field, "up") == (165, "elevation_min_deg", -75)
    assert edge_of(field, "down") == (110, "elevation_max_deg", 20)
    assert edge_of(field, "forward") == (180, "angle_max_deg", 180)
    high = FieldOfView(elevation_min_deg=10, elevation_max_deg=40)
    assert edge_of(high, "forward").angle_deg == 170  # straight back, 10° up
    for each in ("up", "down", "forward"):
        assert edge_of(WIDE, each) == (70, "angle_max_deg", 70)
    # What a message proposes is within the angle that it is about.
    for each, key in (("up", "elevation_min_deg"), ("down", "elevation_max_deg"), ("forward", "angle_max_deg")):
        edge = edge_of(field, each)
        value = float(edge.remedy(61.2345).split()[-1])
        assert edge_of(field.model_copy(update={key: value}), each).angle_deg <= 61.2345 < edge.angle_deg


@settings(deadline=None)  # the first call loads the compiled loops
@given(mount=mounts, lowest=st.floats(-90, 60), span=st.floats(1, 150), most=st.floats(5, 180))
def test_field_in_a_tilted_sensor(mount: Mount, lowest: float, span: float, most: float) -> None:
    """Elevations before the tilt, angles off the axis: against the angles themselves."""
    field = FieldOfView(elevation_min_deg=lowest, elevation_max_deg=min(90, lowest + span), angle_max_deg=most)
    sensor = PINHOLE.model_copy(update={"mount": mount, "field": field})
    d = np.random.default_rng(1).normal(size=(500, 3))
    untilted = d @ mount.R_sensor_from_untilted
    elevation = np.degrees(np.arctan2(untilted[:, 2], np.hypot(untilted[:, 0], untilted[:, 1])))
    axis = np.array(AXES[mount.looks])
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(untilted, axis), axis=-1), untilted @ axis))
    expected = (elevation >= lowest) & (elevation <= field.elevation_max_deg) & (angle <= most)
    near = np.abs(np.stack([elevation - lowest, elevation - field.elevation_max_deg, angle - most])).min(axis=0) < 1e-6
    assert (in_field(sensor, d) == expected)[~near].all()


@settings(deadline=None)  # the first call loads the compiled loops
@given(mount=mounts)
def test_poles_and_axes_are_seen(mount: Mount) -> None:
    """Where there is no limit, no rounding makes one."""
    everything = FieldOfView(elevation_min_deg=-90, elevation_max_deg=90)
    sensor = PINHOLE.model_copy(update={"mount": mount, "field": everything})
    ends = np.vstack([mount.R_sensor_from_untilted.T, -mount.R_sensor_from_untilted.T, np.eye(3), -np.eye(3)])
    assert in_field(sensor, ends * 0.3).all()
    limits = field_of(sensor)
    assert (limits.lowest, limits.highest, limits.nearest) == (-2, 2, -2)


def test_widened_field() -> None:
    limits = field_of(Sensor(), margin_rad=math.radians(5))
    assert (limits.lowest, limits.highest) == (
        pytest.approx(math.sin(math.radians(-80)), abs=1e-15),
        pytest.approx(math.sin(math.radians(25)), abs=1e-15),
    )
    assert limits.nearest == -2


# --- Tables -------------------------------------------------------------------------------------------------------


def test_what_a_tilted_sensor_sees_of_the_panorama_in_words() -> None:
    """A cone of 70° about the horizontal reaches 70° up and down; elevations are found to half a degree."""
    assert sight._z(mounted(PINHOLE, looks="forward")) == "-2.75 .. 2.75"
    assert sight._z(Sensor()) == "-3.73 .. 0.36"
    assert sight._z(mounted(Sensor(), roll_deg=30)) == "-572.96 .. 1.17"  # down to the pole, and 49.5° up or more


def test_written_and_read_back() -> None:
    for sensor in (Sensor(), mounted(PINHOLE, looks="forward", mirrored=True, yaw_deg=3)):
        assert parse(Sensor, parse_toml(dump_toml(sensor))) == sensor
    assert "looks" not in dump_toml(Sensor())  # the model's own affair


BEYOND, LARGER = "is beyond the mirror's asymptote, asin(a/e) = 50.21 deg", "or a mirror with a larger a_m / b_m"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"mount": {"looks": "ahead"}}, "mount.looks: 'ahead' is not valid; valid: up, down, forward"),
        ({"mount": {"rol_deg": 3}}, "mount.rol_deg: unknown key 'rol_deg'; did you mean 'roll_deg'?"),
        ({"mount": {"mirrored": "yes"}}, "mount.mirrored: must be true or false; found 'yes'"),
        ({"field": {"angle_max_deg": 0}}, "field.angle_max_deg: must be above 0; found 0"),
        ({"mount": {"looks": "up"}}, f"field.elevation_min_deg = -75 {BEYOND}; use at least -50.2, {LARGER}"),
        ({"mount": {"looks": "forward"}}, f"field.angle_max_deg = 180 {BEYOND}; use at most 140.2, {LARGER}"),
    ],
)
def test_mistakes(table: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(Sensor, table)
    assert str(caught.value) == message


def test_a_mirror_that_looks_ahead() -> None:
    """Its field is a cone about the axis; nothing else is asked of it."""
    sensor = Sensor(camera=SMALL, mount=Mount(looks="forward"), field=FieldOfView(angle_max_deg=110))
    d = directions_seen(sensor)
    assert d[:, 0].min() == pytest.approx(math.cos(math.radians(110)), abs=0.02)  # a pixel at the rim is 1° wide
