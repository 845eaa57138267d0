"""Errors of a calibration that are drawn from its covariance, as `omnirange calibrate` has written it."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import write_small

from harness.api.designing import describe_rig
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.evaluation.calibrated import CalibrationCovariance
from harness.evaluation.propagation import Rig, propagated, range_errors, sensitivities
from harness.evaluation.rig_uncertainty import Uncertainty, covariances
from harness.geometry.pose import Motion
from harness.pipeline.believed import Believed, believed_rig, draws_of

KEYS = ("camera.focal_px", "camera.cx_px", "camera.cy_px", "model.b_m")
SIGMA = np.array([0.8, 0.15, 0.12, 2e-5])
SENSOR = Sensor()
MOTION = Motion(R_v2_from_v1=np.eye(3), t_v1=np.array([0.5, 0.0, 0.0]))


def covariance(seed=0):
    """A covariance of correlated parameters: focal length and mirror nearly compensate each other."""
    rng = np.random.default_rng(seed)
    mixed = rng.standard_normal((4, 4)) + 2 * np.eye(4)
    mixed[0] += 3 * mixed[3]
    matrix = mixed @ mixed.T
    scale = SIGMA / np.sqrt(np.diag(matrix))
    return scale[:, None] * matrix * scale


def file_of(folder, keys=KEYS, matrix=None):
    """What `omnirange calibrate` writes, as far as it is read."""
    matrix = covariance() if matrix is None else matrix
    path = folder / "camera.json"
    path.write_text(json.dumps({"parameters": [{"key": key} for key in keys], "covariance": np.array(matrix).tolist()}))
    return path


def numbers_of(sensor):
    return np.array([getattr(getattr(sensor, key.partition(".")[0]), key.partition(".")[2]) for key in KEYS])


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_factor_is_a_root_of_the_covariance(seed):
    matrix = covariance(seed)
    known = CalibrationCovariance(keys=KEYS, covariance=matrix.tolist())
    root = known.factor()
    # A ridge of 1e-9 of the variances keeps nearly singular matrices positive.
    assert np.abs((root @ root.T - matrix) / np.outer(SIGMA, SIGMA)).max() < 1e-8


@pytest.mark.slow
def test_draws_have_the_covariance():
    """4,000 draws tell a correlation to 1/sqrt(4000) = 0.016, and so a variance to 0.022; four of that."""
    matrix = covariance()
    believed = Believed(sigma=Uncertainty(calibration=CalibrationCovariance(keys=KEYS, covariance=matrix.tolist())))
    true = Rig((SENSOR, SENSOR), MOTION)
    errors = []
    for seed in range(4000):
        draws = draws_of(SENSOR, believed.sigma, MOTION, seed)
        first, second = believed_rig(true, believed, draws).sensors
        assert first == second
        errors.append(numbers_of(first) - numbers_of(SENSOR))
    found = np.cov(np.array(errors).T) / np.outer(SIGMA, SIGMA)
    assert np.abs(found - matrix / np.outer(SIGMA, SIGMA)).max() < 4 * 0.022


@pytest.mark.slow
def test_ranges_are_off_by_what_is_propagated():
    """Against draws through the closed formulas; 2,000 tell a standard deviation to 1.6 %."""
    known = Uncertainty(calibration=CalibrationCovariance(keys=KEYS, covariance=covariance().tolist()))
    points = np.array([[0.3, 2.0, -0.2], [1.0, -3.0, 0.3], [-1.5, 1.5, -0.8]])
    rig = Rig((SENSOR, SENSOR), MOTION)
    ((parameters, matrix),) = [(each[1], each[2]) for each in covariances(SENSOR, known, MOTION) if each[2].any()]
    predicted = propagated(sensitivities(points, rig, parameters), matrix)
    rng = np.random.default_rng(5)
    root = known.calibration.factor()
    errors = []
    for _ in range(2000):
        off = root @ rng.standard_normal(4)
        table = SENSOR.model_dump()
        for key, error in zip(KEYS, off, strict=True):
            part, _, name = key.partition(".")
            table[part][name] += error
        wrong = Sensor.model_validate(table)
        errors.append(range_errors(points, Rig((wrong, wrong), MOTION), rig))
    assert np.std(errors, axis=0) == pytest.approx(predicted, rel=0.05)


@pytest.mark.slow
def test_what_compensates_costs_less_than_each_alone():
    """With the same variances, ranges are surer where a focal length's error goes with the mirror's than without."""
    compensating = np.diag(SIGMA**2)
    compensating[0, 3] = compensating[3, 0] = 0.99 * SIGMA[0] * SIGMA[3]
    opposing = compensating * np.where(np.eye(4) > 0, 1, -1)
    sigmas = []
    for matrix in (np.diag(SIGMA**2), compensating, opposing):
        known = {"keys": KEYS, "covariance": matrix.tolist()}
        rig = describe_rig({"baseline_m": 0.5, "uncertainty": {"calibration": known}}, ranges_m=[4.0])
        sigmas.append(float(rig.table.calibration.iloc[0]))
    independent, one, other = sigmas
    assert min(one, other) < 0.9 * independent
    assert max(one, other) > 1.1 * independent


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_experiment_names_the_file(tmp_path, monkeypatch):
    file_of(tmp_path)
    rest = '\n[trial.believed.sigma]\ncalibration = "camera.json"\n\n[trial.scoring]\nbudget = true\n'
    rest += '\n[trial.matching]\nkind = "slanted"\n'
    given_file = write_small(tmp_path / "small.toml", rest)
    out = tmp_path / "out"
    monkeypatch.chdir("/")
    assert main(["run", str(given_file), "--out", str(out)]) == 0
    budget = json.loads((out / "summary.json").read_text())["budget"]
    assert all("calibration" in each["causes"] for each in budget)
    (tmp_path / "camera.json").unlink()  # its contents are in the run's own file
    assert main(["run", str(given_file.with_name("out") / "experiment.toml"), "--dry-run"]) == 0


@pytest.mark.parametrize(
    ("keys", "matrix", "said"),
    [
        (("misalignment.x_mm",), [[1.0]], "is no key of a central sensor's calibration; calibrate without"),
        (("camera.focal_px",), [[1.0, 0.0]], "covariance must be 1 x 1"),
        (("camera.focal_px",), [[-1.0]], "variances of 0 or more"),
        (("camera.focal_px", "camera.cx_px"), [[1.0, 0.5], [0.4, 1.0]], "must be symmetric"),
        (("camera.focal_px", "camera.cx_px"), [[1.0, 2.0], [2.0, 1.0]], "no negative eigenvalue"),
        (("camera.focal_px", "camera.cx_px"), [[1.0, 0.1], [0.1, 0.0]], "in the row and column of a variance of 0"),
    ],
)
def test_what_is_no_covariance_is_refused(keys, matrix, said, tmp_path, capsys):
    file_of(tmp_path, keys, matrix)
    given_file = write_small(tmp_path / "small.toml", '\n[trial.believed.sigma]\ncalibration = "camera.json"\n')
    assert main(["run", str(given_file), "--dry-run"]) == 2
    message = capsys.readouterr().err
    assert said in message
    assert "small.toml: trial.believed.sigma.calibration" in message


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"parameters": [1], "covariance": [[1]]}'])
def test_a_file_that_is_no_calibration_is_refused(text, tmp_path, capsys):
    (tmp_path / "camera.json").write_text(text)
    given_file = write_small(tmp_path / "small.toml", '\n[trial.believed.sigma]\ncalibration = "camera.json"\n')
    assert main(["run", str(given_file), "--dry-run"]) == 2
    assert "must be what omnirange calibrate writes" in capsys.readouterr().err


def test_a_file_that_is_not_there_is_named(tmp_path, capsys):
    given_file = write_small(tmp_path / "small.toml", '\n[trial.believed.sigma]\ncalibration = "none.json"\n')
    assert main(["run", str(given_file), "--dry-run"]) == 2
    assert "none.json" in capsys.readouterr().err


def test_without_one_a_trial_keeps_its_key():
    plain = Uncertainty(rotation_deg=0.1)
    assert plain == Uncertainty(rotation_deg=0.1, calibration=None)
