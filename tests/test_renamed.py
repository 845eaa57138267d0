"""Keys under their former names: read as the present ones, with one line that says so; and runs kept under them."""

import json
import warnings
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import AliasChoices, Field

import harness
import harness.runs.store as store_module
from harness.camera.lens import Lens
from harness.camera.models import Mirror
from harness.camera.sensor import Sensor
from harness.errors import InputError, Notice
from harness.io.calibrations.sensors import load_sensor
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys, dotted_up_to_date, up_to_date, up_to_date_key
from harness.runs.details import details_of
from harness.runs.load import load_experiment
from harness.runs.recorded import recorded
from harness.runs.run import DATABASE, open_run, result_of, rows_of, run_experiment
from harness.runs.settings_reference import find_settings
from harness.runs.store import Store
from harness.simulation.noise import words_of
from harness.spec import Spec, as_table, parse

SMALL = {"width_px": 64, "height_px": 48, "focal_px": 61.412, "cx_px": 31.5, "cy_px": 23.5}
PANORAMA = {"width_px": 72, "height_px": 20}


class Lid(Spec):
    size_m: float = Field(default=1.0, validation_alias=AliasChoices("size_m", "width_m"))


class Box(Spec):
    kind: str = "box"
    lid: Lid = Field(default=Lid(), validation_alias=AliasChoices("lid", "cover", "top"))
    lids: tuple[Lid, ...] = ()
    by_name: dict[str, Lid] = Field(default={})
    free: Any = 0


class Boxes(Spec):
    base: Box = Box()
    axes: Annotated[dict[str, list[Any]], DottedKeys(Box, listed=True)] = Field(default={})


@pytest.mark.parametrize(
    ("table", "present", "places"),
    [
        ({"cover": {"size_m": 2}}, {"lid": {"size_m": 2}}, ["cover"]),
        ({"top": {"width_m": 2}, "kind": "b"}, {"lid": {"size_m": 2}, "kind": "b"}, ["top", "top.width_m"]),
        ({"lids": [{}, {"width_m": 2}]}, {"lids": [{}, {"size_m": 2}]}, ["lids[1].width_m"]),
        (
            {"by_name": {"width_m": {"width_m": 2}}},
            {"by_name": {"width_m": {"size_m": 2}}},
            ["by_name.width_m.width_m"],
        ),
        ({"free": {"cover": 1}}, {"free": {"cover": 1}}, []),  # anything may stand here: nothing is known of its keys
        ({"lids": 3, "cover": None}, {"lids": 3, "lid": None}, ["cover"]),  # wrong, which is for others to say
    ],
)
def test_tables(table: dict, present: dict, places: list[str]) -> None:
    before = json.dumps(table)
    result, renamed = up_to_date(Box, table)
    assert result == present
    assert [each.where for each in renamed] == places
    assert json.dumps(table) == before  # not written to
    assert list(result) == [{"cover": "lid", "top": "lid"}.get(key, key) for key in table]  # nor put in another order


def test_what_has_no_former_name_is_returned_itself() -> None:
    table = {"base": {"lids": [{"size_m": 1}], "free": [1]}, "axes": {"free": [1]}}
    result, renamed = up_to_date(Boxes, table)
    assert result["base"] is table["base"]
    assert renamed == []


def test_dotted_keys_and_the_tables_at_them() -> None:
    table = {"axes": {"cover.width_m": [1, 2], "lids.0.width_m": [3], "top": [{"width_m": 3}], "free": [4]}}
    with pytest.raises(InputError, match=r"^axes\.top: 'top' is now called 'lid'; give only that one"):
        up_to_date(Boxes, {"axes": {"lid": [], **table["axes"]}})
    result, renamed = up_to_date(Boxes, table)
    values = {"lid.size_m": [1, 2], "lids.0.size_m": [3], "lid": [{"size_m": 3}], "free": [4]}
    assert result == {"axes": values}
    assert list(result["axes"]) == list(values)
    assert len(renamed) == 5
    assert dotted_up_to_date(DottedKeys(Box), {"cover": {"width_m": 3}})[0] == {"lid": {"size_m": 3}}
    assert up_to_date_key(Box, "cover.width_m") == "lid.size_m"
    assert up_to_date_key(Box, "nothing.width_m") == "nothing.width_m"


def test_one_line_for_each_name_and_file() -> None:
    table = {"base": {"cover": {}}, "axes": {"cover.size_m": [1]}}
    with pytest.warns(Notice) as said:
        boxes = parse(Boxes, table, file="boxes.toml")
    assert boxes == Boxes(axes={"lid.size_m": [1]})
    assert len(said) == 1
    assert str(said[0].message) == (
        "boxes.toml: base.cover, axes.cover.size_m: 'cover' is now called 'lid'; "
        "the next version will not read the former name"
    )


