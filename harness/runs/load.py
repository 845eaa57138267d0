"""Experiments and matchers from names, files, tables and the command line."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness import shipped
from harness.display import brief
from harness.errors import InputError
from harness.matching.interface import MatcherSettings
from harness.matching.registry import Matcher
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys, dotted_up_to_date, give_notice
from harness.runs.cases import NAME, check_cases, key_of_name, named
from harness.runs.dotted import KIND, changed
from harness.runs.experiment import Experiment
from harness.runs.named_files import absolute, of_matcher, read_in
from harness.runs.overrides import (
    check_of_use,
    listed,
    plain,
    read_values,
    split,
    values_of,
    with_axes,
    with_cases,
    with_sets,
)
from harness.runs.values import text_of
from harness.spec import Spec, parse
from harness.toml import read_toml

Source = str | Path | Mapping[str, Any] | Experiment
"""An experiment by shipped name or path, as a table like that of a file, or read already."""


def load_experiment(
    source: Source,
    sets: Sequence[str] | Mapping[str, Any] = (),
    axes: Sequence[str] | Mapping[str, Any] = (),
    cases: Mapping[str, Mapping[str, Any]] | None = None,
) -> Experiment:
    """Read an experiment.

    `trial.scene` may be a table, a shipped name or a path; `trial.sensor` a table or a path. Paths are relative to the
    experiment's file, or the working folder where there is none, and absolute in the result.

    Parameters
    ----------
    sets
        `key=value`, or keys and values: settings of the base trial; an axis over the same key is dropped. With
        `matching.kind`, so are axes over settings that this matcher does not have. Where `axes` has the key too, it is
        one of those values: that of the base trial.
    axes
        `key=a,b,c`, or keys and lists of values: further axes, or other values of one that is there. In text, values
        are as in TOML, or plain words. With an axis over `matching.kind`, the experiment's own axes are dropped that
        one of those matchers does not know.
    cases
        Names and the keys and values of each: cases instead of the experiment's own.

    Raises
    ------
    InputError
        Names the file or the option, the key and what would be right.
    """
    experiment, file = _read_experiment(source)
    if cases is not None:
        experiment = experiment.model_copy(update={"cases": []})
    set_option = "sets" if isinstance(sets, Mapping) else "--set"
    axis_option = "axes" if isinstance(axes, Mapping) else "--axis"
    if isinstance(sets, Mapping):
        settings = {str(key): plain(value) for key, value in sets.items()}
    else:
        settings = read_values("--set", sets)
    if isinstance(axes, Mapping):
        values = {str(key): listed(str(key), each) for key, each in axes.items()}
    else:
        values = _axes_of(axes)
    settings = _up_to_date(DottedKeys(Trial), settings, set_option)
    values = _up_to_date(DottedKeys(Trial, listed=True), values, axis_option)
    check_of_use(settings, set_option, values, axis_option)
    changed = with_axes(with_sets(experiment, settings, set_option), values, axis_option)
    if cases is not None:
        changed = with_cases(changed, _cases_up_to_date(cases))
    try:
        _ = changed.planned
    except InputError as error:
        blamed = _blamed(error, changed, file, (set_option, settings), (axis_option, values), cases is not None)
        if blamed.file == (file and str(file)) and (settings or values) and _is_valid(experiment):
            # What no option names is wrong with all of them together.
            where = None if error.key in (None, "axes") else error.key.removeprefix("axes.").removeprefix("trial.")
            blamed = InputError(error.problem, file=axis_option if values else set_option, key=where)
        if blamed is error:
            raise
        raise blamed from error
    return changed


def own_axes(source: Source) -> tuple[str, ...]:
    """The keys of an experiment's own axes, whether or not it is valid without any option."""
    experiment, _ = _read_experiment(source)
    return tuple(experiment.axes)


def _axes_of(options: Sequence[str]) -> dict[str, list[Any]]:
    """The axes of `--axis`; one that is given twice could mean either or both."""
    axes: dict[str, list[Any]] = {}
    for key, text in (split("--axis", each) for each in options):
        if key in axes:
            raise InputError(f"is given twice; write all values in one: --axis {key}=A,B", file="--axis", key=key)
        axes[key] = values_of(text, key)
    return axes


