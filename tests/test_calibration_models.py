"""Every kind of camera model is calibrated from corners alone, without a start, to the rays that they came from."""

from dataclasses import replace

import numpy as np
import pytest
from boards import MIRROR, UNIFIED, noisy, visible_boards
from cameras import random_sensor
from repeats import few

from harness.calibration.sensor_calibration import calibrate_sensor
from harness.calibration.uncertainty import ray_difference
from harness.camera.mount import Mount
from harness.camera.sensor import model_from_sensor, project, unproject

KINDS = ("unified", "eucm", "double_sphere", "kannala_brandt", "ocam")


def check(kind: str, seed: int, boards: int = 10) -> None:
    sensor = random_sensor(kind, seed)
    exact, _ = visible_boards(sensor, boards, seed)
    calibration = calibrate_sensor(exact, kind)
    assert calibration.left_out is None
    assert calibration.rms_px < 1e-6
    assert np.nanmax(np.linalg.norm(ray_difference(calibration.sensor, sensor, calibration.grid), axis=-1)) < 1e-5
    calibration = calibrate_sensor(noisy(exact, 0.1, seed), kind)
    error = np.linalg.norm(ray_difference(calibration.sensor, sensor, calibration.grid), axis=-1)
    # The errors over the field go together: half of all calibrations are within one, nearly all within three.
    assert np.sqrt(np.nanmean(error**2)) < 3 * np.sqrt(np.mean(calibration.ray_sigma_px**2))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_rays_without_and_with_noise(kind):
    check(kind, 1, 5)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 6))
@pytest.mark.parametrize("kind", KINDS)
def test_more_sensors(kind, seed):
    check(kind, seed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", few(2, ["ocam", "double_sphere", "eucm"]))
def test_one_model_stands_for_another(kind):
    """A mirror without a lens is exactly EUCM and double sphere, and nearly a polynomial."""
    corners, _ = visible_boards(MIRROR, 8, 3)
    calibration = calibrate_sensor(corners, kind, mount=Mount(looks="down", mirrored=True))
    assert calibration.rms_px < {"ocam": 0.2}.get(kind, 1e-6)
    off = np.linalg.norm(project(calibration.sensor, unproject(MIRROR, corners.pixels)[0])[0] - corners.pixels, axis=-1)
    # A principal point off by the width of a turn: the frames differ by it, which is no error of the rays.
    assert np.nanmax(off) < {"ocam": 3.0}.get(kind, 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "mount",
    few(
        2,
        [
            Mount(looks="down", mirrored=True),
            Mount(looks="forward", yaw_deg=20, pitch_deg=-5),
            Mount(looks="up", mirrored=True),
        ],
    ),
    ids=str,
)
def test_mount_is_taken_over_and_changes_nothing_but_frames(mount):
    corners = noisy(visible_boards(UNIFIED, 6, 4)[0], 0.1, 1)
    plain = calibrate_sensor(corners, "unified")
    mounted = calibrate_sensor(corners, "unified", mount=mount)
    assert mounted.sensor.mount == mount
    assert mounted.rms_px == plain.rms_px
    np.testing.assert_array_equal(mounted.uncertainty.values, plain.uncertainty.values)
    # Boards stand where the mounted sensor sees their corners, and rotations stay rotations.
    pixels, valid = project(mounted.sensor, mounted.poses.apply(mounted.corners)[1])
    assert valid.all()
    np.testing.assert_allclose(pixels - corners.pixels, mounted.residuals, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.linalg.det(mounted.poses.R), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        mounted.grid.directions, unproject(mounted.sensor, _inside(mounted))[0] @ model_from_sensor(mounted.sensor).T,
        rtol=0, atol=1e-12,
    )  # fmt: skip


def _inside(calibration):
    grid = calibration.grid
    return np.stack(np.meshgrid(grid.u, grid.v), axis=-1)[grid.inside]


def test_start_with_a_mount_lends_it():
    corners, _ = visible_boards(UNIFIED, 4, 5)
    start = UNIFIED.model_copy(update={"mount": Mount(looks="up", yaw_deg=30)})
    calibration = calibrate_sensor(replace(corners), "unified", start=start)
    assert calibration.sensor.mount == start.mount
