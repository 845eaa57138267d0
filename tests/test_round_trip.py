"""Whatever a specification allows survives every trip: through TOML, through JSON, to a worker."""

import json
import math
import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from specifications import PLAIN, TEXT, specification
from sweeps import write_small

from harness.errors import InputError
from harness.matching.registry import BUILT_IN, Plugin
from harness.pipeline.specification import Trial
from harness.runs.experiment import MOST_TRIALS, Experiment
from harness.runs.load import load_experiment
from harness.runs.store import Store
from harness.runs.worker import pack
from harness.simulation.scene import Box, Scene
from harness.simulation.texture import GreyTexture
from harness.spec import as_table, dump_toml, parse

MATCHERS = [*dict.fromkeys(BUILT_IN.values())]
kinds = st.sampled_from(["a.b:c", "m:f"])
matchers = st.one_of(
    *(specification(each, kind=st.sampled_from([k for k, v in BUILT_IN.items() if v is each])) for each in MATCHERS),
    specification(Plugin, kind=kinds),
)
trials = specification(Trial, matching=matchers)
some = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.slow
@some
@given(trials)
def test_a_trial_survives(trial: Trial) -> None:
    table = as_table(trial)
    assert Trial.model_validate(table) == trial
    assert Trial.model_validate(json.loads(json.dumps(table))) == trial
    assert Trial.model_validate(pickle.loads(pickle.dumps(table))) == trial
    assert parse(Trial, tomllib.loads(dump_toml(trial))) == trial


@pytest.mark.slow
@some
@given(
    specification(
        Experiment,
        name=st.just("x"),
        description=TEXT,
        trial=trials,
        axes=st.dictionaries(TEXT, st.lists(PLAIN, min_size=1, max_size=3), max_size=3),
        cases=st.lists(
            st.dictionaries(TEXT, PLAIN, min_size=1, max_size=2).map(lambda case: {"name": "a"} | case), max_size=2
        ),
    )
)
def test_an_experiment_survives(experiment: Experiment) -> None:
    with Store() as store:
        store.set_fact("experiment", as_table(experiment))
        stored = parse(Experiment, store.fact("experiment"))
    for again in (parse(Experiment, tomllib.loads(dump_toml(experiment))), stored):
        assert again.trial == experiment.trial
        # By their text: the order of keys counts, and NaN is not equal to itself.
        assert json.dumps([again.axes, again.cases]) == json.dumps([experiment.axes, experiment.cases])


ROOM = Box(kind="box", size_m=(4, 4, 3), inward=True, texture=GreyTexture(kind="grey", value=9))
SCENE = Scene(name="s", objects=(ROOM,))
floats = st.floats(0.01, 50)
CASES = [{"noise.sigma_grey": 1.5}, {"matching": {"d_max_m": math.inf}}]


@some
@given(
    st.fixed_dictionaries(
        {},
        optional={
            "matching.d_max_m": st.lists(st.sampled_from([math.inf, 5.0, 7]), min_size=1, unique=True),
            "seed": st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=3, unique=True),
            "view_2.baseline_m": st.lists(floats, min_size=1, max_size=2, unique=True),
            "scene.objects.0.size_m": st.lists(st.tuples(floats, floats, floats), min_size=1, max_size=2, unique=True),
            "placement.random_yaw": st.just([False, True]),
        },
    ),
    st.lists(st.sampled_from(CASES), max_size=2, unique_by=str),
)
def test_the_written_experiment_plans_the_same_trials(axes: dict, cases: list) -> None:
    cases = [{"name": f"case {number}", **case} for number, case in enumerate(cases)]
    if any("matching" in case for case in cases):
        axes.pop("matching.d_max_m", None)
    experiment = Experiment(name="x", trial=Trial(scene=SCENE), axes=axes, cases=cases)
    again = parse(Experiment, tomllib.loads(dump_toml(experiment)))
    assert again == experiment
    assert again.planned == experiment.planned
    for (key, _, table), planned in zip(pack(experiment.planned).trials, experiment.planned, strict=True):
        assert Trial.model_validate(table) == planned.trial
        assert Trial.model_validate(table).key == planned.key == key


