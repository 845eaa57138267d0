"""Calibration of a camera that is misaligned with its mirror, against the truth."""

import numpy as np
import pytest
from boards import noisy, visible_boards

from harness.calibration.adjust import adjust
from harness.calibration.misaligned import significance
from harness.calibration.parameters import MISALIGNMENT, Parameters, apex_in, choose_keys, value_of
from harness.calibration.sensor_calibration import SensorCalibration, calibrate_sensor
from harness.calibration.uncertainty import ray_difference, ray_grid, ray_sigma, uncertainty_of
from harness.camera.misalignment import Misalignment
from harness.camera.models import Unified
from harness.camera.reflection import project_points
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.simulation.scene import load_scene
from harness.simulation.targets import visible_boards as boards_of

TRUE = Sensor(misalignment=Misalignment(x_mm=0.6, y_mm=-0.8, z_mm=0.5, rotation_x_deg=0.3, rotation_y_deg=-0.4))
"""1 mm beside the axis and half a degree askew."""
NOISE_PX, DRAWS = 0.1, 100
KEYS = choose_keys(TRUE, free=["misalignment"])


@pytest.fixture(scope="module")
def calibration() -> SensorCalibration:
    return calibrate_sensor(noisy(visible_boards(TRUE, 10, 30)[0], NOISE_PX, 1), "hyperboloid", free=["misalignment"])


def scores(calibration: SensorCalibration, truth: Sensor) -> np.ndarray:
    values = [value_of(truth, key) for key in calibration.keys]
    return (calibration.uncertainty.values - values) / calibration.uncertainty.sigma


def test_all_numbers_are_within_three_standard_deviations(calibration):
    assert calibration.keys == KEYS
    assert KEYS[-5:] == tuple(f"misalignment.{name}" for name in MISALIGNMENT)
    assert np.abs(scores(calibration, TRUE)).max() < 3
    # 2 x 540 residuals less 10 numbers and 60 of the boards' poses; the root of their mean scatters by 2.2 %.
    expected = NOISE_PX * np.sqrt(2 * (1 - 70 / 1080))
    assert calibration.rms_px == pytest.approx(expected, rel=0.08)
    assert calibration.left_out is None
    assert calibration.sensor.misalignment.rotation_z_deg == 0


def test_rays_are_as_near_to_the_truth_as_they_claim(calibration):
    error = ray_difference(calibration.sensor, TRUE, calibration.grid)
    square = np.sum(error**2, axis=-1)
    predicted = calibration.ray_sigma_px**2
    # One draw of a few modes over the field.
    assert 0.3 < np.sqrt(square.mean() / predicted.mean()) < 2
    assert np.median(np.sqrt(square)) < 0.1


def test_the_best_central_sensor_leaves_several_times_as_much(calibration):
    central = calibration.central
    assert central.sensor.is_central
    assert central.sensor.field == calibration.sensor.field
    assert central.rms_px > 2 * calibration.rms_px
    # The same by adjusting a central sensor to corners without noise.
    exact, poses = visible_boards(TRUE, 10, 30)
    plain = Parameters(TRUE.aligned, choose_keys(TRUE))
    best = adjust(plain, exact, plain.vector(TRUE.aligned), poses)
    left = np.sqrt(np.mean(np.sum(best.residuals**2, axis=-1)))
    assert left == pytest.approx(0.35, abs=0.1)  # of boards 8 to 25 cm away, 1 mm and half a degree
    assert central.rms_px == pytest.approx(np.hypot(left, NOISE_PX * np.sqrt(2 * 0.94)), rel=0.05)


def test_what_trades_off_is_said(calibration):
    notes = "\n".join(calibration.notes)
    assert "a_m = 0.0281; fix a_m to give it" in notes
    assert "rotation_z_deg, about the mirror's axis, was held" in notes
    # Turning a camera shifts its image, as another principal point does; nearer to the mirror all is larger.
    assert "rotation_x_deg and cy_px (-0.99" in notes
    assert "rotation_y_deg and cx_px (0.99" in notes
    assert "z_mm and focal_px (-0.99" in notes


