"""Points seen in a misaligned mirror: against Fermat's principle in many digits, and against their pixels' rays."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from harness.camera._projection_kernels import differentiate_all, project_all
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, distort
from harness.camera.misalignment import Misalignment
from harness.camera.models import Mirror
from harness.camera.mount import Mount
from harness.camera.reflection import camera_of_points, points_jacobian, project_points, reflect
from harness.camera.sensor import Sensor, jacobian, project

BENT = Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3)
ODD = Camera(focal_px=600, aspect=1.02, skew_px=1.5, cx_px=322, cy_px=236)
SLIGHT = Misalignment(x_mm=1, y_mm=-0.6, z_mm=0.8, rotation_x_deg=0.5, rotation_y_deg=-0.4, rotation_z_deg=3)

small = st.floats(-3, 3)
misalignments = st.builds(
    Misalignment, x_mm=small, y_mm=small, z_mm=small, rotation_x_deg=small, rotation_y_deg=small, rotation_z_deg=small
)


@st.composite
def sensors(draw: st.DrawFn) -> Sensor:
    mirror = Mirror(a_m=draw(st.floats(0.02, 0.04)), b_m=draw(st.floats(0.015, 0.03)))
    field = FieldOfView(elevation_min_deg=-75, elevation_max_deg=min(math.degrees(mirror.asymptote_rad) - 10, 20))
    return Sensor(
        model=mirror,
        camera=ODD,
        lens=draw(st.sampled_from([Lens(), BENT])),
        field=field,
        misalignment=draw(misalignments),
    )


def lattice(step: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(10, 640, step), np.arange(10, 480, step)), axis=-1).reshape(-1, 2)


@settings(deadline=None)  # the first call loads the compiled loops
@given(sensors(), st.floats(0.05, 100))
def test_a_point_on_a_pixels_ray_is_seen_at_that_pixel(sensor: Sensor, range_m: float) -> None:
    pixels = lattice(37)
    origins, directions, valid = reflect(sensor, pixels)
    again, visible = project_points(sensor, origins + range_m * directions)
    # Angles are right to a few roundings, of numbers up to 100 m over 1 cm of mirror; there are 600 px to a radian.
    np.testing.assert_allclose(again[valid], pixels[valid], atol=1e-9)
    np.testing.assert_array_equal(visible, valid)


def shortest_path_pixel(sensor: Sensor, point: np.ndarray) -> np.ndarray:
    """The pixel by way of the mirror's point with the shortest path, in 40 digits; derivatives are differences."""
    mirror, misalignment = sensor.model, sensor.misalignment
    assert isinstance(mirror, Mirror)
    with localcontext(prec=40):
        a, b = Decimal(mirror.a_m), Decimal(mirror.b_m)
        e = (a * a + b * b).sqrt()
        X = [Decimal(each) for each in point.tolist()]
        offset = (Decimal(getattr(misalignment, f"{axis}_mm")) / 1000 for axis in "xyz")
        C = [one + other for one, other in zip(offset, (0, 0, -2 * e), strict=True)]

        def surface(x: Decimal, y: Decimal) -> list[Decimal]:
            return [x, y, a * (1 + (x * x + y * y) / (b * b)).sqrt() - e]

        def length(x: Decimal, y: Decimal) -> Decimal:
            P = surface(x, y)
            squares = (sum((p - q) ** 2 for p, q in zip(P, end, strict=True)) for end in (C, X))
            return sum((each.sqrt() for each in squares), Decimal(0))

        h = Decimal("1e-12")
        norm = sum(each * each for each in X).sqrt()
        scale = b * b / (a * norm - e * X[2])
        x, y = scale * X[0], scale * X[1]
        for _ in range(30):
            middle = length(x, y)
            right, left, up, down = length(x + h, y), length(x - h, y), length(x, y + h), length(x, y - h)
            g_x, g_y = (right - left) / (2 * h), (up - down) / (2 * h)
            h_xx, h_yy = (right + left - 2 * middle) / (h * h), (up + down - 2 * middle) / (h * h)
            h_xy = (length(x + h, y + h) - length(x + h, y) - length(x, y + h) + middle) / (h * h)
            determinant = h_xx * h_yy - h_xy * h_xy
            assert h_xx > 0
            assert determinant > 0, "no minimum"
            step = (h_yy * g_x - h_xy * g_y) / determinant, (h_xx * g_y - h_xy * g_x) / determinant
            x, y = x - step[0], y - step[1]
            if max(map(abs, step)) < Decimal("1e-22"):
                break
        else:
            raise AssertionError("did not converge")
        from_camera = np.array([float(p - c) for p, c in zip(surface(x, y), C, strict=True)])
    angles = [misalignment.rotation_x_deg, misalignment.rotation_y_deg, misalignment.rotation_z_deg]
    q = Rotation.from_euler("xyz", angles, degrees=True).inv().apply(from_camera)
    m, n = distort(sensor.lens, q[:2] / q[2])
    camera = sensor.camera
    u = camera.focal_px * m + camera.skew_px * n + camera.cx_px
    return np.array([u, camera.focal_px * camera.aspect * n + camera.cy_px])