def test_both_names_are_refused() -> None:
    with pytest.raises(InputError) as caught:
        parse(Box, {"cover": {}, "lid": {}}, file="box.toml")
    assert str(caught.value) == "box.toml: cover: 'cover' is now called 'lid'; give only that one"


def test_attributes_and_arguments() -> None:
    box = Box(cover=Lid(width_m=3.0))
    assert box.lid.size_m == 3
    with pytest.warns(Notice, match=r"^Box\.cover: 'cover' is now called 'lid'"):
        assert box.cover is box.lid
    with pytest.raises(AttributeError):
        _ = box.nothing
    assert "cover" not in box.model_dump()


# --- The one that there is: a sensor's `mirror` is its `model` ----------------------------------------------------

MIRROR = r"'mirror' is now called 'model'"


def test_in_python() -> None:
    with pytest.warns(Notice, match=f"^Sensor: {MIRROR}"):
        sensor = Sensor(mirror={"a_m": 0.03})
    assert sensor.model == Mirror(a_m=0.03)


def test_sensor_file(tmp_path: Path) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text("[mirror]\na_m = 0.03\n", encoding="utf-8")
    with pytest.warns(Notice, match=rf"sensor\.toml: mirror: {MIRROR}") as said:
        sensor = load_sensor(path)
    assert sensor.model.a_m == 0.03
    assert len(said) == 1
    (tmp_path / "experiment.toml").write_text('name = "x"\ntrial = { scene = "box", sensor = "sensor.toml" }\n')
    with pytest.warns(Notice, match=MIRROR):
        assert load_experiment(tmp_path / "experiment.toml").trial.sensor == sensor


def test_experiment_and_options() -> None:
    table = {
        "name": "x",
        "trial": {"scene": "box", "sensor": {"mirror": {"a_m": 0.03}}},
        "axes": {"sensor.mirror.b_m": [0.02, 0.03]},
        "cases": [{"name": "a", "sensor.mirror.a_m": 0.025}, {"name": "b", "sensor": {"mirror": {"a_m": 0.03}}}],
    }
    with pytest.warns(Notice, match=rf"trial\.sensor\.mirror, axes\.sensor\.mirror\.b_m, cases.*: {MIRROR}") as said:
        experiment = load_experiment(table)
    assert len(said) == 1
    assert experiment.axes == {"sensor.model.b_m": [0.02, 0.03]}
    places = [each.coordinates for each in experiment.planned]
    assert [list(place) for place in places] == [["case", "sensor.model.b_m"]] * 4
    assert [list(case) for case in experiment.cases] == [["name", "sensor.model.a_m"], ["name", "sensor"]]
    assert experiment.planned[0].trial.sensor.model.a_m == 0.025

    plain = {"name": "x", "trial": {"scene": "box"}, "axes": {"sensor.model.b_m": [0.02]}}
    with pytest.warns(Notice, match=rf"^--set: sensor\.mirror\.b_m: {MIRROR}"):
        assert load_experiment(plain, sets=["sensor.mirror.b_m=0.03"]).axes == {}
    with pytest.warns(Notice, match=rf"^axes: sensor\.mirror\.b_m: {MIRROR}"):
        assert load_experiment(plain, axes={"sensor.mirror.b_m": [0.03]}).axes == {"sensor.model.b_m": [0.03]}
    with pytest.raises(InputError, match=r"--axis: sensor\.mirror\.b_m: .* give only that one"):
        load_experiment(plain, axes=["sensor.model.b_m=0.02", "sensor.mirror.b_m=0.03"])
    assert [each.key for each in find_settings("sensor.mirror.a_m")] == ["sensor.model.a_m"]


def test_no_notice_where_all_is_new() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_experiment("paper", axes={"sensor.model.b_m": [0.02]})
        parse(Sensor, as_table(Sensor()))


def _as_before(value: Any) -> Any:
    """What the version before wrote."""
    if isinstance(value, dict):
        renamed = {key.replace("sensor.model.", "sensor.mirror."): _as_before(each) for key, each in value.items()}
        if "model" in renamed and "camera" in renamed:
            renamed = {"mirror": {key: each for key, each in renamed.pop("model").items() if key != "kind"}} | renamed
        return renamed
    return [_as_before(each) for each in value] if isinstance(value, list) else value


