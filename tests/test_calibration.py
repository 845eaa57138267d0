"""Calibration from corners: each step against another way to the same numbers, and the whole against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from boards import BOARD, MIRROR, NEARLY_PARABOLIC, UNIFIED, noisy, visible_boards
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from harness.calibration.adjust import adjust
from harness.calibration.corners import Board, corners_of
from harness.calibration.parameters import Parameters, choose_keys, intrinsic_jacobian, value_of, with_values
from harness.calibration.poses import BoardPoses, pose_jacobian, poses_from_bearings, refine_poses, turned_over
from harness.calibration.sensor_calibration import calibrate_sensor
from harness.calibration.uncertainty import ray_difference, ray_grid, uncertainty_of
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, jacobian, parameters_of, project, unproject
from harness.errors import InputError

SENSORS = pytest.mark.parametrize("sensor", [MIRROR, UNIFIED], ids=["hyperboloid", "unified"])


class TestPoses:
    @SENSORS
    def test_exact_bearings_give_exact_poses(self, sensor):
        corners, truth = visible_boards(sensor, 8, 1)
        poses = poses_from_bearings(corners, unproject(sensor, corners.pixels)[0])
        # Rounding, times the condition of a homography of 54 bearings: about 100.
        np.testing.assert_allclose(poses.R, truth.R, rtol=0, atol=1e-10)
        np.testing.assert_allclose(poses.t, truth.t, rtol=0, atol=1e-10)

    def test_a_board_behind_the_camera_is_not_taken_for_one_ahead(self):
        """A mirror sees below and above the horizon: bearings of both signs of z."""
        corners, truth = visible_boards(MIRROR, 6, 2, rim=True)
        bearings = unproject(MIRROR, corners.pixels)[0]
        assert (bearings[:, 2] > 0).any()
        assert (bearings[:, 2] < 0).any()
        np.testing.assert_allclose(poses_from_bearings(corners, bearings).t, truth.t, rtol=0, atol=1e-10)

    def test_derivative_is_that_of_differences(self):
        corners, poses = visible_boards(UNIFIED, 3, 3)
        camera = parameters_of(UNIFIED)
        analytic = pose_jacobian(camera, *poses.apply(corners))
        for i in range(6):
            step = np.zeros((3, 6))
            step[:, i] = 1e-6
            ahead, behind = (project(UNIFIED, poses.moved(side * step).apply(corners)[1])[0] for side in (1, -1))
            # Second derivatives are below 1e5 px/m², third ones below 1e7: 1e-5 of 1e3; rounding is 1e-13/1e-6.
            np.testing.assert_allclose(analytic[..., i], (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-4)

    @SENSORS
    def test_turned_over_twice_is_the_same_and_once_looks_alike(self, sensor):
        small = Board(columns=5, rows=4, square_m=0.002)
        corners, poses = visible_boards(sensor, 6, 4, board=small, range_m=(0.5, 1.0))
        other = turned_over(poses, corners)
        np.testing.assert_allclose(np.linalg.det(other.R), 1, rtol=0, atol=1e-12)
        again = turned_over(other, corners)
        np.testing.assert_allclose(again.R, poses.R, rtol=0, atol=1e-12)
        np.testing.assert_allclose(again.t, poses.t, rtol=0, atol=1e-12)
        pixels, _ = project(sensor, other.apply(corners)[1])
        # A board of 8 mm at 0.5 m or more: its depth changes its size by at most 2 %, half of that each way, of 7 px.
        assert np.abs(pixels - corners.pixels).max() < 0.1
        assert (np.abs(Rotation.from_matrix(other.R @ np.swapaxes(poses.R, 1, 2)).magnitude()) > 0.01).all()

    def test_refinement_ends_where_scipy_does(self):
        exact, truth = visible_boards(MIRROR, 3, 5)
        corners = noisy(exact, 0.5, 0)
        start = poses_from_bearings(corners, unproject(MIRROR, corners.pixels)[0])
        poses, cost = refine_poses(parameters_of(MIRROR), corners, start)
        for board in range(3):
            own = corners.image == board

            def residuals(x, own=own, R=truth.R[board]):
                p = BOARD.points_m @ (Rotation.from_rotvec(x[:3]).as_matrix() @ R)[:, :2].T + x[3:]
                return (project(MIRROR, p)[0] - corners.pixels[own]).ravel()

            other = least_squares(residuals, np.r_[np.zeros(3), truth.t[board]], xtol=1e-12, ftol=1e-12)
            assert cost[board] == pytest.approx(2 * other.cost, rel=1e-9)
            np.testing.assert_allclose(poses.t[board], other.x[3:], rtol=0, atol=1e-6)


class TestParameters:
    def test_vector_and_back(self):
        for sensor in (MIRROR, UNIFIED):
            parameters = Parameters(sensor, choose_keys(sensor))
            back = parameters.sensor_at(parameters.vector(sensor))
            for key in parameters.keys:
                assert value_of(back, key) == pytest.approx(value_of(sensor, key), rel=1e-13)

    def test_usual_keys(self):
        image = ("camera.focal_px", "camera.aspect", "camera.cx_px", "camera.cy_px")
        assert choose_keys(MIRROR) == ("model.b_m", *image)
        assert choose_keys(UNIFIED) == ("model.xi", *image, "lens.k1", "lens.k2", "lens.p1", "lens.p2")
        assert choose_keys(UNIFIED, lens=(), fix=["aspect", "xi"], free=["skew", "k3"]) == (
            "camera.focal_px", "camera.skew_px", "camera.cx_px", "camera.cy_px", "lens.k3",
        )  # fmt: skip

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"lens": ["k4"]}, "lens: there is no lens term 'k4'; did you mean 'k3'"),
            ({"free": ["focus"]}, "free: there is no one key 'focus' to estimate"),
            ({"fix": ["e_m"]}, "fix: there is no one key 'e_m' to estimate"),
        ],
    )
    def test_keys_that_are_not_there(self, options, message):
        with pytest.raises(InputError, match=message):
            choose_keys(MIRROR, **options)

    @SENSORS
    def test_derivatives(self, sensor):
        """By focal length and centre in closed form: u = f m + s n + cx, in which m does not depend on them."""
        corners, poses = visible_boards(sensor, 4, 6)
        p = poses.apply(corners)[1]
        keys = ("camera.focal_px", "camera.aspect", "camera.skew_px", "camera.cx_px", "camera.cy_px")
        parameters = Parameters(sensor, keys)
        vector = parameters.vector(sensor)
        steps = parameters.steps.copy()
        first, J = (intrinsic_jacobian(parameters, vector, p, steps) for _ in range(2))
        offset = corners.pixels - [sensor.camera.cx_px, sensor.camera.cy_px]
        n = offset[:, 1] / (sensor.camera.focal_px * sensor.camera.aspect)
        zero, one = np.zeros(len(p)), np.ones(len(p))
        expected = [
            offset / vector[0], np.stack([zero, offset[:, 1] / sensor.camera.aspect], -1), np.stack([n, zero], -1),
            np.stack([one, zero], -1), np.stack([zero, one], -1),
        ]  # fmt: skip
        # They are linear, so that only rounding is left: 1e-13 of the image over steps that move it by 1e-3, and before
        # anything is known of the steps by 1e-6 or more.
        scale = np.abs(J).max(axis=(0, 1))
        np.testing.assert_allclose(J / scale, np.stack(expected, axis=-1) / scale, rtol=0, atol=1e-9)
        np.testing.assert_allclose(first / scale, J / scale, rtol=0, atol=1e-5)

    def test_limits_of_a_key(self):
        parameters = Parameters(UNIFIED, ("model.xi",))
        assert parameters.compiled(np.array([-0.1])) is None
        parameters = Parameters(MIRROR, ("model.b_m",))
        assert parameters.compiled(np.array([1.0])) is None
        assert parameters.sensor_at(parameters.vector(MIRROR)).model.b_m == pytest.approx(MIRROR.model.b_m, rel=1e-14)


class TestAdjustment:
    @SENSORS
    def test_is_the_minimum_that_scipy_finds_with_its_covariance(self, sensor):
        """One dense problem of all unknowns, differentiated by scipy: nothing in common but the projection."""
        exact, poses = visible_boards(sensor, 4, 7)
        corners = noisy(exact, 0.2, 1)
        parameters = Parameters(sensor, choose_keys(sensor))
        start = parameters.vector(sensor)
        own = adjust(parameters, corners, start, poses)
        keys = len(parameters.keys)

        def residuals(x):
            steps = x[keys:].reshape(-1, 6) / 1000
            moved = poses.moved(steps)
            changed = parameters.sensor_at(start * (1 + x[:keys] / 1000))
            return (project(changed, moved.apply(corners)[1])[0] - corners.pixels).ravel()

        other = least_squares(residuals, np.zeros(keys + 24), method="lm", xtol=1e-12, ftol=1e-12)
        assert own.converged
        assert own.cost == pytest.approx(2 * other.cost, rel=1e-7)
        variance = 2 * other.cost / (len(other.fun) - len(other.x))
        covariance = np.linalg.inv(other.jac.T @ other.jac)[:keys, :keys] * variance
        sigma = np.sqrt(np.diag(covariance)) * np.abs(start) / 1000
        # scipy's differences are good to 1e-8, and where numbers trade off 1e-6 of them is all that tells one.
        mine = np.sqrt(np.diag(uncertainty_of(own).vector_covariance))
        np.testing.assert_allclose(mine, sigma, rtol=1e-2)

    def test_a_start_that_cannot_see_the_corners_is_none(self):
        corners, poses = visible_boards(MIRROR, 3, 8)
        narrow = MIRROR.model_copy(update={"lens": Lens(k1=-20.0)})
        parameters = Parameters(narrow, choose_keys(MIRROR))
        assert adjust(parameters, corners, parameters.vector(narrow), poses) is None

    def test_robust_loss_is_hardly_moved_by_a_mistake(self):
        exact, poses = visible_boards(MIRROR, 6, 9)
        corners = noisy(exact, 0.1, 2)
        wrong = corners.pixels.copy()
        wrong[::25] += [20.0, -8.0]
        parameters = Parameters(MIRROR, choose_keys(MIRROR))
        robust = adjust(parameters, replace(corners, pixels=wrong), parameters.vector(MIRROR), poses, robust_px=0.5)
        grid = ray_grid(MIRROR)
        off = np.linalg.norm(ray_difference(MIRROR, parameters.sensor_at(robust.vector), grid), axis=-1)
        plain = adjust(parameters, replace(corners, pixels=wrong), parameters.vector(MIRROR), poses)
        off_plain = np.linalg.norm(ray_difference(MIRROR, parameters.sensor_at(plain.vector), grid), axis=-1)
        assert np.median(off) < 0.3  # as without the mistakes: 0.1 px of noise on six boards
        assert np.median(off_plain) > 3 * np.median(off)


class TestRays:
    def test_a_turned_sensor_sees_the_same(self):
        """A principal point that moves is, in the first place, a turn."""
        moved = with_values(UNIFIED, {"camera.cx_px": 641.0})
        grid = ray_grid(UNIFIED)
        turned = np.linalg.norm(ray_difference(UNIFIED, moved, grid), axis=-1)
        fixed = np.linalg.norm(ray_difference(UNIFIED, moved, grid, turn=False), axis=-1)
        np.testing.assert_allclose(fixed, 1.0, rtol=0, atol=1e-9)
        assert np.sqrt(np.mean(turned**2)) < 0.8
        assert np.abs(ray_difference(UNIFIED, UNIFIED, grid)).max() < 1e-9

    def test_turn_is_the_best_one(self):
        """Against a direct search over rotations."""
        moved = with_values(UNIFIED, {"camera.cx_px": 641.0, "model.xi": 1.11})
        grid = ray_grid(UNIFIED, 80)
        own = ray_difference(UNIFIED, moved, grid)
        at = project(UNIFIED, grid.directions)[0]

        def residuals(w):
            turned = grid.directions @ Rotation.from_rotvec(w).as_matrix().T
            return (project(moved, turned)[0] - at).ravel()

        assert np.sum(own**2) == pytest.approx(2 * least_squares(residuals, np.zeros(3), xtol=1e-12).cost, rel=1e-6)


class TestWhole:
    """No start is given: all begins with the corners."""

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("sensor", "boards", "options"),
        [
            (MIRROR, {"count": 8}, {}),
            (MIRROR, {"count": 2}, {}),
            (MIRROR, {"count": 8, "rim": True}, {}),
            (NEARLY_PARABOLIC, {"count": 8}, {}),
            (UNIFIED, {"count": 8}, {}),
            (UNIFIED, {"count": 3}, {}),
            (with_values(UNIFIED, {"model.xi": 1.0}), {"count": 8, "rim": True}, {}),
            (MIRROR.model_copy(update={"lens": Lens(k1=-0.1, p1=1e-3)}), {"count": 8}, {"lens": ["k1", "p1"]}),
        ],
        ids=["plain", "two", "rim", "nearly parabolic", "unified", "three", "xi is 1", "lens"],
    )
    def test_corners_without_noise_give_the_truth(self, sensor, boards, options):
        corners, _ = visible_boards(sensor, seed=10, **boards)
        calibration = calibrate_sensor(corners, getattr(sensor.model, "kind", "hyperboloid"), **options)
        assert calibration.rms_px < 1e-6
        assert calibration.left_out is None
        for key, value in zip(calibration.keys, calibration.uncertainty.values, strict=True):
            # Where numbers trade off, 1e-9 px of rounding go a long way in them; rays tell.
            assert value == pytest.approx(value_of(sensor, key), rel=1e-3, abs=1e-3), key
        assert np.nanmax(np.abs(ray_difference(calibration.sensor, sensor, calibration.grid))) < 1e-4

    @pytest.mark.slow
    @SENSORS
    def test_with_noise_every_number_is_within_three_standard_deviations(self, sensor):
        corners = noisy(visible_boards(sensor, 14, 11)[0], 0.1, 3)
        calibration = calibrate_sensor(corners, getattr(sensor.model, "kind", "hyperboloid"))
        # 1,512 residuals less 93 unknowns: 1.9 % of scatter.
        assert calibration.uncertainty.sigma_px == pytest.approx(0.1, rel=0.06)
        truth = np.array([value_of(sensor, key) for key in calibration.keys])
        assert (np.abs(calibration.uncertainty.values - truth) < 3 * calibration.uncertainty.sigma).all()
        assert calibration.halves is not None
        # Halves differ by twice the whole's deviation: sqrt(2) for half of the boards, sqrt(2) for two of them.
        ratio = np.sqrt(np.nanmean(calibration.halves.difference_px**2) / np.mean(calibration.ray_sigma_px**2))
        assert 0.8 < ratio < 5

    @pytest.mark.slow
    def test_mistakes_are_left_out_and_said(self):
        exact, _ = visible_boards(MIRROR, 8, 12)
        corners = noisy(exact, 0.1, 4)
        pixels = corners.pixels.copy()
        pixels[[5, 100]] += [3.0, 2.0]
        swapped = corners.image == 6
        pixels[swapped] = np.roll(pixels[swapped], 7, axis=0)
        calibration = calibrate_sensor(replace(corners, pixels=pixels), "hyperboloid")
        assert calibration.corners.images == tuple(name for name in corners.images if name != "board 6")
        assert len(calibration.left_out.image) == 54 + 2
        assert any("No corner of board 6 was used" in note for note in calibration.notes)
        assert calibration.rms_px == pytest.approx(0.1 * 2**0.5, rel=0.1)

    def test_fixed_keys_keep_their_values(self):
        corners = noisy(visible_boards(UNIFIED, 6, 13)[0], 0.1, 5)
        calibration = calibrate_sensor(
            corners, "unified", fix={"aspect": 1.002, "xi": 1.1, "skew": None}, lens=["k1", "k2"]
        )
        assert calibration.keys == ("camera.focal_px", "camera.cx_px", "camera.cy_px", "lens.k1", "lens.k2")
        assert (calibration.sensor.model.xi, calibration.sensor.camera.aspect) == (1.1, 1.002)
        assert calibration.rms_px < 0.2

    @pytest.mark.slow
    def test_one_small_board_tells_little_and_that_is_said(self):
        corners, _ = visible_boards(MIRROR, 1, 14, board=Board(columns=3, rows=2, square_m=0.01))
        calibration = calibrate_sensor(noisy(corners, 0.1, 6), "hyperboloid", start=MIRROR)
        assert calibration.halves is None
        assert any("The standard deviation of rays is" in note for note in calibration.notes)
        assert any("1 image is few" in note for note in calibration.notes)

    def test_what_no_corner_tells_is_named(self):
        """Six corners of one board and eleven numbers: twelve equations less six for its pose."""
        corners, poses = visible_boards(MIRROR, 1, 14, board=Board(columns=3, rows=2, square_m=0.01))
        parameters = Parameters(MIRROR, choose_keys(MIRROR, lens=["k1", "k2", "p1", "p2"], free=["skew"]))
        adjusted = adjust(parameters, corners, parameters.vector(MIRROR), poses)
        uncertainty = uncertainty_of(adjusted)
        assert uncertainty.undetermined
        lost = np.isin(parameters.keys, uncertainty.undetermined)
        assert np.isinf(uncertainty.sigma[lost]).all()
        assert np.isfinite(uncertainty.sigma[~lost]).all()

    def test_start_of_another_kind_is_refused(self):
        corners, _ = visible_boards(MIRROR, 2, 15)
        with pytest.raises(InputError, match="start: is a hyperboloid mirror, not of kind 'unified'"):
            calibrate_sensor(corners, "unified", start=MIRROR)
        with pytest.raises(InputError, match="model: there is no camera model 'fish'"):
            calibrate_sensor(corners, "fish")

    def test_field_is_what_the_boards_reached(self):
        corners, _ = visible_boards(MIRROR, 10, 16)
        calibration = calibrate_sensor(corners, "hyperboloid")
        directions = unproject(MIRROR, corners.pixels)[0]
        highest = np.degrees(np.arcsin(directions[:, 2].max()))
        assert highest < calibration.sensor.field.elevation_max_deg < highest + 1.01
        assert Sensor.model_validate(calibration.sensor.model_dump()) == calibration.sensor


class TestCorners:
    @pytest.mark.parametrize(
        ("points", "pixels", "message"),
        [
            (np.zeros((5, 2)), np.zeros((5, 2)), "image 'a' has 5 corners; a board needs at least 6"),
            (np.zeros((6, 2)), np.full((6, 2), np.nan), "image 'a' has corners that are not finite"),
            (np.stack([np.arange(6), np.arange(6)], -1), np.zeros((6, 2)), "of image 'a' lie on one line"),
        ],
    )
    def test_what_is_no_board_is_refused(self, points, pixels, message):
        with pytest.raises(InputError, match=message):
            corners_of([("a", points, pixels)], 640, 480)

    def test_some_of_the_images(self):
        corners, _ = visible_boards(MIRROR, 4, 17)
        some = corners.of([1, 3])
        assert some.images == ("board 1", "board 3")
        assert some.starts.tolist() == [0, 54]
        np.testing.assert_array_equal(some.pixels, corners.pixels[np.isin(corners.image, [1, 3])])


def test_derivative_by_direction_is_used_as_it_stands():
    """`pose_jacobian` takes the camera room's: its last three columns."""
    corners, poses = visible_boards(MIRROR, 2, 18)
    turned, p = poses.apply(corners)
    np.testing.assert_array_equal(pose_jacobian(parameters_of(MIRROR), turned, p)[..., 3:], jacobian(MIRROR, p))
    assert isinstance(poses, BoardPoses)


@pytest.fixture(scope="module")
def head_on():
    """One board that a pinhole sees head-on, the pixel grid's equal."""
    points = np.array([[c, r] for r in range(6) for c in range(9)], dtype=np.float64)
    return corners_of([("a", 0.04 * points, 300 + 10 * points)], 1024, 768)


def test_one_board_seen_head_on_determines_neither_focal_length_nor_centre(head_on):
    """It may be larger and farther away, or aside and turned; that it is square and straight it does say."""
    calibration = calibrate_sensor(head_on, "eucm")
    assert set(calibration.uncertainty.undetermined) == {
        "model.beta", "camera.focal_px", "camera.cx_px", "camera.cy_px"
    }  # fmt: skip
    assert any("do not determine model.beta, camera.focal_px" in note for note in calibration.notes)


def test_corners_that_determine_nothing_are_refused(head_on):
    with pytest.raises(InputError, match=r"determine none of .*: take more boards"):
        calibrate_sensor(head_on, "eucm", fix={"alpha": 0.0, "aspect": 1.0})
