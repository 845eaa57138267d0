"""Wrong beliefs of a rig: what they do to the range is what propagation says, and the budget's figures add up."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import harness
from harness.camera.central_fit import nearest_central
from harness.camera.misalignment import Misalignment
from harness.camera.reflection import project_points
from harness.camera.sensor import Sensor, in_field, project
from harness.errors import InputError
from harness.evaluation.propagation import MOTION, Rig, range_errors
from harness.evaluation.rig_uncertainty import Odometry, Uncertainty, uncertain
from harness.geometry.angles import normalise
from harness.geometry.panorama import directions
from harness.geometry.pose import Motion
from harness.geometry.triangulation import points
from harness.pipeline.believed import Believed, believed_rig, calibrated, draws_of, misaligned
from harness.pipeline.error_budget import Z_EDGES
from harness.pipeline.row import row_of
from harness.pipeline.trial import run_trial
from harness.runs.budgets import budget_of
from harness.runs.experiment import Planned
from harness.runs.load import load_experiment

SMALL = [
    "scene=box",
    "sensor.camera.width_px=320",
    "sensor.camera.height_px=240",
    "sensor.camera.focal_px=307.06",
    "sensor.camera.cx_px=159.5",
    "sensor.camera.cy_px=119.5",
    "panorama.width_px=360",
    "panorama.height_px=90",
    "matching.kind=slanted",
]


def trial(*sets):
    experiment = load_experiment("noise", sets=[])
    base = experiment.trial.model_dump() | {"matching": {"kind": "slanted"}}
    return load_experiment({"name": "believed", "trial": base}, sets=[*SMALL, *sets]).trial


def test_true_beliefs_change_nothing():
    rig = Rig((Sensor(), Sensor()), Motion(np.eye(3), np.array([0.5, 0, 0])))
    assert believed_rig(rig, Believed(), {}) is rig
    assert Believed().is_true
    assert trial("believed.t_length=0").key == trial().key
    assert trial("believed.t_length=0.01").key != trial().key


def test_fixed_errors_are_added_to_what_is_true():
    sensor = Sensor()
    rig = Rig((sensor, sensor), Motion(np.eye(3), np.array([0.5, 0, 0])))
    wrong = believed_rig(rig, Believed(t_length=0.02, focal=0.01, cx_px=2.0, shape=-0.1, rotation_z_deg=3.0), {})
    assert wrong.motion.baseline_m == pytest.approx(0.51)
    first = wrong.sensors[0]
    assert first == wrong.sensors[1]
    assert first.camera.focal_px == pytest.approx(1.01 * sensor.camera.focal_px)
    assert first.camera.cx_px - sensor.camera.cx_px == pytest.approx(2)
    assert first.model.a_m == pytest.approx(0.9 * sensor.model.a_m)
    assert first.model.b_m == sensor.model.b_m
    # View 2 is believed to be turned by 3 degrees, so that what it sees is turned back in its frame.
    assert wrong.motion.R_v2_from_v1 @ [1, 0, 0] == pytest.approx([np.cos(np.radians(3)), -np.sin(np.radians(3)), 0])


MOVED = Motion(Rotation.from_euler("z", -40, degrees=True).as_matrix(), np.array([1.2, 1.6, 0.0]))


def test_draws_have_their_standard_deviations_and_are_the_seeds():
    sigma = Uncertainty(rotation_deg=0.5, centre_px=2.0, alignment_mm=0.3)
    sensor = Sensor()
    drawn = [draws_of(sensor, sigma, MOVED, seed) for seed in range(400)]
    assert draws_of(sensor, sigma, MOVED, 7) == drawn[7]
    assert drawn[7] != drawn[8]
    assert set(drawn[0]) == {parameter.key for parameter, _ in uncertain(sensor, sigma, MOVED)}
    for key, expected in (("rotation_x_deg", 0.5), ("camera.cx_px", 2.0), ("misalignment.z_mm", 0.3)):
        # 400 draws tell a standard deviation to 3.5 %.
        assert np.std([each[key] for each in drawn]) == pytest.approx(expected, rel=0.12)
    off = misaligned(sensor, drawn[3])
    assert off.misalignment.x_mm == drawn[3]["misalignment.x_mm"]
    assert off.misalignment.rotation_z_deg == 0
    assert off.aligned == sensor
    # A larger standard deviation scales the same draw.
    assert draws_of(sensor, Uncertainty(rotation_deg=1.0), MOVED, 3)["rotation_y_deg"] == 2 * drawn[3]["rotation_y_deg"]


def test_the_odometrys_errors_grow_with_the_motion_and_leave_the_constant_draws_alone():
    sensor, constant = Sensor(), Uncertainty(rotation_deg=0.5, t_direction_deg=0.3)
    odometry = Odometry(along=0.02, across=0.01, rotation_deg_per_m=0.4, rotation_per_turn=0.03)
    both = constant.model_copy(update={"odometry": odometry})
    drawn = draws_of(sensor, both, MOVED, 5)
    assert {key: drawn[key] for key in drawn if not key.startswith("odometry.")} == draws_of(sensor, constant, MOVED, 5)
    # 0.4 degrees on each of 2 m, and 3 % of a turn of 40 degrees; a t that is 1 % off across is 0.573 degrees off.
    sigmas = {parameter.key: sigma for parameter, sigma in uncertain(sensor, both, MOVED)}
    for axis in "xyz":
        assert sigmas[f"odometry.rotation_{axis}_deg"] == pytest.approx(np.hypot(0.8, 1.2))
    assert sigmas["odometry.t_azimuth_deg"] == sigmas["odometry.t_elevation_deg"] == pytest.approx(0.57296, rel=1e-4)
    assert sigmas["odometry.t_length"] == 0.02
    # Twice as far, and not turned: the same draws in proportion.
    further = draws_of(sensor, both, Motion(np.eye(3), 2 * MOVED.t_v1), 5)
    ratio = further["odometry.rotation_x_deg"] / drawn["odometry.rotation_x_deg"]
    assert ratio == pytest.approx(1.6 / np.hypot(0.8, 1.2))
    assert further["odometry.t_length"] == drawn["odometry.t_length"]
    rig = Rig((sensor, sensor), MOVED)
    wrong = believed_rig(rig, Believed(), {"odometry.t_length": 0.1, "odometry.rotation_z_deg": 2.0}).motion
    assert wrong.baseline_m == pytest.approx(1.1 * MOVED.baseline_m)
    turned = Rotation.from_matrix(wrong.R_v2_from_v1 @ MOVED.R_v2_from_v1.T)
    assert np.degrees(turned.magnitude()) == pytest.approx(2)


def test_a_trial_without_odometry_keeps_its_key():
    assert trial("believed.sigma.rotation_deg=0.5").key == "142960a24b635bef"
    assert trial("believed.sigma.odometry.along=0.01").key != trial().key


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "size"),
    [
        ("t_length", 0.02, lambda d, _d2: 0.02 * d),
        ("rotation_z_deg", 0.2, None),
    ],
)
def test_a_wrong_belief_shifts_ranges_as_the_closed_form_says(key, value, size):
    right, wrong = run_trial(trial()), run_trial(trial(f"believed.{key}={value}"))
    both = right.valid & wrong.valid & right.reference.domain & right.reference.wall
    shift = (wrong.range_m - right.range_m)[both]
    d = right.reference.range_m[both]
    if size is not None:
        assert np.median(shift / size(d, None)) == pytest.approx(1, abs=0.05)
        return
    # Level walls around a level baseline: d_2²/(|t| sin alpha_1) times the part of the turn along the plane's normal.
    x = directions(right.trial.panorama)[both]
    p, t = points(x, d), right.pair.motion.t_v1
    plane = np.cross(t, x)
    sine = np.linalg.norm(plane, axis=1) / np.linalg.norm(t)
    n_z = plane[:, 2] / np.linalg.norm(plane, axis=1)
    d_2 = np.linalg.norm(p - t, axis=1)
    expected = -(d_2**2) / (np.linalg.norm(t) * sine) * np.radians(value) * n_z
    clear = np.abs(expected) > 0.02
    assert np.median((shift / expected)[clear]) == pytest.approx(1, abs=0.05)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "cause"),
    # The twelve seeds draw 1.14 and 0.70 standard deviations, root of the mean square.
    [("t_length", 0.01, "t length"), ("odometry.along", 0.03, "odometry")],
    ids=["constant", "odometry"],
)
def test_a_budget_predicts_what_is_measured(key, value, cause):
    """Errors are those that follow from the very numbers that the seeds have drawn."""
    experiment = load_experiment(
        {
            "name": "b",
            "trial": trial("scoring.budget=true", f"believed.sigma.{key}={value}").model_dump(mode="json"),
            "axes": {"seed": list(range(12))},
        }
    )
    done = [(planned, row_of(run_trial(planned.trial))) for planned in experiment.planned]
    entries = budget_of(done)
    sideways = budget_of(done, "alpha_bin")
    assert {each["alpha_1_deg"] for each in sideways} == {40.0, 60.0, 80.0, 100.0, 120.0, 140.0}
    assert all(set(each["predicted_m"]) == set(entries[0]["predicted_m"]) for each in sideways)
    pixels = [
        sum(each["pixels"] for each in done[0][1]["budget"] if over in each) for over in ("range_bin", "alpha_bin")
    ]
    assert pixels[0] <= pixels[1] < 1.01 * pixels[0]  # bins of the range with few pixels are left out
    assert {tuple(each["causes"]) for each in entries} == {(cause,)}
    for each in entries:
        assert each["seeds"] >= 10  # a bin counts where a view has enough of it
        assert each["predicted_m"][cause] == pytest.approx(value * each["range_m"], rel=0.25)
        assert each["measured_ci95_m"][0] < each["measured_m"] < each["measured_ci95_m"][1]
    # The matcher's own part, which is not all predicted, is small beside so much where walls are near.
    ratios = [each["over_drawn"] for each in entries if 1.5 < each["range_m"] < 4]
    assert np.median(ratios) == pytest.approx(1, abs=0.1)


def test_a_drawn_tilt_that_is_none_is_named():
    with pytest.raises(InputError, match=r"trial\.believed\.sigma, as drawn: misalignment\.rotation_x_deg: must"):
        misaligned(Sensor(), {"misalignment.rotation_x_deg": 130.0})


def test_a_pooled_histogram_gives_its_share():
    rng = np.random.default_rng(4)
    counts = [np.histogram(np.abs(1.3 * rng.standard_normal(20_000)), Z_EDGES)[0].tolist() for _ in range(9)]

    unit = np.histogram(np.abs(rng.standard_normal(200_000)), Z_EDGES)[0].tolist()
    planned = Planned("", {"seed": 0}, trial(), ("slanted", "own"))
    entry = {"range_bin": 2, "pixels": 20_000, "predicted_m": {"matching": 0.01}, "total_m": 0.01}
    (result,) = budget_of((planned, {"budget": [entry | {"z": each, "z_drawn": unit}]}) for each in counts)
    assert result["measured_m"] == pytest.approx(0.013, rel=0.01)
    assert result["over_drawn"] == pytest.approx(1.3, rel=0.01)
    assert result["over_drawn_ci95"][0] < 1.3 < result["over_drawn_ci95"][1] * 1.01
    assert result["alone_m"] is None
    assert [parameter.key for parameter in MOTION][-1] == "t_length"


def test_causes_alone_count_where_they_are_of_the_same_size():
    counts = np.histogram(np.abs(np.random.default_rng(5).standard_normal(20_000)), Z_EDGES)[0].tolist()
    sizes = {"own": {}, "small": {"rotation": 0.03}, "large": {"rotation": 0.3}, "length": {"t length": 0.04}}
    sizes["together"] = {"rotation": 0.03, "t length": 0.04}
    done = []
    for name, causes in sizes.items():
        predicted = {"matching": 0.01} | causes
        total = float(np.sqrt(sum(each**2 for each in predicted.values())))
        entry = {"range_bin": 2, "pixels": 20_000, "predicted_m": predicted, "total_m": total}
        planned = Planned("", {"case": name}, trial(), ("slanted", "own"))
        done.append((planned, {"budget": [entry | {"z": counts, "z_drawn": counts}]}))
    result = {each["case"]: each for each in budget_of(done)}
    assert list(result) == list(sizes)
    # Of the two rotations the small one; the histogram of 20,000 draws has its share at 1 to a per cent.
    assert result["together"]["alone_m"] == pytest.approx(np.sqrt(0.01**2 + 0.03**2 + 0.04**2), rel=0.02)


@pytest.mark.parametrize(
    ("misalignment", "left"),
    [
        ({"y_mm": 1.0}, 0.12),
        ({"rotation_x_deg": 0.5}, 0.02),
        ({"z_mm": 1.0}, 1e-3),
    ],
)
def test_a_central_calibration_takes_most_of_a_misalignment_away(misalignment, left):
    """A tenth is left of a shift across the baseline, a fiftieth of a tilt; one along the axis is a focal length."""
    nominal = Sensor()
    sensor = nominal.model_copy(update={"misalignment": Misalignment(**misalignment)})
    motion = Motion(np.eye(3), np.array([0.5, 0, 0]))
    x = normalise(np.random.default_rng(0).normal(size=(2000, 3)))
    points = 3 * x[in_field(nominal, x) & (np.hypot(x[:, 1], x[:, 2]) >= 0.5)]
    true = Rig((sensor, sensor), motion)
    costs = []
    for alignment in ("nominal", "central"):
        believed = calibrated(true, Believed(alignment=alignment))
        costs.append(np.nanmedian(np.abs(range_errors(points, true, believed))))
    assert costs[1] < left * costs[0]
    fit = nearest_central(sensor)
    assert fit.sensor.is_central
    # The residual is the distance of its pixels from those of the misaligned mirror, here over other points.
    off = project(fit.sensor, points)[0] - project_points(sensor, points)[0]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) == pytest.approx(fit.rms_px, rel=0.35, abs=1e-4)
    assert nearest_central(nominal).rms_px == 0


def test_only_mirrors_are_misaligned():
    with pytest.raises(
        InputError, match=r"believed\.sigma\.alignment_mm and _deg are for sensors with a hyperboloid mirror"
    ):
        load_experiment("smoke", sets=["sensor=fisheye", "believed.sigma.alignment_mm=0.1"])


def test_a_camera_that_sees_nothing_in_its_mirror_is_refused():
    with pytest.raises(InputError, match=r"sensor\.misalignment: no pixel of the image sees the mirror"):
        harness.render("box", sensor={"misalignment": {"x_mm": 500.0}}, position_m=(0, 0, 1), samples=1)


def test_errors_that_one_of_two_sensors_cannot_have_are_named():
    rig = Rig((Sensor(), harness.load_sensor("fisheye")), Motion(np.eye(3), np.array([0.5, 0, 0])))
    with pytest.raises(InputError, match=r"trial\.believed: an error of 'model\.a_m' is believed, .* has no such"):
        believed_rig(rig, Believed(shape=0.01), {})
    focal = [each.camera.focal_px for each in believed_rig(rig, Believed(focal=0.01), {}).sensors]
    assert focal == pytest.approx([1.01 * each.camera.focal_px for each in rig.sensors])