def test_with_a_known_camera_the_mirror_is_known_to_a_few_micrometres():
    corners = noisy(visible_boards(TRUE, 8, 31)[0], NOISE_PX, 2)
    known = {"focal_px": 614.12, "aspect": 1.0, "cx_px": 319.5, "cy_px": 239.5}
    calibration = calibrate_sensor(corners, "hyperboloid", free=["misalignment"], fix=known, start=TRUE.aligned)
    assert np.abs(scores(calibration, TRUE)).max() < 3
    sigma = dict(zip(calibration.keys, calibration.uncertainty.sigma, strict=True))
    assert sigma["misalignment.x_mm"] < 0.02
    assert sigma["misalignment.rotation_x_deg"] < 0.02


@pytest.mark.slow
def test_a_sensor_that_is_aligned_is_said_to_be():
    corners = noisy(visible_boards(TRUE.aligned, 8, 32)[0], NOISE_PX, 3)
    calibration = calibrate_sensor(corners, "hyperboloid", free=["misalignment"])
    assert any("no significant misalignment" in note for note in calibration.notes)
    assert np.abs(scores(calibration, TRUE.aligned)).max() < 3.5


@pytest.mark.long
@pytest.mark.slow
def test_far_boards_of_an_aligned_camera_show_no_misalignment():
    # Farther than 0.3 m the numbers are so weakly determined that their covariance alone calls half of these cameras
    # misaligned. The ratio is chi-squared with 5 degrees of freedom: mean 5 +- 3.2; 10 draws or more of 12 are below
    # its 95 % point with a probability of 98 %, and these seeds are.
    calibrations = []
    for draw in range(12):
        corners = noisy(visible_boards(TRUE.aligned, 15, 60 + draw, range_m=(0.3, 0.5))[0], NOISE_PX, 600 + draw)
        calibrations.append(calibrate_sensor(corners, "hyperboloid", free=["misalignment"]))
    aligned = ["no significant misalignment" in "\n".join(each.notes) for each in calibrations]
    assert sum(aligned) >= 10
    # Independent of the covariance: the two fits' own residuals.
    freedom = calibrations[0].residuals.size - 10 - 6 * 15
    ratio = [
        freedom * (each.central.rms_px**2 / each.rms_px**2 - 1) if each.left_out is None else np.nan
        for each in calibrations
    ]
    assert np.nanmean(ratio) == pytest.approx(5, abs=3 * 3.2 / np.sqrt(12))
    doubted = ["deviations of the misalignment" in "\n".join(each.notes) for each in calibrations]
    assert any(doubted)
    assert not any(doubt and not fine for doubt, fine in zip(doubted, aligned, strict=True))
    for each, doubt, fine in zip(calibrations, doubted, aligned, strict=True):
        assert doubt == (fine and significance(each.keys, each.uncertainty) >= 11.07)


@pytest.mark.slow
def test_exact_corners_of_three_boards_lead_to_a_gross_misalignment():
    misalignment = Misalignment(x_mm=4, y_mm=3, z_mm=-3, rotation_x_deg=2, rotation_y_deg=-3)
    askew = Sensor(misalignment=misalignment)
    calibration = calibrate_sensor(visible_boards(askew, 3, 30)[0], "hyperboloid", free=["misalignment"])
    # Rounding of 1e-13 of the image, times the condition: 0.1 px of noise would be some millimetres.
    assert calibration.rms_px < 1e-8
    for name, value in dict(misalignment).items():
        assert getattr(calibration.sensor.misalignment, name) == pytest.approx(value, abs=1e-5)
    assert calibration.central.rms_px > 1


@pytest.mark.slow
def test_a_misalignment_that_is_given_is_held():
    corners = visible_boards(TRUE, 6, 33)[0]
    calibration = calibrate_sensor(corners, "hyperboloid", start=TRUE)
    assert calibration.sensor.misalignment == TRUE.misalignment
    assert calibration.central is None
    assert calibration.sensor.camera.focal_px == pytest.approx(614.12, abs=1e-4)
    again = calibrate_sensor(corners, "hyperboloid", start=TRUE, free=["x_mm", "rotation_y_deg"], fix={"cx": None})
    assert again.sensor.misalignment.x_mm == pytest.approx(0.6, abs=1e-4)
    assert again.keys[-2:] == ("misalignment.x_mm", "misalignment.rotation_y_deg")