@pytest.mark.slow
@settings(deadline=None)
@given(sensors(), st.floats(0.05, 20), st.floats(-math.pi, math.pi), st.floats(-1.2, 0.2))
def test_the_pixel_is_that_of_the_shortest_path(
    sensor: Sensor, range_m: float, azimuth: float, elevation: float
) -> None:
    level = math.cos(elevation)
    point = range_m * np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    pixel, _ = project_points(sensor, point)
    if np.isfinite(pixel).all():  # beyond the mirror's asymptote, or the lens's fold, there is none
        np.testing.assert_allclose(pixel, shortest_path_pixel(sensor, point), atol=1e-9)


def test_most_of_those_points_have_a_pixel() -> None:
    sensor = Sensor(camera=ODD, misalignment=SLIGHT, lens=BENT)
    rng = np.random.default_rng(1)
    elevation, azimuth = rng.uniform(-1.2, 0.2, 1000), rng.uniform(-np.pi, np.pi, 1000)
    level = np.cos(elevation)
    points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    assert project_points(sensor, points)[1].mean() > 0.95
    # Seen from far away a millimetre is nothing, but the tilt is: a sensor with another calibration.
    assert np.nanmax(np.abs(project_points(sensor, 1e6 * points)[0] - project_points(sensor, 1e7 * points)[0])) < 1e-4


@pytest.mark.slow
@settings(deadline=None)
@given(sensors(), st.floats(0.1, 10))
def test_derivatives_are_those_of_differences(sensor: Sensor, range_m: float) -> None:
    origins, directions, valid = reflect(sensor, lattice(61))
    points = (origins + range_m * directions)[valid]
    by_point, by_misalignment = points_jacobian(sensor, points)
    # Central differences: the error is the step squared, relative to a size of some 2 cm, and 1e-11 px over the step.
    step = 1e-5 * range_m
    for k in range(3):
        moved = step * np.eye(3)[k]
        numeric = (project_points(sensor, points + moved)[0] - project_points(sensor, points - moved)[0]) / (2 * step)
        np.testing.assert_allclose(by_point[..., k] * range_m, numeric * range_m, rtol=1e-5, atol=1e-4)
    for k, (name, value) in enumerate(dict(sensor.misalignment).items()):
        sides = [
            sensor.model_copy(
                update={"misalignment": sensor.misalignment.model_copy(update={name: value + sign * 1e-3})}
            )
            for sign in (1, -1)
        ]
        numeric = (project_points(sides[0], points)[0] - project_points(sides[1], points)[0]) / 2e-3
        np.testing.assert_allclose(by_misalignment[..., k], numeric, rtol=1e-5, atol=1e-5)


def test_compiled_projections_take_points() -> None:
    sensor = Sensor(camera=ODD, misalignment=SLIGHT, mount=Mount(yaw_deg=20, pitch_deg=10))
    origins, directions, valid = reflect(sensor, lattice(61))
    points = np.ascontiguousarray((origins + 0.3 * directions)[valid])
    pixels, D = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    camera = camera_of_points(sensor)
    project_all(points, camera, pixels)
    differentiate_all(points, camera, D)
    np.testing.assert_array_equal(pixels, project_points(sensor, points)[0])
    np.testing.assert_allclose(D, points_jacobian(sensor, points)[0], rtol=1e-9, atol=1e-9)


def test_of_a_central_sensor_points_are_directions() -> None:
    sensor = Sensor(camera=ODD, lens=BENT)
    points = reflect(sensor, lattice(61))
    points, valid = (points[0] + 0.7 * points[1])[points[2]], points[2]
    assert valid.any()
    np.testing.assert_array_equal(project_points(sensor, points)[0], project(sensor, points)[0])
    np.testing.assert_allclose(points_jacobian(sensor, points)[0], jacobian(sensor, points), rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("point", [(0.0, 0.0, 1.0), (0.01, 0.0, 0.5)])
def test_nothing_is_seen_behind_the_mirror(point: tuple[float, float, float]) -> None:
    pixels, valid = project_points(Sensor(misalignment=SLIGHT), point)
    assert np.isnan(pixels).all()
    assert not valid