def _blamed(
    error: InputError,
    changed: Experiment,
    file: Path | None,
    sets: tuple[str, Mapping[str, Any]],
    axes: tuple[str, Mapping[str, Any]],
    has_own_cases: bool,
) -> InputError:
    """The error of an experiment, attributed to the option and the key at fault, or else to its file.

    Parameters
    ----------
    sets, axes
        The name of the option, and what was given.
    has_own_cases
        Whether the cases are those of the call.
    """
    key = error.key or ""
    if error.file is not None:  # a file of the scene is at fault
        return error
    if has_own_cases and key.startswith("cases["):
        return InputError(error.problem, file="cases", key=key_of_name(key, changed.cases))
    if key in {f"axes.{each}" for each in axes[1]}:
        return InputError(error.problem, file=axes[0], key=key.removeprefix("axes."))
    for each, values in axes[1].items():
        if key.startswith(f"axes.{each}."):  # another axis leads into the values of this one
            plain = next((value for value in values if not isinstance(value, Mapping | str)), None)
            problem = error.problem if plain is None else f"must be a table; found {text_of(plain)}"
            return InputError(problem, file=axes[0], key=each)
    for each in sets[1]:
        if f"{key}.".startswith(f"trial.{each}.") or f"trial.{each}" == f"{key}.file":
            return InputError(error.problem, file=sets[0], key=each)
    return InputError(error.problem, file=file, key=error.key)


def _is_valid(experiment: Experiment) -> bool:
    """Whether an experiment is valid as it was before any option."""
    try:
        return bool(experiment.planned)
    except InputError:
        return False


def _cases_up_to_date(cases: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Cases given in Python, as a file has them."""
    if not isinstance(cases, Mapping):
        raise InputError("must be a dictionary: for each name the keys and values of the case", key="cases")
    for name, settings in cases.items():
        if not isinstance(settings, Mapping):
            raise InputError(f"must be a dictionary of keys and values; found {brief(settings)}", key=f"cases: {name}")
        if NAME in settings:
            raise InputError("unknown key; a case is named by the dictionary around it", key=f"cases: {name}: {NAME}")
    up_to_date = {
        name: _up_to_date(DottedKeys(Trial), {str(key): plain(value) for key, value in settings.items()}, "cases")
        for name, settings in cases.items()
    }
    return named(up_to_date)


def _up_to_date(keys: DottedKeys, given: dict[str, Any], option: str) -> dict[str, Any]:
    """The settings that an option gives, under the present names of their keys."""
    for key in given:
        name, _, rest = key.partition(".")
        if name == "trial" and rest:
            raise InputError(f"begins at the trial; write '{rest}'", file=option, key=key)
        if name in Experiment.model_fields:
            problem = "is a key of the experiment, not of its trials; write it at the top of the experiment's file"
            raise InputError(problem, file=option, key=key)
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
        if "objects" in table and "trial" not in table:
            use = f"see `omnirange render`, or give `--set scene={source}` with an experiment"
            raise InputError(f"is a scene, not an experiment; {use}", file=file)
    scene = None
    if isinstance(table.get("trial"), dict):
        scene = table["trial"].get("scene")
        trial = read_in(table["trial"], folder, file, "trial")
        table["trial"] = {key: of_matcher(key, value, folder) for key, value in trial.items()}
    experiment = _with_absolute_paths(parse(Experiment, table, file=file), folder, file or "")
    return experiment.with_scene_file(absolute("scene", scene, folder, "") if isinstance(scene, str) else ""), file


def _with_absolute_paths(experiment: Experiment, folder: Path, file: str | Path) -> Experiment:
    try:
        check_cases(experiment.cases, experiment.axes)
    except InputError as error:
        raise InputError(error.problem, file=file or None, key=error.key) from error
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
    settings = {key: absolute(key, value, Path(), "--set") for key, value in read_values("--set", sets).items()}
    for key in settings:
        if key in ("matching", KIND):
            raise InputError(f"the matcher is given already: {kind_or_path}; leave this out", file="--set", key=key)
        if not key.startswith("matching."):
            raise InputError("must begin with 'matching.', such as matching.window_px=7", file="--set", key=key)
    table = changed(table, settings, file="--set")
    if parameters:
        table["matching"]["parameters"] = {**table["matching"].get("parameters", {}), **parameters}
    try:
        matcher = parse(_Matching, table, file=file).matching
    except InputError as error:
        if error.key in settings:
            raise InputError(error.problem, file="--set", key=error.key) from error
        raise
    try:
        matcher.check()
    except InputError as error:
        raise InputError(error.problem, file=file, key=f"matching.{error.key}") from error
    return matcher
