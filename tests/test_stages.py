"""Stages of a trial: what is shared, what is not, and one from outside."""

from types import SimpleNamespace

import numpy as np
import pytest

from harness.matching.program import Program
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.stages import Stage, StageKeys, Work, setup_of
from harness.pipeline.trial import BOUND, MATCH, NOISE, PAIR, RENDER, STAGES, TRUTH, run_trial, sharing_keys
from harness.runs.load import load_experiment
from harness.runs.plan import Plan, plan
from harness.simulation.scene import load_scene
from harness.spec import parse

SMALL = {
    "sensor": {"camera": {"width_px": 80, "height_px": 60, "focal_px": 76.7, "cx_px": 39.5, "cy_px": 29.5}},
    "panorama": {"width_px": 90, "height_px": 25},
    "render": {"samples": 1},
    "noise": {"sigma_grey": 2.0},
}


def trial(**changes):
    return parse(Trial, {"scene": load_scene("box").model_dump(mode="json"), **SMALL, **changes})


def keys(one, stage):
    made = StageKeys(setup_of(one))
    return [made.of(stage, view) for view in stage.views]


@pytest.mark.parametrize(
    ("change", "unchanged", "changed"),
    [
        ({"matching": {"window_px": 7}}, (RENDER, NOISE, TRUTH, PAIR), (MATCH,)),
        ({"filter": {"log_sigma_px": 1.0}}, (RENDER, NOISE, TRUTH), (PAIR, MATCH)),
        ({"seed": 5}, (RENDER, TRUTH), (NOISE, PAIR, MATCH)),
        ({"panorama": {"width_px": 120, "height_px": 25}}, (RENDER, NOISE), (TRUTH, PAIR, MATCH)),
        ({"render": {"samples": 4}}, (TRUTH,), (RENDER, NOISE, PAIR, MATCH, BOUND)),
    ],
)
def test_a_key_changes_with_what_its_stage_depends_on_and_with_nothing_else(change, unchanged, changed):
    one, other = trial(), trial(**change)
    assert all(keys(one, stage) == keys(other, stage) for stage in unchanged)
    assert all(
        before != after for stage in changed for before, after in zip(keys(one, stage), keys(other, stage), strict=True)
    )


def test_a_view_that_does_not_move_is_rendered_once_for_all_baselines():
    one, other = trial(), trial(view_2={"baseline_m": 0.3})
    assert keys(one, RENDER)[0] == keys(other, RENDER)[0]
    assert keys(one, RENDER)[1] != keys(other, RENDER)[1]
    assert keys(one, PAIR) != keys(other, PAIR)


def test_what_view_1_sees_is_found_once_for_all_baselines():
    cache, begun = StageCache(), []
    outcomes = {
        baseline: run_trial(trial(view_2={"baseline_m": baseline}), cache, begun.append, threads=1)
        for baseline in (0.2, 0.3)
    }
    assert begun.count("surfaces") == 2  # asked for by both
    assert outcomes[0.2].truth.normal is outcomes[0.3].truth.normal
    for baseline, outcome in outcomes.items():
        alone = run_trial(trial(view_2={"baseline_m": baseline}), threads=1)
        for name, values in vars(alone.truth).items():
            np.testing.assert_array_equal(getattr(outcome.truth, name), values)


def test_three_levels_of_noise_find_view_1_as_the_baseline_before_left_it():
    """A sweep has three noisy images of each view a baseline; those of view 1 are not made again."""
    cache, made = StageCache(), []
    for baseline in (0.2, 0.3):
        for sigma in (0.0, 4.0, 8.0):
            for view in (1, 2):
                key = (view, sigma, baseline if view == 2 else None)
                cache.get("noise", key, lambda key=key: made.append(key))
    assert len(made) == 3 + 6


def test_trials_that_differ_in_the_sub_pixel_step_share_the_search():
    one, other = (trial(matching={"subpixel": step}) for step in ("none", "parabola"))
    assert sharing_keys(one) == sharing_keys(other)
    assert keys(one, MATCH) != keys(other, MATCH)


def test_names_and_order_of_stages_are_those_of_the_pipeline():
    names = [stage.name for stage in STAGES]
    assert len(set(names)) == len(names)
    for index, stage in enumerate(STAGES):
        assert set(stage.after) <= set(STAGES[:index]), stage.name


def test_a_stage_from_outside_is_shared_timed_and_sees_what_came_before():
    calls = []

    def mean_grey(work, view):
        calls.append(view)
        return float(np.mean(work(NOISE, view)))

    brightness = Stage("brightness", mean_grey, after=(NOISE,), per_view=True)
    cache, begun = StageCache(), []
    first = Work(trial(), cache, begun.append, 1)
    values = first.both(brightness)
    outcome = run_trial(trial(matching={"window_px": 7}), cache, threads=1)
    assert values == tuple(float(np.mean(image)) for image in outcome.images)
    again = Work(trial(matching={"window_px": 7}), cache, lambda _: None, 1)
    assert again.both(brightness) == values
    assert calls == [0, 1]  # the matcher's window is nothing to it
    assert begun[:2] == ["brightness", "noise"]
    assert {"brightness", "noise", "render"} <= first.clock.seconds.keys()
    Work(trial(seed=3), cache, lambda _: None, 1).both(brightness)
    assert calls == [0, 1, 0, 1]


def test_the_matcher_is_told_the_truth():
    setup = setup_of(trial(view_2={"yaw_deg": 20.0}))
    assert setup.assumed.sensors == (setup.trial.sensor, setup.trial.sensor)
    assert np.array_equal(setup.assumed.motion.R_v2_from_v1, setup.motion.R_v2_from_v1)
    assert np.array_equal(setup.assumed.motion.t_v1, setup.motion.t_v1)


def test_the_guess_of_the_time_knows_the_matcher_and_what_is_scored():
    """Orders of magnitude that a dry run must not miss: slanted windows, estimated motions, misaligned mirrors."""

    def guess(*sets):
        base = load_experiment("noise").trial.model_dump(mode="json") | {"matching": {"kind": "column"}}
        return plan(load_experiment({"name": "guess", "trial": base}, sets=list(sets)).planned).total_s

    usual = guess()
    assert guess("matching.kind=slanted") > 2 * usual
    assert guess("motion.source=estimated") > usual + 3
    assert guess("sensor.misalignment.x_mm=1") > 1.3 * usual
    assert guess("panorama.width_px=1440", "panorama.height_px=400") > 3 * usual
    assert guess("localisation.queries=1000") == usual  # nothing is localised
    assert guess("localisation.images=[2, 8]") > 5 * usual


def test_the_time_of_others_matchers_is_not_guessed():
    assert not Plan((), (), ()).unknown
    mine = SimpleNamespace(
        trial=SimpleNamespace(matching=Program.model_construct(kind="program")), method=("program x", "own")
    )
    assert Plan((mine,), (0.0,), (True,)).unknown == ["program x"]
