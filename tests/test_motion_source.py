"""`motion.source`: what a trial with an estimated motion stores of it, and what the report says it costs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from harness.cli import main
from harness.errors import InputError
from harness.evaluation.motion_cost import motion_figures, range_shift
from harness.geometry.angles import angle_between, normalise
from harness.geometry.motion_error import MotionError, sensitivity_to_motion
from harness.geometry.pose import Motion
from harness.pipeline.row import row_of
from harness.pipeline.specification import Trial
from harness.pipeline.stages import StageKeys, setup_of
from harness.pipeline.trial import MATCH, MOTION, NOISE, PAIR, run_trial
from harness.report.sections.motion_cost import AUC_DEG, area_under_recall
from harness.simulation.scene import load_scene
from harness.spec import parse

SCENE = load_scene("box")
T = np.array([0.4, 0.1, -0.05])


def trial(**changes):
    base = {"scene": SCENE.model_dump(mode="json"), "render": {"samples": 4}, "matching": {"kind": "column"}}
    return parse(Trial, base | {"view_2": {"yaw_deg": 50.0}, "noise": {"sigma_grey": 4.0}} | changes)


def points(draws, count=400):
    x = normalise(draws.normal(size=(count, 3)))
    return x[np.sin(angle_between(x, T)) > 0.4]


def believed(true, omega, tau):
    length = true.baseline_m
    R = true.R_v2_from_v1 @ Rotation.from_rotvec(omega).as_matrix()
    return Motion(R, length * normalise(true.t_v1 / length + tau))


# --- The cost -------------------------------------------------------------------------------------------------------


def test_the_shift_of_ranges_is_the_linear_one_for_small_errors():
    draws = np.random.default_rng(1)
    true = Motion(Rotation.from_euler("z", 1.0).as_matrix(), T)
    x, d = points(draws), 3.0
    omega, tau = 1e-5 * draws.normal(size=3), 1e-5 * np.cross(draws.normal(size=3), normalise(T))
    shift = range_shift(true, believed(true, omega, tau), x, np.full(len(x), d))
    linear = sensitivity_to_motion(x, np.full(len(x), d), T) @ np.concatenate([omega, tau])
    # The second order is some (d/|t|)² of the first, times 1e-5.
    np.testing.assert_allclose(shift, linear, rtol=5e-3, atol=1e-6)
    assert range_shift(true, true, x, np.full(len(x), d)) == pytest.approx(0, abs=1e-12)  # rounding of 3 m


def test_errors_over_sigma_are_one_where_the_covariance_is_right():
    draws = np.random.default_rng(2)
    true = Motion(np.eye(3), T)
    x = points(draws)
    d = draws.uniform(1, 4, len(x))
    across = np.eye(3) - np.outer(normalise(T), normalise(T))
    C = np.zeros((6, 6))
    C[:3, :3], C[3:, 3:] = 1e-8 * np.eye(3), 4e-8 * across
    z, angle = [], []
    for _ in range(200):
        omega, tau = 1e-4 * draws.normal(size=3), 2e-4 * across @ draws.normal(size=3)
        figures = motion_figures(true, believed(true, omega, tau), MotionError(C, np.zeros(6)), x, d)
        z.append(figures["motion_range_z"])
        assert figures["motion_rotation_deg"] == pytest.approx(np.degrees(np.linalg.norm(omega)), rel=1e-6)
        angle.append(figures["motion_direction_deg"])
    # 200 draws of five numbers: 0.05 is two and a half sigma of the root of the mean square, at 3 degrees of freedom.
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.1)
    assert np.sqrt(np.mean(np.square(angle))) == pytest.approx(np.degrees(2e-4 * np.sqrt(2)), rel=0.15)


def test_errors_in_degrees_and_shares():
    true = Motion(np.eye(3), T)
    other = believed(true, np.radians([0.0, 0.0, 0.3]), np.zeros(3))
    x = points(np.random.default_rng(3))
    error = MotionError(1e-6 * np.eye(6), np.zeros(6))
    figures = motion_figures(true, other, error, x, np.full(len(x), 2.0))
    assert figures["motion_rotation_deg"] == pytest.approx(0.3, rel=1e-9)
    assert figures["motion_direction_deg"] == pytest.approx(0, abs=1e-6)  # of an arc cosine near 1
    none = motion_figures(true, other, error, x[:0], np.empty(0))
    assert np.isnan(none["motion_range_z"])


# --- The stage ------------------------------------------------------------------------------------------------------


def test_a_trial_that_does_not_say_has_its_former_key_and_the_true_motion():
    assert trial().key == trial(motion={"source": "truth"}).key
    assert trial().key != trial(motion={"source": "estimated"}).key


def test_keys_of_stages():
    one, other, noisier = (
        StageKeys(setup_of(each))
        for each in (
            trial(motion={"source": "truth"}),
            trial(motion={"source": "estimated"}),
            trial(motion={"source": "estimated"}, noise={"sigma_grey": 5.0}),
        )
    )
    assert one.of(NOISE) == other.of(NOISE)
    for stage in (MOTION, PAIR, MATCH):
        assert one.of(stage) != other.of(stage) != noisier.of(stage)


@pytest.mark.slow
def test_the_matcher_is_given_the_estimated_motion():
    outcome = run_trial(trial(motion={"source": "estimated"}), threads=1)
    true, given = outcome.trial.true_motion, outcome.pair.motion
    assert given.baseline_m == pytest.approx(true.baseline_m, rel=1e-12)
    turned = Rotation.from_matrix(given.R_v2_from_v1.T @ true.R_v2_from_v1).magnitude()
    assert 0 < np.degrees(turned) < 0.02  # some sigma
    assert outcome.estimated.status == "ok"
    row = row_of(outcome)
    assert row["motion"] == {"status": "ok", "reasons": []}
    assert row["figures"]["motion_rotation_deg"] == pytest.approx(np.degrees(turned), rel=1e-6)
    assert 0.2 < row["figures"]["motion_range_z"] < 3  # five numbers of variance 1
    assert "motion" in outcome.seconds
    plain = run_trial(trial(), threads=1)
    assert plain.estimated is None
    assert "motion" not in plain.seconds
    assert not [name for name in row_of(plain)["figures"] if name.startswith("motion_")]
    medians = [row_of(each)["figures"]["range_median_abs_m"] for each in (outcome, plain)]
    assert medians[0] == pytest.approx(medians[1], rel=0.03)


@pytest.mark.slow
def test_a_motion_that_cannot_be_told_fails_the_trial_by_its_key():
    still = trial(motion={"source": "estimated"}, view_2={"baseline_m": 1e-4, "yaw_deg": 20.0})
    with pytest.raises(
        InputError, match=r"trial.motion.source: the images do not determine the motion \(no parallax\)"
    ):
        run_trial(still, threads=1)


EXPERIMENT = """
name = "costs"
[trial]
scene = "box"
[trial.view_2]
yaw_deg = 50.0
[trial.render]
samples = 4
[trial.noise]
sigma_grey = 10.0
[trial.matching]
kind = "column"
[axes]
"motion.source" = ["truth", "estimated"]
"""


@pytest.mark.long
@pytest.mark.slow
def test_the_report_says_what_it_costs(tmp_path):
    (tmp_path / "costs.toml").write_text(EXPERIMENT)
    assert main(["run", str(tmp_path / "costs.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "What it costs to estimate the motion" in page
    assert "In 1 trials the matcher was given" not in page
    assert "the pair of trials that differ in nothing else" in " ".join(page.split())
    table = (tmp_path / "out" / "trials.csv").read_text().splitlines()
    columns = table[0].split(",")
    values = {row.split(",")[columns.index("motion.source")]: row.split(",") for row in table[1:]}
    assert values["truth"][columns.index("motion_rotation_deg")] == ""
    assert 0 < float(values["estimated"][columns.index("motion_rotation_deg")]) < 0.05


def test_area_under_the_recall_is_its_definition():
    """By counting: the share of motions within an angle, averaged over angles up to the limit."""
    draws = np.random.default_rng(2)
    rotation, direction = draws.exponential(0.2, 300), draws.exponential(0.5, 300)
    angles = (np.arange(20_000) + 0.5) / 20_000 * AUC_DEG
    larger = np.sort(np.maximum(rotation, direction))
    recall = np.searchsorted(larger, angles, side="right") / larger.size
    # The counted share is a staircase of 20,000 steps.
    assert area_under_recall(rotation, direction) == pytest.approx(recall.mean(), abs=1e-4)
    assert area_under_recall([0.0], [0.0]) == 1
    assert area_under_recall([0.1], [2.0]) == 0
