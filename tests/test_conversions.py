"""A mirror written in the unified model: against that model, against OpenCV, and the frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.camera.conversions import (
    UnifiedParameters,
    from_unified,
    mirrored_frame,
    to_unified,
    unified_lens,
)
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, distort
from harness.camera.models.hyperboloid import Mirror
from harness.camera.models.unified import Unified
from harness.camera.sensor import Sensor, pixel_directions, project, unproject
from harness.geometry.angles import normalise
from harness.geometry.pose import Pose, relative_motion

models = st.builds(
    UnifiedParameters,
    xi=st.floats(0.05, 2),
    gamma_u_px=st.floats(50, 2000),
    gamma_v_px=st.floats(50, 2000),
    cx_px=st.floats(200, 400),
    cy_px=st.floats(200, 400),
)

# From cv2.omnidir.projectPoints of OpenCV 5.0.0 (contrib): a point (X, Y, Z) in its frame, then the pixel (u, v).
OPENCV = UnifiedParameters(xi=0.93, gamma_u_px=150.0, gamma_v_px=163.5, cx_px=322.25, cy_px=236.75)
OPENCV_LENS = Lens(k1=-0.05, k2=0.012, p1=0.002, p2=-0.0015)
OPENCV_TABLE = np.array(
    [
        [1.0, 0.0, 0.3, 436.74377235007137, 236.95243790919946],
        [0.5, -2.0, 1.5, 341.2572092724589, 153.69308186652933],
        [-1.5, 0.25, -0.1, 158.17369141595938, 266.9384990981349],
        [0.2, 0.3, 0.9, 338.86474361759934, 263.94293498714677],
        [-0.7, -1.1, 0.05, 242.35083409354485, 100.65279649093003],
        [2.0, 2.0, 2.0, 378.8759554918283, 298.64019747101344],
        [0.0, 1.0, -0.2, 321.8483067814517, 445.8169741187586],
        [-3.0, 2.0, 0.4, 206.5124177169928, 321.0018945351057],
    ]
)


def random_sensor(rng: np.random.Generator, lens: Lens | None = None) -> Sensor:
    return Sensor(
        model=Mirror(a_m=rng.uniform(0.01, 0.05), b_m=rng.uniform(0.01, 0.05)),
        camera=Camera(
            focal_px=rng.uniform(300, 900),
            aspect=rng.uniform(0.8, 1.25),
            skew_px=rng.uniform(-20, 20),
            cx_px=rng.uniform(280, 360),
            cy_px=250.0,
        ),
        lens=lens or Lens(),
        field=FieldOfView(elevation_max_deg=5.0),
    )


def project_unified(unified: UnifiedParameters, directions, lens: Lens | None = None) -> np.ndarray:
    return project(unified_sensor(unified, lens), mirrored_frame(directions))[0]


def unproject_unified(unified: UnifiedParameters, pixels) -> np.ndarray:
    return mirrored_frame(unproject(unified_sensor(unified), pixels)[0])


def unified_sensor(unified: UnifiedParameters, lens: Lens | None = None) -> Sensor:
    """A sensor of the unified model, which sees along +z; a small field, as any model has it, for the pixels alone."""
    camera = Camera(
        focal_px=unified.gamma_u_px,
        aspect=unified.gamma_v_px / unified.gamma_u_px,
        skew_px=unified.skew_px,
        cx_px=unified.cx_px,
        cy_px=unified.cy_px,
    )
    field = FieldOfView(elevation_min_deg=80, elevation_max_deg=90)
    return Sensor(model=Unified(xi=unified.xi), camera=camera, lens=lens or Lens(), field=field)


@pytest.mark.parametrize("seed", range(20))
def test_mirror_and_unified_model_agree_over_the_image(seed: int) -> None:
    sensor = random_sensor(np.random.default_rng(seed))
    directions, valid = pixel_directions(sensor)
    unified = to_unified(sensor)
    v, u = np.nonzero(valid)
    pixels = np.stack([u, v], axis=-1)
    # Both are a dozen roundings of numbers below 1000.
    np.testing.assert_allclose(project_unified(unified, directions[valid]), pixels, rtol=0, atol=1e-9)
    np.testing.assert_allclose(unproject_unified(unified, pixels), directions[valid], rtol=0, atol=1e-12)


def test_opencv_projects_the_same() -> None:
    sensor = from_unified(OPENCV, 640, 480, lens=OPENCV_LENS, field=FieldOfView(elevation_max_deg=15.0))
    pixels, _ = project(sensor, mirrored_frame(OPENCV_TABLE[:, :3]))
    # Both in float64: OpenCV's last digits are the limit.
    np.testing.assert_allclose(pixels, OPENCV_TABLE[:, 3:], rtol=0, atol=1e-10)


@pytest.mark.parametrize("seed", range(10))
def test_lens_as_the_unified_model_writes_it(seed: int) -> None:
    """Mei's formula written out, sphere, plane and lens, and the model, against the mirror with its own lens."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(-0.05, 0.05, 5)
    sensor = random_sensor(rng, Lens(k1=k[0], k2=k[1], p1=k[2] / 10, p2=k[3] / 10, k3=k[4] / 10))
    directions, valid = pixel_directions(sensor)
    pixels, _ = project(sensor, directions[valid])
    unified = to_unified(sensor)
    sphere = mirrored_frame(directions[valid])
    plane = distort(unified_lens(sensor), sphere[:, :2] / (sphere[:, 2:] + unified.xi))
    K = [[unified.gamma_u_px, unified.skew_px], [0, unified.gamma_v_px]]
    expected = plane @ np.transpose(K) + [unified.cx_px, unified.cy_px]
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-9)
    same = project_unified(unified, directions[valid], unified_lens(sensor))
    np.testing.assert_allclose(pixels, same, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_sensor_round_trip(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = random_sensor(rng, Lens(k1=-0.01, k2=0.002, p1=0.001, p2=-0.001, k3=0.0003))
    camera = sensor.camera
    back = from_unified(
        to_unified(sensor),
        camera.width_px,
        camera.height_px,
        a_m=sensor.model.a_m,
        lens=unified_lens(sensor),
        field=sensor.field,
    )
    # xi near 1 hides the mirror's shape: eps from xi loses half the digits there, no more than 4 in this range.
    for mine, other in ((sensor.model, back.model), (camera, back.camera), (sensor.lens, back.lens)):
        numbers, expected = (each.model_dump(exclude={"kind"}) for each in (other, mine))
        assert numbers == pytest.approx(expected, rel=1e-11, abs=1e-14)


def test_size_of_the_mirror_is_not_in_the_image() -> None:
    small, large = (from_unified(OPENCV, 640, 480, a_m=a, field=FieldOfView(elevation_max_deg=15)) for a in (0.01, 1.0))
    directions = normalise(np.random.default_rng(0).normal(size=(100, 3)) * [1, 1, 0.2])
    np.testing.assert_allclose(project(small, directions)[0], project(large, directions)[0], rtol=0, atol=1e-9)


@given(models, st.integers(0, 2**32 - 1))
def test_unified_round_trip(unified: UnifiedParameters, seed: int) -> None:
    directions = normalise(np.random.default_rng(seed).normal(size=(100, 3)))
    # Up to 1 % from the last direction seen, beyond which rho grows, or its slope falls, without bound.
    directions = directions[directions[:, 2] < min(unified.xi, 1 / unified.xi) - 0.01]
    back = unproject_unified(unified, project_unified(unified, directions))
    np.testing.assert_allclose(back, directions, rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(back, axis=-1), 1, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("xi", "highest"), [(0.9, 0.9), (1.0, 1.0), (1.6, 1 / 1.6)])
def test_directions_that_have_no_pixel_of_their_own_are_nan(xi: float, highest: float) -> None:
    unified = OPENCV.model_copy(update={"xi": xi})
    z = highest + np.array([-1e-6, 1e-6])
    pixels = project_unified(unified, np.stack([np.sqrt(np.abs(1 - z**2)), 0 * z, z], axis=-1))
    assert not np.isnan(pixels[0]).any()
    if highest < 1:  # at xi = 1 every direction is seen but one
        assert np.isnan(pixels[1]).all()


def test_pixels_that_see_nothing_are_nan() -> None:
    unified = OPENCV.model_copy(update={"xi": 1.6})  # seen to r = 1/sqrt(xi² - 1) = 0.8
    directions = unproject_unified(unified, [[322.25 + 0.79 * 150, 236.75], [322.25 + 0.81 * 150, 236.75]])
    assert np.isnan(directions).any(axis=-1).tolist() == [False, True]


@pytest.mark.parametrize("xi", [1.0, 1.5])
def test_only_a_hyperboloid_becomes_a_sensor(xi: float) -> None:
    with pytest.raises(ValueError, match=f"xi = {xi:g} is not a hyperboloid mirror"):
        from_unified(OPENCV.model_copy(update={"xi": xi}), 640, 480)


class TestFrames:
    """The other libraries' frame is ours in a mirror: z turned over, and nothing else."""

    def test_axes(self) -> None:
        """+X moves right in the image, +Y down, +Z to the principal point: so it does in OpenCV's manual."""
        unified = to_unified(Sensor())
        u, v = project_unified(unified, mirrored_frame([[0.1, 0, 1], [0, 0.1, 1], [0, 0, 1]])).T
        centre = Sensor().camera.cx_px, Sensor().camera.cy_px
        assert u[0] > centre[0]
        assert v[1] > centre[1]
        assert (u[2], v[2]) == centre

    def test_no_rotation_leads_there(self) -> None:
        S = mirrored_frame(np.eye(3))
        assert np.linalg.det(S) == -1
        np.testing.assert_array_equal(mirrored_frame(S), np.eye(3))

    def test_pose_crosses_by_conjugation(self) -> None:
        motion = relative_motion(Pose(yaw_deg=30, roll_deg=4), Pose(position_m=(0.5, 0.1, 0.2), pitch_deg=-7))
        S = mirrored_frame(np.eye(3))
        R, t = S @ motion.R_v2_from_v1 @ S, mirrored_frame(motion.t_v1)
        points = np.random.default_rng(0).normal(size=(20, 3))
        there = (mirrored_frame(points) - t) @ R.T
        np.testing.assert_allclose(there, mirrored_frame(motion.apply(points)), rtol=0, atol=1e-15)
        assert np.linalg.det(R) == pytest.approx(1, abs=1e-15)  # a rotation again, not a mirroring
