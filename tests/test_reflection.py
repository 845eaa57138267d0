"""A camera misaligned with its mirror: its rays, against the mirror's equation and Fermat's principle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, distort
from harness.camera.misalignment import Misalignment
from harness.camera.models import Mirror, Unified
from harness.camera.mount import Mount
from harness.camera.optics import optics_of
from harness.camera.reflection import reflect, reflected_rays, reflecting_camera
from harness.camera.sensor import (
    Sensor,
    jacobian,
    model_from_sensor,
    pixel_directions,
    project,
    rays_of,
    unproject,
)
from harness.errors import InputError
from harness.pipeline.specification import Trial
from harness.spec import dump_toml, parse
from harness.toml import parse_toml

BENT = Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3)
ODD = Camera(focal_px=600, aspect=1.02, skew_px=1.5, cx_px=322, cy_px=236)
SLIGHT = Misalignment(x_mm=1, y_mm=-0.6, z_mm=0.8, rotation_x_deg=0.5, rotation_y_deg=-0.4, rotation_z_deg=3)

small = st.floats(-3, 3)
misalignments = st.builds(
    Misalignment, x_mm=small, y_mm=small, z_mm=small, rotation_x_deg=small, rotation_y_deg=small, rotation_z_deg=small
)
mirrors = st.builds(Mirror, a_m=st.floats(0.02, 0.04), b_m=st.floats(0.015, 0.03))


def all_pixels(sensor: Sensor, step: int = 1) -> np.ndarray:
    camera = sensor.camera
    return np.stack(np.meshgrid(np.arange(0, camera.width_px, step), np.arange(0, camera.height_px, step)), axis=-1)


@pytest.mark.slow
@settings(deadline=None)  # the first call loads the compiled loops
@given(
    mirrors,
    st.sampled_from([Lens(), BENT]),
    st.sampled_from([Mount(), Mount(looks="up", yaw_deg=40), Mount(mirrored=False, roll_deg=25, pitch_deg=-100)]),
)
def test_without_misalignment_rays_are_the_central_ones(mirror: Mirror, lens: Lens, mount: Mount) -> None:
    rim = math.degrees(mirror.asymptote_rad) - 8
    low, high = (-75.0, min(rim, 20.0)) if mount.looks != "up" else (max(-rim, -20.0), 75.0)
    field = FieldOfView(elevation_min_deg=low, elevation_max_deg=high)
    sensor = Sensor(model=mirror, camera=ODD, lens=lens, mount=mount, field=field)
    pixels = all_pixels(sensor, 23)
    central, in_field = unproject(sensor, pixels)
    origins, directions, valid = reflect(sensor, pixels)
    np.testing.assert_array_equal(valid, in_field)
    # Sines of the angles between them; a ray is made of some 50 roundings of numbers of the size 2e/|P| < 10.
    assert np.linalg.norm(np.cross(directions, central), axis=-1)[valid].max() < 1e-13
    assert np.abs(np.linalg.norm(directions, axis=-1)[valid] - 1).max() < 1e-15
    # The line of the ray passes through the inner focus, which is the sensor's origin; metres.
    assert np.linalg.norm(np.cross(origins, directions), axis=-1)[valid].max() < 1e-15


def test_without_misalignment_the_same_pixels_are_valid() -> None:
    sensor = Sensor()
    np.testing.assert_array_equal(reflect(sensor, all_pixels(sensor))[2], pixel_directions(sensor)[1])


@settings(deadline=None)
@given(mirrors, misalignments, st.sampled_from([Lens(), BENT]))
def test_rays_obey_the_mirrors_equation_and_fermats_principle(
    mirror: Mirror, misalignment: Misalignment, lens: Lens
) -> None:
    field = FieldOfView(elevation_min_deg=-75, elevation_max_deg=min(math.degrees(mirror.asymptote_rad) - 10, 20))
    sensor = Sensor(model=mirror, camera=ODD, lens=lens, field=field, misalignment=misalignment)
    pixels = all_pixels(sensor, 37)
    origins, directions, valid = reflect(sensor, pixels)
    pixels, P, r = pixels[valid], origins[valid], directions[valid]
    assert len(P) > 2
    a, b, e = mirror.a_m, mirror.b_m, mirror.e_m
    assert (P[:, 2] + e > 0).all()
    # Of the order of (2e/b)² roundings.
    assert np.abs((P[:, 2] + e) ** 2 / a**2 - (P[:, 0] ** 2 + P[:, 1] ** 2) / b**2 - 1).max() < 1e-12
    # The camera, by its definition: it sees P at the pixel.
    C = np.array([misalignment.x_mm, misalignment.y_mm, misalignment.z_mm]) / 1000 - [0, 0, 2 * e]
    turn = Rotation.from_euler(
        "xyz",  # about fixed axes, one after the other
        [misalignment.rotation_x_deg, misalignment.rotation_y_deg, misalignment.rotation_z_deg],
        degrees=True,
    )
    q = turn.inv().apply(P - C)
    imaged = distort(lens, q[:, :2] / q[:, 2:])
    K = np.array([[ODD.focal_px, ODD.skew_px], [0, ODD.focal_px * ODD.aspect]])
    np.testing.assert_allclose(imaged @ K.T + [ODD.cx_px, ODD.cy_px], pixels, atol=1e-9)
    # The length of the path to a point on the ray does not change when P moves on the mirror: nothing but curvature.
    X, step = P + r, 1e-6
    for du, dv in ((step, 0.0), (0.0, step)):
        lengths = []
        for sign in (1, -1):
            x, y = P[:, 0] + sign * du, P[:, 1] + sign * dv
            moved = np.stack([x, y, a * np.sqrt(1 + (x * x + y * y) / b**2) - e], axis=-1)
            lengths.append(np.linalg.norm(moved - C, axis=-1) + np.linalg.norm(X - moved, axis=-1))
        # Two roundings of a length of 1 m over the step, and the third derivative, 1/(0.01 m)², times its square.
        assert np.abs(lengths[0] - lengths[1]).max() / (2 * step) < 1e-8


def test_a_turn_about_the_mirrors_axis_turns_the_image_alone() -> None:
    # A round mirror looks the same to a camera that is turned about its axis.
    turned = Sensor(misalignment=Misalignment(rotation_z_deg=30), camera=Camera(cx_px=320, cy_px=240))
    plain = turned.aligned
    pixels = np.array([[420.0, 270.0], [260.0, 360.0]])
    R = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    np.testing.assert_allclose(reflect(turned, pixels)[1], unproject(plain, pixels)[0] @ R.T, atol=1e-14)


def test_a_ray_in_a_mounted_sensor_is_the_same_one_turned() -> None:
    plain = Sensor(misalignment=SLIGHT)
    mounted = Sensor(misalignment=SLIGHT, mount=Mount(yaw_deg=30, pitch_deg=5, roll_deg=-20))
    pixels = all_pixels(plain, 31)
    M = model_from_sensor(mounted)
    for one, other in zip(reflect(plain, pixels)[:2], reflect(mounted, pixels)[:2], strict=True):
        np.testing.assert_allclose(other @ M.T, one, atol=1e-15)
    np.testing.assert_array_equal(reflect(plain, pixels)[2], reflect(mounted, pixels)[2])


def test_the_rim_stays_on_the_mirror_and_the_blind_disc_moves_with_the_camera() -> None:
    sensor = Sensor(misalignment=Misalignment(x_mm=1, rotation_y_deg=0.5))
    e, pixels = sensor.model.e_m, all_pixels(sensor)
    origins, directions, valid = reflect(sensor, pixels)
    P, r = origins[valid], directions[valid]
    rim = math.sin(math.radians(20))
    assert (P[:, 2] / np.linalg.norm(P, axis=-1)).max() == pytest.approx(rim, abs=2e-3)  # a pixel of the rim
    # The rays nearest to the camera pass it at the body's radius: 2e tan(15°) across its axis, turned by 0.5°.
    C, axis = np.array([0.001, 0, -2 * e]), np.array([math.sin(math.radians(0.5)), 0, math.cos(math.radians(0.5))])
    down = r @ axis < 0
    t = ((C - P[down]) @ axis) / (r[down] @ axis)
    passes = np.linalg.norm(P[down] + t[:, None] * r[down] - C, axis=-1)
    radius = 2 * e * math.tan(math.radians(15))
    assert radius <= passes.min() < radius * 1.01  # half a degree to a pixel there
    hidden = reflect(sensor, [sensor.camera.cx_px, sensor.camera.cy_px])
    assert np.isfinite(hidden[1]).all()
    assert not hidden[2]


def test_a_camera_that_looks_beside_the_mirror_sees_nothing() -> None:
    sensor = Sensor(misalignment=Misalignment(rotation_y_deg=50))
    origins, _, valid = reflect(sensor, [0.0, 240.0])
    assert np.isfinite(origins).all()
    assert not valid
    origins, directions, valid = reflect(sensor, [639.0, 240.0])
    assert np.isnan(origins).all()
    assert np.isnan(directions).all()
    assert not valid


def test_whatever_speaks_of_directions_alone_refuses_a_misaligned_sensor() -> None:
    sensor = Sensor(misalignment=SLIGHT)
    pixel = np.array([100.0])
    for asked in (
        lambda: project(sensor, [1, 0, 0]),
        lambda: jacobian(sensor, [1, 0, 0]),
        lambda: unproject(sensor, [100, 100]),
        lambda: rays_of(sensor, pixel, pixel),
        lambda: pixel_directions(sensor),
        lambda: optics_of(sensor),
    ):
        with pytest.raises(InputError, match=r"misalignment: camera and mirror are misaligned.*without \[misalign"):
            asked()
    assert not sensor.is_central
    assert sensor.aligned == Sensor()
    assert sensor.aligned.is_central


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"model": {"kind": "unified", "xi": 1}, "misalignment": {"y_mm": 1}},
            "misalignment.y_mm = 1: a unified (Mei) camera has no mirror",
        ),
        (
            {"misalignment": {"z_mm": 70}},
            "misalignment: the camera centre is inside the mirror, whose apex is 64.67 mm",
        ),
        ({"misalignment": {"x_mm": "a"}}, "sensor.toml: misalignment.x_mm: must be a number"),
        ({"misalignment": {"tilt_deg": 1}}, "sensor.toml: misalignment.tilt_deg: unknown key"),
        ({"misalignment": {"rotation_x_deg": 91}}, "sensor.toml: misalignment.rotation_x_deg: must be at most 90"),
    ],
)
def test_a_misalignment_that_cannot_be_is_refused_by_its_key(table: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message.replace(".", r"\.").replace("(", r"\(").replace(")", r"\)")):
        parse(Sensor, table, file="sensor.toml")


def test_a_lens_has_no_mirror_to_reflect_in() -> None:
    with pytest.raises(TypeError, match="is no hyperboloid mirror"):
        reflecting_camera(Sensor(model=Unified(xi=1), camera=Camera(focal_px=300)))


def test_a_sensor_file_keeps_it() -> None:
    sensor = Sensor(misalignment=SLIGHT)
    assert parse(Sensor, parse_toml(dump_toml(sensor))) == sensor


def test_a_trial_without_misalignment_keeps_its_name() -> None:
    scene = {
        "name": "a",
        "objects": [{"kind": "box", "size_m": [4, 4, 3], "inward": True, "texture": {"kind": "grey", "value": 90}}],
    }
    plain = parse(Trial, {"scene": scene})
    zero = parse(Trial, {"scene": scene, "sensor": {"misalignment": {"x_mm": 0}}})
    other = parse(Trial, {"scene": scene, "sensor": {"misalignment": {"x_mm": 1}}})
    second = parse(Trial, {"scene": scene, "sensor_2": {"misalignment": {"x_mm": 1}}})
    # As it was before there were misalignments.
    assert plain.key == zero.key == "83ee5867e60a78c4"
    assert len({plain.key, other.key, second.key}) == 3


def test_the_quick_form_gives_the_same_rays() -> None:
    sensor = Sensor(misalignment=SLIGHT)
    pixels = all_pixels(sensor, 40).reshape(-1, 2).astype(np.float64)
    origins, directions, valid = reflect(sensor, pixels)
    quick = reflected_rays(sensor, pixels[:, 0].copy(), pixels[:, 1].copy())
    np.testing.assert_array_equal(quick[0].T, origins)
    np.testing.assert_array_equal(quick[1].T, directions)
    np.testing.assert_array_equal(quick[2], valid)