@pytest.mark.slow
def test_a_run_of_the_version_before(tmp_path: Path) -> None:
    """Its trials keep their keys, its answers are found, and columns have the present names; nobody is told."""
    experiment = load_experiment(
        {"name": "x", "trial": {"scene": "box", "sensor": {"camera": SMALL}, "panorama": PANORAMA}},
        axes={"sensor.model.b_m": [0.0234, 0.03]},
    )
    run_experiment(experiment, tmp_path, workers=1)
    with open_run(experiment, tmp_path) as store:
        result_of(experiment, store)  # keeps the answers of what is shown in detail
        for fact in ("experiment", "plan", "details"):
            store.set_fact(fact, _as_before(store.fact(fact)))
        assert '"mirror"' in json.dumps(store.fact("details"))
    with Store(tmp_path / DATABASE) as store:
        again = recorded(store, tmp_path / DATABASE)
        assert len(rows_of(again, store)) == 2
        assert (again.trial, again.axes) == (experiment.trial, experiment.axes)
        assert not details_of(again, list(again.planned), store, run_code=False).left_out
        assert store.answer(again.planned[0].key) is not None
    assert [(each.key, each.coordinates) for each in again.planned] == [
        (e.key, e.coordinates) for e in experiment.planned
    ]
    opened = harness.open_results(tmp_path)
    assert opened.trials["sensor.model.b_m"].tolist() == [0.0234, 0.03]
    assert opened.outcome({"sensor.mirror.b_m": 0.03}).trial.sensor.model.b_m == 0.03
    assert opened.report().is_file()


def test_a_run_of_a_version_without_the_key_law_keeps_its_test(tmp_path: Path) -> None:
    """Every run was tested then; one of today says itself whether it is."""
    experiment = load_experiment({"name": "x", "trial": {"scene": "box"}})
    with open_run(experiment, tmp_path) as store:
        assert not recorded(store, tmp_path / DATABASE).law
        fact = store.fact("experiment")
        assert fact.pop("law") is False
        store.set_fact("experiment", fact)
        assert recorded(store, tmp_path / DATABASE).law


@pytest.mark.slow
def test_a_run_of_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rows are reported as they were made, which is said, and they stay the other code's."""
    table = {"name": "x", "trial": {"scene": "box", "sensor": {"camera": SMALL}, "panorama": PANORAMA}}
    experiment = load_experiment(table, axes={"sensor.model.b_m": [0.0234, 0.03]})
    monkeypatch.setattr(store_module, "code_hash", lambda: "older")
    made = run_experiment(experiment, tmp_path, workers=1)
    with open_run(experiment, tmp_path) as store:
        for fact in ("experiment", "plan", "details"):
            store.set_fact(fact, _as_before(store.fact(fact)))
    monkeypatch.undo()
    with pytest.warns(Notice, match="made by other code or libraries than today's"):
        opened = harness.open_results(tmp_path)
    assert opened.trials["sensor.model.b_m"].tolist() == [0.0234, 0.03]
    figures = [row.finished.figures["density"] for row in made.rows]
    assert opened.trials["density"].tolist() == figures
    assert opened.report().is_file()
    assert opened.environment["trials_made_by"].endswith("older")
    with Store(tmp_path / DATABASE) as store:
        assert store.finished(each.key for each in experiment.planned) == {}  # nothing of it became today's
        assert store.fact("details") == _as_before(store.fact("details"))
    run_experiment(experiment, tmp_path, workers=1)
    assert len(harness.open_results(tmp_path).trials) == 2  # today's, without a word


def test_noise_is_that_of_the_version_before() -> None:
    """Draws are named by the sensor's text, which was this one when its model was the mirror."""
    lens = Lens(k1=-0.1, p2=1e-5)
    before = (
        '{"mirror":{"a_m":0.0281,"b_m":0.03},'
        '"camera":{"width_px":640,"height_px":480,"focal_px":614.12,"aspect":1.0,"cx_px":319.5,"cy_px":239.5},'
        '"lens":{"k1":-0.1,"k2":0.0,"p1":0.0,"p2":0.00001,"k3":0.0},'
        '"field":{"elevation_min_deg":-75.0,"elevation_max_deg":20.0}}'
    )
    assert words_of(Sensor(model=Mirror(b_m=0.03), lens=lens)) == before


def test_a_trial_is_the_same_under_both_names() -> None:
    tables = ({"scene": harness.load_scene("box"), "sensor": {name: {"a_m": 0.03}}} for name in ("model", "mirror"))
    with pytest.warns(Notice, match=f"^Sensor: {MIRROR}"):
        one, other = (Trial.model_validate(table) for table in tables)
    assert one.key == other.key
