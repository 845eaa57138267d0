"""Mirrors of any profile: their rays against closed forms, the law of reflection, and mirrors worked out otherwise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from harness.camera.central import best_central, central_of
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.misalignment import Misalignment
from harness.camera.models import Mirror, Unified
from harness.camera.mount import Mount
from harness.camera.profile import AnyProfile, Cone, Equiangular, Paraboloid, Sphere, Table
from harness.camera.profile_reflection import profile_camera, profile_heights, viewpoint_of
from harness.camera.reflection import project_points, reflect, reflected_pixels, reflected_rays
from harness.camera.sensor import Sensor, lens_from_sensor, model_from_sensor, unproject
from harness.errors import InputError
from harness.evaluation.propagation import Rig
from harness.geometry.pose import Motion
from harness.pipeline.believed import Believed, calibrated
from harness.pipeline.specification import Trial
from harness.simulation.scene import load_scene
from harness.spec import dump_toml, parse
from harness.toml import parse_toml

ALL_ROUND = FieldOfView(elevation_min_deg=-90, elevation_max_deg=90)
SLIGHT = Misalignment(x_mm=1, y_mm=-0.6, z_mm=0.8, rotation_x_deg=0.5, rotation_y_deg=-0.4, rotation_z_deg=3)
BENT = Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3)
SPHERE = Sphere(radius_m=0.03, rim_m=0.024, camera_m=0.06)
CONE = Cone(half_angle_deg=58, rim_m=0.03, camera_m=0.06)
PARABOLOID = Paraboloid(focal_length_m=0.012, rim_m=0.03, camera_m=0.08)
EQUIANGULAR = Equiangular(gain=5, rim_m=0.03, camera_m=0.0647)


def hyperboloid_table(mirror: Mirror, points: int) -> Table:
    """Its points, closer to each other towards the rim, where it is as flat as its cone."""
    r = np.linspace(0, 0.034, points)
    z = mirror.a_m * np.sqrt(1 + (r / mirror.b_m) ** 2) - mirror.a_m
    return Table(camera_m=mirror.a_m + mirror.e_m, r_mm=(1000 * r).tolist(), z_mm=(1000 * z).tolist())


PROFILES = {
    "sphere": SPHERE,
    "cone": CONE,
    "paraboloid": PARABOLOID,
    "equiangular": EQUIANGULAR,
    "table": hyperboloid_table(Mirror(), 200),
}
profiles = pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)


def all_pixels(step: int = 1) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(0.0, 640, step), np.arange(0.0, 480, step)), axis=-1)


def camera_rays(sensor: Sensor, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera centre `[3]` about the apex, and directions `[n, 3]` of length 1, in the mirror's frame; no lens."""
    K = np.array([[sensor.camera.focal_px, sensor.camera.skew_px, sensor.camera.cx_px], [0, 0, sensor.camera.cy_px]])
    K[1, 1] = sensor.camera.focal_px * sensor.camera.aspect
    K = np.vstack([K, [0, 0, 1]])
    d = (
        np.column_stack([pixels, np.ones(len(pixels))])
        @ np.linalg.inv(K).T
        @ sensor.misalignment.R_mirror_from_camera.T
    )
    centre = np.array([0, 0, -sensor.profile.camera_m]) + sensor.misalignment.offset_m
    return centre, d / np.linalg.norm(d, axis=-1, keepdims=True)