@pytest.mark.parametrize(
    "rest",
    [
        '[axes]\n"matching.d_max_m" = [5, 10, inf]\n',
        '[[cases]]\nname = "a"\n"matching.d_max_m" = inf\n[[cases]]\nname = "b"\n"matching.d_max_m" = 5\n',
        '[axes]\nmatching = [{ kind = "m:f", parameters = { a = inf, b = [-inf, nan] } }]\n',
    ],
)
def test_infinity_reaches_the_trials_of_the_written_file(tmp_path: Path, monkeypatch, rest: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text("def f(pair, limits, *, a, b): ...\n")
    experiment = load_experiment(str(write_small(tmp_path / "e.toml", rest)))
    (tmp_path / "again.toml").write_text(dump_toml(experiment))
    again = load_experiment("again.toml")
    assert [each.key for each in again.planned] == [each.key for each in experiment.planned]
    assert "inf" in dump_toml(again)


def test_a_parameter_of_another_type_is_another_trial() -> None:
    one, two = (Plugin(kind="m:f", parameters={"a": value}) for value in (1, 1.0))
    assert one != two


def test_numpy_numbers_and_tuples_become_plain() -> None:
    experiment = Experiment(
        name="x", trial=Trial(scene=SCENE), axes={"seed": np.arange(2).tolist(), "noise.sigma_grey": (np.float64(1),)}
    )
    assert [each.coordinates for each in experiment.planned] == [
        {"seed": 0, "noise.sigma_grey": 1.0},
        {"seed": 1, "noise.sigma_grey": 1.0},
    ]


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (None, "TOML has no value for None"),
        ("\ud800", r"text must be Unicode without lone surrogates; found '\ud800'"),
        (object(), "must be text, a number, true, false, a list or a table; found <object"),
        ({1: 2}, "the keys of a table must be text"),
    ],
)
def test_what_toml_cannot_write_is_refused(value: object, problem: str) -> None:
    table = {"name": "x", "trial": Trial(scene=SCENE), "axes": {"matching.parameters.a": [value]}}
    with pytest.raises(InputError) as caught:
        parse(Experiment, table)
    assert str(caught.value).startswith(f"axes: {problem}")


# --- Copies --------------------------------------------------------------------------------------------------------


def test_a_copy_plans_its_own_trials() -> None:
    experiment = Experiment(name="x", trial=Trial(scene=SCENE))
    assert len(experiment.planned) == 1
    seeds = experiment.model_copy(update={"axes": {"seed": [7, 8, 9]}})
    assert [each.trial.seed for each in seeds.planned] == [7, 8, 9]
    other = seeds.model_copy(update={"trial": seeds.trial.model_copy(update={"seed": 42}), "axes": {}}, deep=True)
    assert [each.trial.seed for each in other.planned] == [42]


# --- Limits --------------------------------------------------------------------------------------------------------


def test_a_huge_product_is_counted_and_not_enumerated() -> None:
    thousand = list(range(1000))
    experiment = Experiment(
        name="x",
        trial=Trial(scene=SCENE),
        axes={"seed": thousand, "view_2.yaw_deg": thousand, "matching.kind": ["column"], "view_2.roll_deg": thousand},
        cases=[{"name": "a", "noise.sigma_grey": 1}, {"name": "b", "noise.sigma_grey": 2}],
    )
    with pytest.raises(InputError) as caught:
        _ = experiment.planned
    assert str(caught.value) == (
        f"axes: 2000000000 trials are more than the {MOST_TRIALS} that an experiment may have: "
        "2 cases x seed (1000 values) x view_2.yaw_deg (1000 values) x view_2.roll_deg (1000 values)"
    )


def test_a_scene_edited_between_two_calls_is_read_again(tmp_path: Path) -> None:
    scene = tmp_path / "room.toml"
    path = write_small(tmp_path / "e.toml", '[axes]\nscene = ["room.toml"]\n')
    scales = []
    for scale in ("1.0", "2.0"):  # of the same length, within the same second
        scene.write_text(dump_toml(SCENE).replace("scale = 1.0", f"scale = {scale}"))
        scales.append(load_experiment(str(path)).planned[0].trial.scene.scale)
    assert scales == [1, 2]
