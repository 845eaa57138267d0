"""Settings and axes that the command line, or a call, puts over those of an experiment."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from harness.camera import models
from harness.display import shortened
from harness.errors import InputError
from harness.matching import registry
from harness.pipeline.specification import Trial
from harness.runs.cases import check_cases, key_of_name, label, settings_of
from harness.runs.dotted import KIND, MODEL_KINDS, changed
from harness.runs.experiment import Experiment
from harness.runs.named_files import absolute
from harness.runs.values import Settings, identity_of, text_of
from harness.spec import Spec, as_given, parse
from harness.toml import parse_toml


def read_values(option: str, texts: Iterable[str]) -> Settings:
    """The keys and values of an option that is given as `key=value`, once for each key.

    Raises
    ------
    InputError
        When one is not written so, or a key is given twice; names the option.
    """
    values: Settings = {}
    for key, text in (split(option, each) for each in texts):
        if key in values:
            raise InputError("is given twice; leave one out", file=option, key=key)
        try:
            values[key] = _value(text)
        except InputError as error:
            raise InputError(error.problem, file=option, key=key) from error
    return values


def split(option: str, text: str) -> tuple[str, str]:
    """The two sides of `key=value`; errors as in `read_values`."""
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise InputError(f"must be written key=value; found '{shortened(text)}'", key=option)
    return key.strip(), value.strip()


_POINT_AT_AN_END = re.compile(r"[+-]?(?:\.\d+|\d+\.)(?:e[+-]?\d+)?", re.IGNORECASE)
"""Numbers as people write them, which TOML does not allow: `.5`, `-2.`, `1.e-3`."""


def _value(text: str) -> Any:
    """A value of the command line: TOML, a number, or else the text itself."""
    if _POINT_AT_AN_END.fullmatch(text):
        return float(text)
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if len(table) == 1 else text  # a line's end in it may begin another key


def values_of(text: str, key: str) -> list[Any]:
    """The values of an axis on the command line: a TOML list without its brackets, or words between commas."""
    try:
        table = parse_toml(f"values = [{text}]")
    except InputError as error:
        raise InputError(error.problem, file="--axis", key=key) from error
    except ValueError:
        table = {}
    return table["values"] if len(table) == 1 else [_value(each.strip()) for each in text.split(",") if each.strip()]


def plain(value: Any) -> Any:
    """A value as TOML has it: NumPy's numbers and arrays as plain ones, tuples as lists, paths as text."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Spec):
        return as_given(value)
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def listed(key: str, values: Any) -> list[Any]:
    """The values of an axis given in Python, as TOML has them.

    Raises
    ------
    InputError
        When they are no list.
    """
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(f"must be a list of values; found {values!r}", file="axes", key=key)
    return [plain(each) for each in values]


def check_of_use(settings: Settings, set_option: str, axes: Mapping[str, list[Any]], axis_option: str) -> None:
    """Check that no axis that is given too makes a setting void.

    Raises
    ------
    InputError
        When an axis over the same key has other values only, or one over a key around it replaces the setting; names
        `set_option`.
    """
    for key, value in settings.items():
        for axis in axes:
            if key.startswith(f"{axis}."):
                problem = f"is replaced by each value of {axis_option} {axis}; write it there"
                raise InputError(problem, file=set_option, key=key)
        # The base trial is shown in detail, so which of the values it has is worth saying.
        known = [identity_of(key, absolute(key, each, Path(), axis_option)) for each in axes.get(key, ())]
        if known and identity_of(key, absolute(key, value, Path(), set_option)) not in known:
            problem = f"{text_of(value)} is none of the values of {axis_option} {key}; add it there, or leave one out"
            raise InputError(problem, file=set_option, key=key)


def with_sets(experiment: Experiment, settings: Settings, option: str) -> Experiment:
    """An experiment with other settings of its base trial; an axis over one of these keys is dropped.

    Raises
    ------
    InputError
        When a case gives one of the keys, or a setting is not valid; names `option`.
    """
    for number, case in enumerate(experiment.cases):
        for key in settings.keys() & settings_of(case).keys():
            problem = f"{label(case, number)} gives this key; change it there, in the experiment's file"
            raise InputError(problem, file=option, key=key)
    if not settings:
        return experiment
    settings = {key: absolute(key, value, Path(), option) for key, value in settings.items()}
    trial = parse(Trial, changed(as_given(experiment.trial), settings, file=option), file=option)
    axes = {key: values for key, values in experiment.axes.items() if key not in settings}
    # Keys that another matcher, or another camera model, does not have cannot be varied.
    axes = {key: values for key, values in axes.items() if all(_is_known(key, *each) for each in settings.items())}
    changed_experiment = experiment.model_copy(update={"trial": trial, "axes": axes})
    scene = settings.get("scene")
    return changed_experiment.with_scene_file(scene if isinstance(scene, str) else "") if scene else changed_experiment


def with_axes(experiment: Experiment, given: Mapping[str, list[Any]], option: str) -> Experiment:
    """An experiment with more axes, or other values on those that it has.

    Raises
    ------
    InputError
        When a case gives one of the keys, or an axis has no value; names `option`.
    """
    for key, values in given.items():
        if not values:
            raise InputError("give at least one value", file=option, key=key)
        for number, case in enumerate(experiment.cases):
            if key in settings_of(case):
                problem = f"{label(case, number)} gives this key; change it there, in the experiment's file"
                raise InputError(problem, file=option, key=key)
    merged = experiment.axes | {
        key: [absolute(key, value, Path(), option) for value in values] for key, values in given.items()
    }
    # An axis over a key that one of the given matchers, or camera models, does not have cannot be varied.
    merged = {
        key: values
        for key, values in merged.items()
        if key in given or all(_is_known(key, other, kind) for other, kinds in given.items() for kind in kinds)
    }
    return experiment.model_copy(update={"axes": merged})


def with_cases(experiment: Experiment, cases: list[Settings]) -> Experiment:
    """An experiment with other cases; paths in them are relative to the working folder.

    Raises
    ------
    InputError
        When a case has no name that can be shown, or the key of an axis; names the case.
    """
    try:
        placed = [
            {key: absolute(key, value, Path(), "cases", f"cases[{number}].{key}") for key, value in case.items()}
            for number, case in enumerate(cases)
        ]
        # Parsed like the values of a file, so that a wrong type gives the same message.
        changed_experiment = parse(type(experiment), as_given(experiment) | {"cases": placed})
        check_cases(changed_experiment.cases, experiment.axes)
    except InputError as error:
        where = error.key or ""
        key = key_of_name(where, cases) if where.startswith("cases[") else error.key
        raise InputError(error.problem, file="cases", key=key) from error
    return experiment.model_copy(update={"cases": changed_experiment.cases})


def _is_known(key: str, other: str, kind: Any) -> bool:
    """Whether a key is still one where another key has a certain value, which may be a `kind`."""
    table = other.removesuffix("kind")
    if not key.startswith(table) or other not in (KIND, *MODEL_KINDS):
        return True
    name = key.removeprefix(table).partition(".")[0]
    return registry.knows(kind, name) if other == KIND else models.knows(kind, name)
