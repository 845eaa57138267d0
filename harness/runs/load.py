"""Experiments and matchers from names, files, tables and the command line."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness import shipped
from harness.errors import InputError
from harness.matching.interface import MatcherSettings
from harness.matching.registry import Matcher
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys, dotted_up_to_date, give_notice
from harness.runs.dotted import changed
from harness.runs.experiment import Experiment
from harness.runs.named_files import absolute, of_matcher, read_in
from harness.runs.overrides import listed, plain, read_value, split, values_of, with_axes, with_sets
from harness.spec import Spec, parse
from harness.toml import read_toml

Source = str | Path | Mapping[str, Any] | Experiment
"""An experiment by shipped name or path, as a table like that of a file, or read already."""


def load_experiment(
    source: Source, sets: Sequence[str] | Mapping[str, Any] = (), axes: Sequence[str] | Mapping[str, Any] = ()
) -> Experiment:
    """Read an experiment.

    `trial.scene` may be a table, a shipped name or a path; `trial.sensor` a table or a path. Paths are relative to the
    experiment's file, or the working folder where there is none, and absolute in what is returned.

    Parameters
    ----------
    sets
        `key=value`, or keys and values: settings of the base trial; an axis over the same key is dropped. With
        `matching.kind`, so are axes over settings that this matcher does not have.
    axes
        `key=a,b,c`, or keys and lists of values: further axes, or other values of one that is there. In text, values
        are as in TOML, or plain words. With an axis over `matching.kind`, the experiment's own axes are dropped that
        one of those matchers does not know.

    Raises
    ------
    InputError
        Names the file or the option, the key and what would be right.
    """
    experiment, file = _read_experiment(source)
    set_option = "sets" if isinstance(sets, Mapping) else "--set"
    axis_option = "axes" if isinstance(axes, Mapping) else "--axis"
    if isinstance(sets, Mapping):
        settings = {str(key): plain(value) for key, value in sets.items()}
    else:
        settings = dict(read_value("--set", each) for each in sets)
    if isinstance(axes, Mapping):
        values = {str(key): listed(str(key), each) for key, each in axes.items()}
    else:
        values = {key: values_of(text, key) for key, text in (split("--axis", each) for each in axes)}
    settings = _up_to_date(DottedKeys(Trial), settings, set_option)
    values = _up_to_date(DottedKeys(Trial, listed=True), values, axis_option)
    changed = with_axes(with_sets(experiment, settings, set_option), values, axis_option)
    try:
        _ = changed.planned
    except InputError as error:
        if error.file is not None:  # a file of the scene is at fault
            raise
        if error.key in {f"axes.{key}" for key in values}:
            raise InputError(error.problem, file=axis_option, key=error.key.removeprefix("axes.")) from error
        for key in settings:
            if f"{error.key}.".startswith(f"trial.{key}.") or f"trial.{key}" == f"{error.key}.file":
                raise InputError(error.problem, file=set_option, key=key) from error
        raise InputError(error.problem, file=file, key=error.key) from error
    return changed


def _up_to_date(keys: DottedKeys, given: dict[str, Any], option: str) -> dict[str, Any]:
    """What an option gives, under the present names of its keys."""
    try:
        present, renamed = dotted_up_to_date(keys, given)
    except InputError as error:
        raise InputError(error.problem, file=option, key=error.key) from error
    give_notice(renamed, option)
    return dict(present)


def _read_experiment(source: Source) -> tuple[Experiment, Path | None]:
    """An experiment as it is given, and the file that it is from."""
    if isinstance(source, Experiment):
        return source, None
    if isinstance(source, Mapping):
        table, folder, file = dict(source), Path(), None
    else:
        file = shipped.find("experiments", str(source))
        table, folder = read_toml(file), file.parent
    scene = None
    if isinstance(table.get("trial"), dict):
        scene = table["trial"].get("scene")
        trial = read_in(table["trial"], folder, file, "trial")
        table["trial"] = {key: of_matcher(key, value, folder) for key, value in trial.items()}
    experiment = _with_absolute_paths(parse(Experiment, table, file=file), folder, file or "")
    return experiment.with_scene_file(absolute("scene", scene, folder, "") if isinstance(scene, str) else ""), file


def _with_absolute_paths(experiment: Experiment, folder: Path, file: str | Path) -> Experiment:
    for number, case in enumerate(experiment.cases):
        for key in case.keys() & experiment.axes.keys():
            raise InputError(
                "this key is also an axis; give it only once", file=file or None, key=f"cases[{number}].{key}"
            )
    axes = {
        key: [absolute(key, value, folder, file, f"axes.{key}") for value in values]
        for key, values in experiment.axes.items()
    }
    cases = [
        {key: absolute(key, value, folder, file, f"cases[{number}].{key}") for key, value in case.items()}
        for number, case in enumerate(experiment.cases)
    ]
    return experiment.model_copy(update={"axes": axes, "cases": cases})


class _Matching(Spec):
    matching: Matcher
    """The matcher and its settings."""


def load_matcher(
    kind_or_path: str, sets: Sequence[str] = (), parameters: Mapping[str, Any] | None = None
) -> MatcherSettings:
    """The settings of one matcher: by its `kind` alone, or from the table `matching` of a TOML file.

    Parameters
    ----------
    kind_or_path
        A path ends in `.toml`; the file may be an experiment, whose base trial's matcher is meant.
    sets
        `matching.key=value`: settings.
    parameters
        More of what only the matcher understands, see `Parametrised`.

    Raises
    ------
    InputError
        When there is no such matcher, or it does not take its settings.
    """
    file = None
    table: dict[str, Any] = {"matching": {"kind": kind_or_path}}
    if kind_or_path.endswith(".toml"):
        file = Path(kind_or_path)
        read = read_toml(file)
        trial = read.get("trial", read)
        if not (isinstance(trial, dict) and isinstance(trial.get("matching"), dict)):
            raise InputError("has no table [matching], nor [trial.matching]", file=file)
        table = {"matching": absolute("", trial["matching"], file.parent, file)}
    settings = {
        key: absolute(key, value, Path(), "--set") for key, value in (read_value("--set", each) for each in sets)
    }
    table = changed(table, settings, file="--set")
    if parameters:
        table["matching"]["parameters"] = {**table["matching"].get("parameters", {}), **parameters}
    matcher = parse(_Matching, table, file=file).matching
    try:
        matcher.check()
    except InputError as error:
        raise InputError(error.problem, file=file, key=f"matching.{error.key}") from error
    return matcher
