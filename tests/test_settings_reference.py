"""The settings reference: complete, with units, and right about what the specifications accept."""

import json
import re
from collections.abc import Iterator
from typing import get_args, get_origin

import pytest
from pydantic import BaseModel

from harness.camera.models import BUILT_IN as MODELS
from harness.cli import main
from harness.matching.registry import BUILT_IN
from harness.pipeline.specification import Trial
from harness.runs.experiment import Experiment
from harness.runs.key_meanings import key_meanings
from harness.runs.load import load_experiment
from harness.runs.settings_reference import ITEM, UNITS, find_settings, settings_markdown, settings_reference


def keys_of(table: dict, stem: str = "") -> Iterator[str]:
    """The dotted keys of a dumped specification, items of lists under the reference's index."""
    for name, value in table.items():
        key = f"{stem}{name}"
        yield key
        if isinstance(value, dict) and name not in ("axes", "parameters"):
            yield from keys_of(value, f"{key}.")
        if isinstance(value, list | tuple):
            for each in (each for each in value if isinstance(each, dict) and name == "objects"):
                yield from keys_of(each, f"{key}.{ITEM}.")


def specifications(annotation: object) -> Iterator[type[BaseModel]]:
    """Every specification that an annotation leads to."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from specifications(field.annotation)
    elif get_origin(annotation) is not None:
        for each in get_args(annotation):
            yield from specifications(each)


def test_every_key_of_every_specification_has_a_meaning() -> None:
    for spec in set(specifications(Experiment)):
        for name, field in spec.model_fields.items():
            assert field.description or key_meanings(spec)[name], f"{spec.__name__}.{name}"
    assert all(each.meaning for each in settings_reference())


def test_a_key_with_a_unit_in_its_name_shows_it() -> None:
    for each in settings_reference():
        endings = [ending for ending in UNITS if each.key.endswith(ending)]
        assert bool(each.unit) == bool(endings), each.key
    units = {each.key: each.unit for each in settings_reference()}
    assert units["view_2.baseline_m"] == "m"
    assert units["matching.window_px"] == "px"
    assert units["matching.p1_per_px"] == "per pixel"  # not px
    assert units["view_1.yaw_deg"] == "degrees"
    assert units["matching.timeout_s"] == "s"
    assert units["seed"] == ""


@pytest.mark.parametrize("name", ["paper", "peers", "matchers", "limit"])
def test_no_key_of_a_shipped_experiment_is_left_out(name: str) -> None:
    known = {each.key for each in settings_reference()}
    experiment = load_experiment(name)
    for trial in {each.trial for each in experiment.planned}:
        # Every side of a box may have a texture, whose keys are listed once.
        keys = {
            re.sub(r"\.(sides|bottom|top|[xy]_(min|max))\.", ".texture.", key) for key in keys_of(trial.model_dump())
        }
        assert keys <= known
    assert set(keys_of({"name": "", "description": "", "axes": {}, "cases": []})) <= known


def test_defaults_are_those_of_the_specifications() -> None:
    scene = load_experiment("paper").trial.scene
    base = Trial.model_validate({"scene": scene, "view_1": {}}).model_dump(mode="json")
    for each in settings_reference():
        first, *rest = each.key.split(".")
        if first == "scene" or first not in base or not rest or each.default in ("", "required"):
            continue
        if first == "matching":
            for kind in (kind for kind in each.kinds if kind in BUILT_IN and kind != "program"):
                assert json.loads(each.default) == BUILT_IN[kind]().model_dump(mode="json")[rest[0]]
            continue
        if each.key.startswith("sensor.model.") and "hyperboloid" not in each.kinds:
            for kind in each.kinds:
                assert json.loads(each.default) == MODELS[kind].model_fields[rest[-1]].default
            continue
        if each.key == "sensor.profile.kind":  # by default there is no profile
            assert (json.loads(each.default),) == each.kinds
            continue
        value = base
        for part in (first, *rest):
            value = value[part]
        assert json.loads(each.default) == value, each.key
    (missing,) = (each for each in settings_reference() if each.key == "view_1")
    assert missing.default == "{ position_m = [0.0, 0.0, 1.0] }"
    assert Trial.model_validate({"scene": scene}).view_1.position_m == (0.0, 0.0, 1.0)


def test_kinds_of_matcher_are_told() -> None:
    windows = {each.kinds: each for each in find_settings("matching.window_px")}
    assert windows["window", "column"].default == "11"
    assert windows["window", "column"].type == "whole number, 1 .. 99"
    assert windows["slanted",].default == "17"
    (shortest,) = find_settings("matching.d_min_m")
    assert {*BUILT_IN, "any other"} == set(shortest.kinds)


@pytest.mark.parametrize(
    ("key", "listed"),
    [
        ("scene.objects.0.size_m", "scene.objects.N.size_m"),
        ("scene.objects[2].texture.tile_m", "scene.objects.N.texture.tile_m"),
        ("trial.noise.sigma_grey", "noise.sigma_grey"),
        ("baseline_m", "view_2.baseline_m"),
        ("axes", "axes"),
    ],
)
def test_a_key_is_found_as_it_is_written_elsewhere(key: str, listed: str) -> None:
    assert {each.key for each in find_settings(key)} == {listed}


def test_settings_prints_type_unit_default_meaning_and_kinds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["settings", "matching.consistency_px"]) == 0
    said = capsys.readouterr().out
    assert "    kind     sgm\n    type     number, at least 0\n    unit     px\n    default  2.0\n" in said
    assert "    kind     slanted\n" in said
    assert "meaning  Largest difference from view 2's own match, panorama pixels." in said
    assert main(["settings"]) == 0
    assert capsys.readouterr().out.count("    meaning") == len(settings_reference())


def test_settings_as_markdown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["settings", "matching.edge_grey", "--markdown"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("## `matching`\n")
    assert "| `matching.edge_grey` | `sgm` | number, 0 .. 255 | grey levels | `0.0` | P2 becomes" in said
    assert "\\|grey difference\\|" in said  # a bar would begin another cell
    rows = [line for line in settings_markdown(settings_reference()).splitlines() if line.startswith("| `")]
    assert len(rows) == len(settings_reference())


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("matching.windw_px", "unknown key 'matching.windw_px'; did you mean 'matching.window_px'?"),
        ("baselin_m", "unknown key 'baselin_m'; did you mean 'baseline_m'?"),
        ("qqqq", "unknown key 'qqqq'; omnirange settings lists them all"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest(key: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["settings", key]) == 2
    assert capsys.readouterr().err == f"omnirange: KEY: {said}\n"
