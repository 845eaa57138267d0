"""Errors of a rig, propagated to the range: closed forms, Monte Carlo, and what a misaligned mirror does."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import harness
from harness.camera.misalignment import Misalignment
from harness.camera.sensor import Sensor, in_field
from harness.evaluation.propagation import (
    MISALIGNMENT,
    MOTION,
    ODOMETRY,
    Rig,
    believed_points,
    calibration_parameters,
    diagonal,
    propagated,
    range_errors,
    sensitivities,
)
from harness.evaluation.rig_uncertainty import Odometry, Uncertainty, covariances
from harness.geometry.angles import normalise
from harness.geometry.pose import Motion

SENSOR = Sensor()
T = np.array([0.45, -0.15, 0.1])
RIG = Rig((SENSOR, SENSOR), Motion(Rotation.from_euler("ZYX", [50, 3, -2], degrees=True).as_matrix(), T))


def directions(count, seed=0):
    """Directions that both views see, 30 degrees or more from t."""
    x = normalise(np.random.default_rng(seed).normal(size=(20 * count, 3)))
    far = np.linalg.norm(np.cross(x, normalise(T)), axis=1) > 0.5
    visible = in_field(SENSOR, x) & in_field(SENSOR, RIG.motion.apply(3 * x))
    return x[far & visible][:count]


def test_nothing_wrong_no_error():
    points = 4 * directions(200)
    believed = believed_points(points, RIG, RIG)
    # The sine rule loses what alpha_2 - alpha_1, some 0.1, keeps of a float64's sixteen digits.
    assert range_errors(points, RIG, RIG) == pytest.approx(np.zeros(200), abs=1e-11)
    assert believed.across == pytest.approx(np.zeros(200), abs=1e-14)
    assert believed.x_1 == pytest.approx(points / 4, abs=1e-13)


vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@given(
    x=vectors,
    range_m=st.floats(1, 10),
    delta=vectors,
    tau=vectors,
    share=st.floats(-1, 1),
)
def test_motion_errors_have_the_closed_form(x, range_m, delta, tau, share):
    """`d_2²/(|t| sin alpha_1) delta·n + d_1 cot(alpha_2) tau·n - d_1 s`, where the believed motion falls short."""
    assume(np.hypot(x[0], x[1]) > 0.1)  # a panorama has no pixel at its poles
    x = normalise(x)
    plane = np.cross(T, x)
    assume(np.linalg.norm(plane) > 0.3 * np.linalg.norm(T))
    point = range_m * x
    n = normalise(plane)
    tau = tau - (tau @ T) * T / (T @ T)
    size = 1e-6
    turn = Rotation.from_rotvec(size * delta).as_matrix()
    # The believed motion falls short of the true one by a turn delta of the view, a turn tau of t, and a share of |t|.
    true_t = (1 + size * share) * Rotation.from_rotvec(size * tau).as_matrix() @ T
    true = Motion(RIG.motion.R_v2_from_v1 @ turn.T, true_t)
    error = _range_with(EVERYWHERE, true, point) / size
    d_2, baseline = np.linalg.norm(point - T), np.linalg.norm(T)
    sine, alpha_2 = np.linalg.norm(plane) / baseline, _angle(point - T, T)
    assume(np.sin(alpha_2) > 0.05)
    short_of = d_2**2 / (baseline * sine) * (delta @ n) + range_m / np.tan(alpha_2) * (tau @ n) - range_m * share
    # Second order: the step of 1e-6 against angles of 0.02 and more, and rounding of 1e-16/1e-6 times the law.
    assert error == pytest.approx(short_of, rel=1e-3, abs=1e-3 * d_2**2 / (baseline * sine))


EVERYWHERE = harness.load_sensor({"model": {"kind": "equirectangular"}, "camera": {"width_px": 720, "height_px": 360}})


def _range_with(sensor, true_motion, point):
    rig = Rig((sensor, sensor), RIG.motion)
    return float(range_errors(point[None], Rig((sensor, sensor), true_motion), rig)[0])


def _angle(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("parameters", [MOTION, calibration_parameters(SENSOR), MISALIGNMENT])
def test_propagation_is_monte_carlos(parameters):
    """Standard deviations over draws of all parameters at once, of points on tilted walls."""
    points = np.concatenate([r * directions(8, seed=1) for r in (1.5, 4.0)])
    normals = points + 0.3 * np.random.default_rng(2).normal(size=points.shape)
    scale = {"deg": 0.02, "px": 0.05, "mm": 0.02, "": 2e-4}
    sigmas = {each.key: scale[each.unit] for each in parameters}
    covariance = diagonal(parameters, sigmas)
    expected = propagated(sensitivities(points, RIG, parameters, normals), covariance)
    rng, errors = np.random.default_rng(3), []
    for _ in range(2500):
        rig = RIG
        for each in parameters:
            rig = each.changed(rig, sigmas[each.key] * rng.standard_normal())
        errors.append(range_errors(points, rig, RIG, normals))
    ratio = np.std(errors, axis=0) / expected
    # 2,500 draws tell a standard deviation to 1.4 %, and the median of sixteen that share draws to less than 1 %.
    assert np.median(ratio) == pytest.approx(1, abs=0.02)
    assert ratio == pytest.approx(np.ones(16), abs=0.06)


@pytest.mark.slow
def test_odometry_is_monte_carlos():
    """Errors drawn as odometry has them, in metres and radians, against their propagated standard deviation."""
    known = Odometry(along=0.004, across=0.003, rotation_deg_per_m=0.05, rotation_per_turn=4e-4)
    points = np.concatenate([r * directions(8, seed=1) for r in (1.5, 4.0)])
    parameters, covariance = next(
        (parameters, covariance)
        for cause, parameters, covariance in covariances(SENSOR, Uncertainty(odometry=known), RIG.motion)
        if cause == "odometry"
    )
    expected = propagated(sensitivities(points, RIG, parameters), covariance)
    length, turned = np.linalg.norm(T), Rotation.from_matrix(RIG.motion.R_v2_from_v1).magnitude()
    t_hat = T / length
    side = np.cross([0, 0, 1], t_hat) / np.hypot(*t_hat[:2])
    frame = np.stack([t_hat, side, np.cross(t_hat, side)])
    rng, errors = np.random.default_rng(6), []
    for _ in range(DRAWS):
        u = rng.standard_normal(9)
        t = T + length * (np.array([known.along, known.across, known.across]) * u[:3]) @ frame
        turn = np.radians(known.rotation_deg_per_m) * length * u[3:6] + known.rotation_per_turn * turned * u[6:]
        R = RIG.motion.R_v2_from_v1 @ Rotation.from_rotvec(turn).as_matrix().T
        errors.append(range_errors(points, Rig(RIG.sensors, Motion(R, t)), RIG))
    ratio = np.std(errors, axis=0) / expected
    # 10,000 draws tell a standard deviation to 0.7 %, so that 2 % is close to three of these; errors of half a per
    # cent bend the range by less than that much again.
    assert ratio == pytest.approx(np.ones(16), abs=0.02)
    # Each part alone, in closed form, straight across the baseline and level: the law times the rotation; d times the
    # share along; d cot(alpha_2) times the share across.
    flat = Rig((SENSOR, SENSOR), Motion(np.eye(3), np.array([0.5, 0.0, 0.0])))
    point = np.array([[0.0, 3.0, 0.0]])
    for part, closed in (
        (Odometry(along=0.01), 0.03),
        (Odometry(across=0.01), 3 * (0.5 / 3) * 0.01),
        (Odometry(rotation_deg_per_m=0.2), (9 + 0.25) / 0.5 * np.radians(0.1)),
        (Odometry(rotation_per_turn=0.1), 0.0),
    ):
        sigmas = part.sigmas(flat.motion)
        sigma = propagated(sensitivities(point, flat, ODOMETRY), diagonal(ODOMETRY, sigmas))
        assert sigma == pytest.approx([closed], rel=1e-5, abs=1e-12)


DRAWS = 10_000


def test_a_misaligned_mirror_costs_in_proportion_to_the_range():
    """Half a metre of baseline: millimetres beside the focus cost per cent, whatever the law says."""
    motion = Motion(np.eye(3), np.array([0.5, 0, 0]))
    rig = Rig((SENSOR, SENSOR), motion)
    x = normalise(np.random.default_rng(0).normal(size=(4000, 3)))
    x = x[in_field(SENSOR, x) & (np.hypot(x[:, 1], x[:, 2]) >= 0.5)]

    def rms_mm(range_m, **misalignment):
        sensor = SENSOR.model_copy(update={"misalignment": Misalignment(**misalignment)})
        errors = range_errors(range_m * x, Rig((sensor, sensor), motion), rig)
        return 1000 * np.sqrt(np.mean(errors**2))

    # RMS over evenly spread directions; to two digits those of an independent program over a panorama's pixels.
    for misalignment, expected in (
        ({"x_mm": 1.0}, (51, 97, 316)),
        ({"y_mm": 1.0}, (128, 253, 841)),
        ({"z_mm": 1.0}, (25, 49, 162)),
        ({"rotation_x_deg": 0.5}, (105, 208, 693)),
    ):
        measured = [rms_mm(r, **misalignment) for r in (3, 6, 20)]
        assert measured == pytest.approx(expected, rel=0.16)
        # In proportion to the range, not to its square.
        assert measured[2] / measured[0] == pytest.approx(20 / 3, rel=0.1)


def test_an_even_turn_of_the_camera_about_the_axis_of_both_views_costs_nothing():
    """Views that look alike: their images turn alike, and so does the believed world."""
    points = 3 * directions(100)
    rig = Rig(RIG.sensors, Motion(np.eye(3), np.array([0, 0, 0.4])))
    (turn,) = (each for each in MISALIGNMENT if each.key == "misalignment.rotation_z_deg")
    assert sensitivities(points, rig, [turn]) == pytest.approx(np.zeros((100, 1)), abs=1e-8)