def test_coordinates_lead_back_to_the_sensor():
    parameters = Parameters(TRUE, KEYS)
    vector = parameters.vector(TRUE)
    for key in KEYS:
        assert value_of(parameters.sensor_at(vector), key) == pytest.approx(value_of(TRUE, key), rel=1e-13)
    # The principal point is adjusted as the pixel of the mirror's apex, of a point before it.
    x, y, size = apex_in(TRUE)
    apex = [0, 0, TRUE.model.a_m - TRUE.model.e_m]
    np.testing.assert_allclose(vector[3:5], [319.5 + 614.12 * x, 239.5 + 614.12 * y], rtol=1e-15)
    offset = TRUE.misalignment.offset_m
    R = TRUE.misalignment.R_mirror_from_camera
    q = R.T @ (np.array(apex) - offset + [0, 0, 2 * TRUE.model.e_m])
    np.testing.assert_allclose([x, y], q[:2] / q[2], rtol=1e-14)
    assert apex_in(TRUE.aligned) == (0, 0, 1)
    assert size == pytest.approx((TRUE.model.a_m + TRUE.model.e_m) / q[2], rel=1e-14)


def test_a_grid_of_rays_is_seen_where_it_was_made():
    grid = ray_grid(TRUE, step_px=20, distance_m=0.2)
    v, u = np.nonzero(grid.inside)
    np.testing.assert_allclose(
        project_points(TRUE, grid.directions)[0], np.stack([grid.u[u], grid.v[v]], -1), atol=1e-9
    )


def test_only_a_mirror_is_misaligned():
    sensor = Sensor(model=Unified(xi=1), camera=TRUE.camera.model_copy(update={"focal_px": 300.0}))
    with pytest.raises(InputError, match=r"free: a unified \(Mei\) camera has no mirror to be misaligned with"):
        choose_keys(sensor, free=["misalignment"])


def test_boards_of_a_scene_are_seen_in_a_misaligned_mirror():
    room = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 90}}
    board = {"kind": "chessboard", "position_m": [0.2, 0.1, 0.9], "pitch_deg": 70}
    scene, pose = load_scene({"name": "target", "objects": [room, board]}), Pose(position_m=(0, 0, 1), yaw_deg=20)
    (exact,) = boards_of(scene, TRUE, pose)
    (aligned,) = boards_of(scene, TRUE.aligned, pose)
    assert exact.visible.all()
    in_frame = (exact.points_world_m - pose.position_m) @ pose.R_world_from_view
    np.testing.assert_allclose(exact.pixels, project_points(TRUE, in_frame)[0], atol=1e-9)
    # 0.5 degrees of tilt are some 5 px, 1 mm at 64 mm from the mirror some 10 px.
    assert 1 < np.linalg.norm(exact.pixels - aligned.pixels, axis=-1).mean() < 15


@pytest.mark.long
@pytest.mark.slow
def test_numbers_and_rays_scatter_as_predicted():
    # Farther boards tell so little of turns about x and y that the standard deviation itself scatters by a third.
    exact, poses = visible_boards(TRUE, 20, 30, range_m=(0.05, 0.15))
    parameters = Parameters(TRUE, KEYS)
    start, truth = parameters.vector(TRUE), np.array([value_of(TRUE, key) for key in KEYS])
    grid = ray_grid(TRUE, step_px=20, distance_m=0.1)
    z, squares, predicted, distances = [], [], [], []
    for draw in range(DRAWS):
        fitted = adjust(parameters, noisy(exact, NOISE_PX, 7000 + draw), start, poses)
        uncertainty = uncertainty_of(fitted)
        z.append((uncertainty.values - truth) / uncertainty.sigma)
        squares.append(np.sum(ray_difference(TRUE, parameters.sensor_at(fitted.vector), grid) ** 2, axis=-1))
        distances.append(significance(KEYS, uncertainty))
        if draw < 10:
            predicted.append(ray_sigma(fitted, uncertainty.vector_covariance, grid)[0] ** 2)
    # 68.3 % expected; numbers that trade off count as two or three each time, so that the share scatters by 3 %.
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.683, abs=0.04)
    assert np.abs(z).max() < 5
    assert np.sqrt(np.nanmean(squares) / np.mean(predicted)) == pytest.approx(1, abs=0.12)
    assert np.median(distances) > 11.07