def in_mirror(sensor: Sensor, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`reflect` about the apex in the mirror's frame."""
    p, r, valid = reflect(sensor, pixels)
    M = model_from_sensor(sensor).T
    return p @ M + [0, 0, viewpoint_of(sensor)], r @ M, valid


# --- Mirrors with another derivation ------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.slow
def test_a_table_of_the_hyperboloid_gives_the_rays_of_its_closed_form():
    """The slopes of PCHIP are of second order in the points' distance: 1e-6 rad at 6,000 points, four times less at
    12,000."""
    sensor, pixels = Sensor(profile=hyperboloid_table(Mirror(), 6000)), all_pixels(3)
    origins, directions, valid = reflect(sensor, pixels)
    central, inside = unproject(Sensor(), pixels)
    # The origin is the inner focus, where all lines meet.
    assert viewpoint_of(sensor) == pytest.approx(Mirror().e_m - Mirror().a_m, abs=1e-9)
    both = valid & inside
    assert np.count_nonzero(valid != inside) <= 2  # on the very edge of the field
    apart = np.linalg.norm(directions - central, axis=-1)[both]
    assert apart.max() < 1e-6
    finer = reflect(Sensor(profile=hyperboloid_table(Mirror(), 12000)), pixels)[1]
    assert np.linalg.norm(finer - central, axis=-1)[both].max() < 0.35 * apart.max()
    off = np.linalg.norm(np.cross(origins[both], directions[both]), axis=-1)
    assert off.max() < 1e-7  # 1e-6 rad at 35 mm, twice over


@pytest.mark.slow
def test_a_misaligned_table_of_the_hyperboloid_is_the_misaligned_hyperboloid():
    table, pixels = hyperboloid_table(Mirror(), 6000), all_pixels(7)
    for lens in (Lens(), BENT):
        origins, directions, valid = reflect(Sensor(profile=table, misalignment=SLIGHT, lens=lens), pixels)
        others = reflect(Sensor(misalignment=SLIGHT, lens=lens), pixels)
        both = valid & others[2]
        assert both.mean() > 0.5
        assert np.linalg.norm(directions - others[1], axis=-1)[both].max() < 1e-6
        assert np.linalg.norm(origins - others[0], axis=-1)[both].max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("misalignment", [Misalignment(), SLIGHT], ids=["aligned", "misaligned"])
def test_a_sphere_against_its_quadratic(misalignment):
    """The nearer root of `|C + s d - (0, 0, R)| = R`, and the normal along the radius."""
    sensor = Sensor(profile=SPHERE, misalignment=misalignment, field=ALL_ROUND)
    pixels = all_pixels(13).reshape(-1, 2)
    p, r, valid = in_mirror(sensor, pixels)
    centre, d = camera_rays(sensor, pixels)
    R = SPHERE.radius_m
    from_middle = centre - [0, 0, R]
    b, c = d @ from_middle, from_middle @ from_middle - R**2
    with np.errstate(invalid="ignore"):
        s = -b - np.sqrt(b * b - c)
    point = centre + s[:, None] * d
    n = (point - [0, 0, R]) / R
    with np.errstate(invalid="ignore"):
        hit = (np.hypot(point[:, 0], point[:, 1]) <= SPHERE.rim_m) & (point[:, 2] < R)
    np.testing.assert_array_equal(valid, hit)
    assert valid.mean() > 0.3
    out = d - 2 * np.sum(d * n, axis=-1, keepdims=True) * n
    # Of rounding, 1e-16, magnified by the sphere's curvature and by rays that graze it.
    np.testing.assert_allclose(p[valid], point[valid], rtol=0, atol=1e-14)
    np.testing.assert_allclose(r[valid], out[valid], rtol=0, atol=1e-12)


def test_a_cone_against_a_plane_mirror_in_each_azimuth():
    """Without misalignment rays stay in the plane of their azimuth, as if they came from the camera's mirror image:
    the camera centre reflected at the line of the cone in that plane."""
    sensor = Sensor(profile=CONE, field=ALL_ROUND)
    pixels = all_pixels(13).reshape(-1, 2)
    p, r, valid = in_mirror(sensor, pixels)
    x, y = ((pixels - [319.5, 239.5]) / sensor.camera.focal_px).T
    phi, t = np.arctan2(y, x), np.arctan(np.hypot(x, y))
    half = math.radians(CONE.half_angle_deg)
    # Turned by 2 half about the apex: from straight down, h away.
    image_r, image_z = -CONE.camera_m * math.sin(2 * half), -CONE.camera_m * math.cos(2 * half)
    elevation = 2 * (np.pi / 2 - half) - np.pi / 2 + t
    out = np.stack([np.cos(elevation) * np.cos(phi), np.cos(elevation) * np.sin(phi), np.sin(elevation)], axis=-1)
    np.testing.assert_allclose(r[valid], out[valid], rtol=0, atol=1e-13)  # roundings
    # From the mirror image along the ray to the cone, by the law of sines: as far as from the camera.
    away = CONE.camera_m * math.sin(half) / np.sin(half - t)
    along = image_r + away * np.cos(elevation)
    point = np.stack([along * np.cos(phi), along * np.sin(phi), image_z + away * np.sin(elevation)], axis=-1)
    np.testing.assert_allclose(p[valid], point[valid], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(valid, along <= CONE.rim_m)


def test_the_elevation_of_an_equiangular_mirror_grows_in_proportion():
    sensor = Sensor(profile=EQUIANGULAR, field=ALL_ROUND)
    pixels = all_pixels(13).reshape(-1, 2)
    _, r, valid = in_mirror(sensor, pixels)
    x, y = ((pixels - [319.5, 239.5]) / sensor.camera.focal_px).T
    elevation = -np.pi / 2 + EQUIANGULAR.gain * np.arctan(np.hypot(x, y))
    assert valid.mean() > 0.5
    np.testing.assert_allclose(np.arcsin(r[valid, 2]), elevation[valid], rtol=0, atol=1e-9)  # of the cubics


# --- Any mirror ---------------------------------------------------------------------------------------------------


@profiles
def test_slopes_are_those_of_differences(profile):
    sensor = Sensor(profile=profile)
    r, step = np.linspace(0.1, 0.95, 400) * profile.rim_m, 1e-6 * profile.rim_m
    z, slope = profile_heights(sensor, r)
    by_difference = (profile_heights(sensor, r + step)[0] - profile_heights(sensor, r - step)[0]) / (2 * step)
    # Roundings of 1e-18 m over 5e-8 m, and for a table the jump of its second derivative: 0.2 mm of a bend of 30 mm.
    np.testing.assert_allclose(slope, by_difference, rtol=0, atol=1e-6 if profile.kind == "table" else 1e-9)
    assert (np.diff(z) > 0).all()


small = st.floats(-2, 2)
misalignments = st.builds(Misalignment, x_mm=small, y_mm=small, z_mm=small, rotation_x_deg=small, rotation_y_deg=small)
any_profile = st.one_of(
    st.sampled_from(list(PROFILES.values())),
    st.builds(Sphere, radius_m=st.floats(0.02, 1), rim_m=st.floats(0.005, 0.015), camera_m=st.floats(0.03, 0.2)),
    st.builds(Cone, half_angle_deg=st.floats(30, 85), rim_m=st.just(0.03), camera_m=st.floats(0.03, 0.2)),
    st.builds(Paraboloid, focal_length_m=st.floats(0.005, 1), rim_m=st.just(0.03), camera_m=st.floats(0.03, 0.2)),
    st.builds(Equiangular, gain=st.floats(1.5, 11), rim_m=st.just(0.01), camera_m=st.floats(0.06, 0.2)),
)


@settings(deadline=None)  # the first call loads the compiled loops
@given(any_profile, misalignments, st.sampled_from([Mount(), Mount(looks="up", yaw_deg=40, pitch_deg=7)]))
def test_rays_obey_the_law_of_reflection(profile: AnyProfile, misalignment: Misalignment, mount: Mount) -> None:
    """The point is on the profile and on the camera's ray, the normal of differences halves the angle, and the point is
    the first one of the surface that the camera's ray meets."""
    sensor = Sensor(profile=profile, misalignment=misalignment, field=ALL_ROUND, mount=mount)
    pixels = all_pixels(61).reshape(-1, 2) + 0.3
    p, r, valid = in_mirror(sensor, pixels)
    centre, d = camera_rays(sensor, pixels)
    p, r, d = p[valid], r[valid], d[valid]
    if not len(p):
        return
    radius = np.hypot(p[:, 0], p[:, 1])
    np.testing.assert_allclose(profile_heights(sensor, radius)[0], p[:, 2], rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.cross(p - centre, d), 0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(r, axis=-1), 1, rtol=1e-14)
    n = r - d  # along the normal, as both are of length 1
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    assert (n[:, 2] < 0).all()  # towards the camera
    step = 1e-7
    smooth = radius > 10 * step
    for across in (np.array([step, 0]), np.array([0, step])):
        on_both_sides = [profile_heights(sensor, np.hypot(*(p[:, :2] + sign * across).T))[0] for sign in (1, -1)]
        tangent = np.column_stack([np.broadcast_to(2 * across, (len(p), 2)), on_both_sides[0] - on_both_sides[1]])
        along = np.sum(n * tangent, axis=-1) / np.linalg.norm(tangent, axis=-1)
        # Roundings of 1e-17 m over 1e-7 m; a table's second derivative jumps, and a sphere's rim bends within a step.
        assert np.abs(along[smooth]).max(initial=0) < 1e-6
    for part in (0.3, 0.9, 0.99):
        between = centre + part * (p - centre)
        assert (between[:, 2] < profile_heights(sensor, np.hypot(*between[:, :2].T))[0]).all()


@pytest.mark.parametrize("misalignment", [Misalignment(), SLIGHT], ids=["aligned", "misaligned"])
@profiles
def test_a_ray_does_not_depend_on_which_others_are_computed_with_it(profile, misalignment):
    """To the last bit: blocks, and the rays that are left to one-by-one iteration, are no part of the result."""
    sensor = Sensor(profile=profile, misalignment=misalignment, field=ALL_ROUND)
    u, v = all_pixels(17).reshape(-1, 2).T.copy()
    together, _, _ = reflected_rays(sensor, u, v)
    some = np.arange(3, u.size, 7)
    apart, _, _ = reflected_rays(sensor, u[some], v[some])
    np.testing.assert_array_equal(together[:, some], apart)


def test_points_of_a_table_may_be_close_in_places():
    """Where its radius cannot be looked up in even parts of one point each, every ray is iterated by itself."""
    r = np.sort(np.append(np.linspace(0, 34, 400), 20 + 1e-6 * np.arange(1, 9)))
    mirror, pixels = Mirror(), all_pixels(19)

    def table(r: np.ndarray) -> Table:
        z = 28.1 * np.hypot(1, r / 23.4) - 28.1
        return Table(camera_m=mirror.a_m + mirror.e_m, r_mm=r.tolist(), z_mm=z.tolist())

    even, uneven = table(np.linspace(0, 34, 400)), table(r)
    assert profile_camera(Sensor(profile=even)).sparse
    assert not profile_camera(Sensor(profile=uneven)).sparse
    given = {"viewpoint_m": 0.0}
    rays = [
        in_mirror(Sensor(profile=each.model_copy(update=given), field=ALL_ROUND), pixels) for each in (even, uneven)
    ]
    (p, first, valid), (_, second, also) = rays
    np.testing.assert_array_equal(valid, also)
    apart = np.linalg.norm(first - second, axis=-1)[valid]
    beside = np.abs(np.hypot(p[..., 0], p[..., 1])[valid] - 0.02) > 3e-4
    assert 0 < np.count_nonzero(~beside) < 0.1 * beside.size
    assert apart[beside].max() < 1e-12  # roundings: PCHIP's slopes follow from a point's neighbours alone
    assert apart.max() < 3e-3  # of slopes that are taken from one side, 0.09 mm of a bend of 30 mm


def test_a_mirror_that_is_not_convex():
    """Newton's steps overshoot there; the roots are those of bisection on the same profile."""
    r = np.linspace(0, 30, 61)
    table = Table(camera_m=0.07, r_mm=r.tolist(), z_mm=(0.01 * r**2 + 0.2 * np.sin(r) ** 2 + 0.25 * r).tolist())
    sensor = Sensor(profile=table, field=ALL_ROUND)
    pixels = np.column_stack([np.linspace(320, 560, 200), np.full(200, 239.5)])
    p, _, valid = in_mirror(sensor, pixels)
    _, d = camera_rays(sensor, pixels)
    assert valid.sum() > 100

    def above(s: float, ray: np.ndarray) -> float:
        return float(s * ray[2] - 0.07 - profile_heights(sensor, abs(s * ray[0]))[0])

    for point, ray in zip(p[valid], d[valid], strict=True):
        s = brentq(above, 0, 0.2, args=(ray,), xtol=1e-16)
        assert point[0] == pytest.approx(s * ray[0], abs=1e-12)


# --- The nearest central sensor -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_table_of_the_hyperboloid_has_a_central_sensor():
    best = best_central(Sensor(profile=hyperboloid_table(Mirror(), 3000)))
    assert best.rms_px < 1e-3
    pixels = all_pixels(11)
    central, inside = unproject(best.sensor, pixels)
    apart = np.linalg.norm(central - unproject(Sensor(), pixels)[0], axis=-1)[inside]
    assert apart.max() < 1e-4  # the polynomial's


@pytest.mark.long
@pytest.mark.slow
@profiles
def test_residuals_are_those_of_the_points_at_that_distance(profile):
    sensor = Sensor(profile=profile, mount=Mount(yaw_deg=20, pitch_deg=5), camera=Camera(aspect=1.02, skew_px=1.5))
    best = best_central(sensor, 2.0)
    assert best.sensor.is_central
    assert lens_from_sensor(best.sensor) == pytest.approx(lens_from_sensor(sensor))
    assert best.rms_px < 0.1
    origins, directions, valid = reflected_pixels(sensor)
    assert best.left_out < 0.05
    rows, columns = np.nonzero(valid)
    p, r = origins[valid], directions[valid]
    # The point 2 m from the origin, by stepping along the ray.
    s = np.full(len(p), 2.0)
    for _ in range(20):
        s += 2.0 - np.linalg.norm(p + s[:, None] * r, axis=-1)
    point = (p + s[:, None] * r) / 2
    told, inside = unproject(best.sensor, np.stack([columns, rows], axis=-1).astype(float))
    apart = np.degrees(np.linalg.norm(told - point, axis=-1))[inside]
    assert inside.mean() > 0.9
    # Of a few thousand pixels instead of all.
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(best.rms_deg, rel=0.2, abs=1e-9)
    assert best.at(sensor, 1.0).rms_deg > (1.5 * best.rms_deg if profile.kind != "table" else 0)


# --- A sensor file ------------------------------------------------------------------------------------------------


@profiles
def test_a_file_and_back(profile):
    sensor = Sensor(profile=profile, misalignment=Misalignment(x_mm=1))
    assert parse(Sensor, parse_toml(dump_toml(sensor))) == sensor


@pytest.mark.slow
def test_a_trial_is_told_the_central_sensor_and_keeps_its_key_without_a_profile():
    box = load_scene("box")
    trial = Trial(scene=box, sensor=Sensor(profile=SPHERE, misalignment=SLIGHT))
    assert trial.assumed_sensors[0] == best_central(Sensor(profile=SPHERE)).sensor
    assert trial.key != Trial(scene=box, sensor=Sensor(misalignment=SLIGHT)).key
    assert "profile" not in dump_toml(Sensor())
    assert central_of(Sensor()) == Sensor()
    assert central_of(Sensor(misalignment=SLIGHT)) == Sensor()


@pytest.mark.slow
def test_the_best_calibration_of_an_aligned_profile_is_the_nearest_central_sensor():
    motion = Motion(R_v2_from_v1=np.eye(3), t_v1=np.array([0.5, 0, 0]))
    true = Rig((Sensor(profile=CONE), Sensor()), motion)
    for alignment in ("nominal", "central"):
        believed = calibrated(true, Believed(alignment=alignment))
        assert believed.sensors == (best_central(Sensor(profile=CONE)).sensor, Sensor())
    off = Rig((Sensor(profile=CONE, misalignment=SLIGHT), Sensor()), motion)
    with pytest.raises(InputError, match="is for hyperboloid mirrors"):
        calibrated(off, Believed(alignment="central"))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"profile": {"kind": "sphere", "radius_m": 0.02, "rim_m": 0.02, "camera_m": 0.1}}, "equator"),
        ({"profile": {"kind": "ball", "radius_m": 0.02}}, "kind"),
        ({"profile": SPHERE, "model": Unified(xi=1.0)}, "leave one out"),
        ({"profile": SPHERE, "camera": {"focal_px": "fit"}}, "give it in pixels"),
        ({"profile": SPHERE, "misalignment": {"z_mm": 60}}, "not below the mirror's apex"),
        ({"profile": {"kind": "equiangular", "gain": 11, "rim_m": 0.1, "camera_m": 0.1}}, "asymptote"),
        ({"profile": {"kind": "table", "camera_m": 0.1, "r_mm": [0, 1, 2, 2], "z_mm": [0, 1, 2, 3]}}, "r_mm must"),
        ({"profile": {"kind": "table", "camera_m": 0.1, "r_mm": [0, 1, 2, 3], "z_mm": [0, 1, 1, 3]}}, "z_mm must"),
        ({"profile": {"kind": "table", "camera_m": 0.1, "r_mm": [1, 2, 3, 4], "z_mm": [0, 1, 2, 3]}}, "at 0"),
        (
            {"profile": {"kind": "table", "camera_m": 0.1, "r_mm": [0, 1, 2, 3], "z_mm": [0, 1, 2, 3, 4]}},
            "equally many",
        ),
    ],
)
def test_what_is_no_mirror_is_refused(table, said):
    with pytest.raises(InputError, match=said):
        parse(Sensor, table)


