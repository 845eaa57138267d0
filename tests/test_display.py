"""Reprs are one short line; completion shows the project's names and none of its libraries'."""

import pytest

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor
from harness.display import LONGEST
from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome, run_trial
from harness.runs.load import load_experiment


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return run_trial(load_experiment("smoke").planned[0].trial)


def test_a_specification_shows_what_differs_from_its_defaults() -> None:
    assert repr(Sensor()) == str(Sensor()) == "Sensor()"
    camera = Camera(width_px=160, height_px=120, cx_px=79.5, cy_px=59.5)
    assert repr(camera) == "Camera(width_px=160, height_px=120, cx_px=79.5, cy_px=59.5)"
    assert repr(load_experiment("paper")) == "Experiment('paper', 24 trials: seed (12), matching.subpixel (2))"


@pytest.mark.slow
def test_no_repr_prints_an_array_or_a_second_line(outcome: Outcome) -> None:
    parts = [outcome, outcome.trial, outcome.trial.scene, load_experiment("law")]
    parts += [
        getattr(outcome, name) for name in ("pair", "truth", "curves", "matches", "reference", "layout", "errors")
    ]
    parts += [outcome.pair.motion, outcome.panoramas[0]]
    for each in parts:
        text = repr(each)
        assert "\n" not in text
        assert "array(" not in text
        assert len(text) <= LONGEST + 40
        assert text.startswith(type(each).__name__)
    assert "alpha_2=float64[50, 180]" in repr(outcome.matches)
    assert repr(outcome.pair.motion) == "Motion(R_v2_from_v1=float64[3, 3], t_v1=[0.3, 0, 0])"


def test_completion_shows_keys_and_no_pydantic_machinery(outcome: Outcome) -> None:
    shown = {name for name in dir(outcome.trial) if not name.startswith("_")}
    added = {"key", "poses", "true_motion", "sensors", "assumed_sensors", "lenses", "is_noisy"}
    added |= {"bound_noise_grey", "belief_draws"}
    assert shown == {*Trial.model_fields, *added}
    of_sensor = {name for name in dir(Sensor) if not name.startswith("_")}
    assert of_sensor == {*Sensor.model_fields, "looks", "mirrored", "with_mask", "is_central", "aligned"}
    assert Sensor().model_copy().model_dump() == Sensor().model_dump()  # hidden, and there