def test_a_trial_has_no_error_budget():
    with pytest.raises(ValueError, match="not propagated through a conical mirror"):
        Trial(scene=load_scene("box"), sensor=Sensor(profile=CONE), scoring={"budget": True})


@profiles
def test_a_pixel_beyond_the_fold_of_the_lens_has_no_ray(profile):
    # Its ray is NaN before it reaches the mirror, and must not be looked up in a profile's pieces.
    sensor = Sensor(profile=profile, camera=Camera(focal_px=200), lens=Lens(k1=-1.0), field=ALL_ROUND)
    origins, directions, valid = reflect(sensor, all_pixels(8))
    folded = np.isnan(directions[..., 0])
    assert folded[0, 0]
    assert not folded[30, 40]
    assert np.isnan(origins[folded]).all()
    assert not valid[folded].any()
    assert np.isfinite(origins[~folded]).all()


def test_a_mirror_larger_than_the_distance_of_its_central_sensor_is_refused():
    sensor = Sensor(profile=Sphere(radius_m=9, rim_m=7, camera_m=10))
    with pytest.raises(InputError, match=r"profile: the mirror reaches \d.* m from its origin"):
        best_central(sensor)
    trial = {"scene": load_scene("box").model_dump(), "panorama": {"z_min": "auto", "z_max": "auto"}}
    with pytest.raises(InputError, match=r"trial: panorama: profile: the mirror reaches"):
        parse(Trial, trial | {"sensor": sensor.model_dump()}, key="trial")


def test_what_needs_a_viewpoint_or_a_projection_is_refused():
    sensor = Sensor(profile=SPHERE)
    with pytest.raises(InputError, match="spherical mirror meet in no viewpoint"):
        unproject(sensor, [[0, 0]])
    with pytest.raises(InputError, match="hyperboloid mirror is needed"):
        project_points(sensor, [[1, 0, 0]])
