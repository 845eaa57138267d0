"""What an experiment is: a base trial, axes along which its settings vary, and lists of explicit cases."""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator

from harness import shipped
from harness.camera.sensor import load_sensor
from harness.display import shortened
from harness.errors import InputError
from harness.files import path_of
from harness.matching import registry
from harness.matching.interface import MatcherSettings
from harness.matching.program import with_absolute_files
from harness.matching.registry import Matcher
from harness.matching.source_files import State, state_of
from harness.pipeline.specification import Trial
from harness.runs.methods import MethodName, method_id, method_names
from harness.runs.values import Settings, shown, text_of
from harness.simulation.fingerprint import fingerprint
from harness.simulation.scene import load_scene
from harness.spec import Spec, as_table, checked_plain, parse
from harness.toml import parse_toml, read_toml

_KIND = "matching.kind"

MOST_TRIALS = 100_000
"""The most trials of an experiment: what can be planned within seconds."""


@dataclass(frozen=True)
class Planned:
    """A trial of an experiment."""

    key: str
    """`Trial.key`."""
    place: Settings
    """The values of all keys that vary, in the order of the columns."""
    trial: Trial
    method: MethodName
    """What its method is called in this experiment."""


class Experiment(Spec):
    """A named set of trials: for each of the cases, the full product of the axes over the base trial's settings."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,79}$")]
    """The experiment's name: letters, digits, `_`, `.` and `-`. It also names the output folder."""
    description: str = ""
    """What the experiment is for, for people."""
    trial: Trial
    """The base trial."""
    axes: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(default_factory=dict)
    """Dotted keys of a trial, and the values that each takes: all combinations are run."""
    cases: list[Annotated[Settings, Field(min_length=1)]] = Field(default_factory=list)
    """Explicit settings, instead of or beside axes; without any, one case that changes nothing."""

    def __repr__(self) -> str:
        """The name, how many trials there are, and what varies."""
        count = math.prod(map(len, self.axes.values())) * max(1, len(self.cases))
        varied = [f"{key} ({len(values)})" for key, values in self.axes.items()]
        varied += [f"{len(self.cases)} cases"] if self.cases else []
        trials = f"{count} trial{'s' if count != 1 else ''}"
        return f"Experiment({self.name!r}, {shortened(': '.join([trials, ', '.join(varied)]).rstrip(': '))})"

    __str__ = __repr__

    @field_validator("axes", "cases", mode="before")
    @classmethod
    def _plain(cls, given: Any) -> Any:
        return checked_plain(given) if isinstance(given, Mapping | list | tuple) else given

    @cached_property
    def planned(self) -> tuple[Planned, ...]:
        """Every trial, case by case, in the order of the product, the last axis fastest.

        Raises
        ------
        InputError
            When there are more than `MOST_TRIALS`, a key is no key of a trial, a value is not valid there, a matcher
            from elsewhere is not there or does not take its parameters, or two trials are the same. `error.key` is the
            place in the experiment.
        """
        self._check_count()
        base = as_table(self.trial)
        columns = list(dict.fromkeys(itertools.chain(self.axes, *self.cases)))
        trials: dict[str, tuple[Settings, Trial]] = {}
        checked: dict[int, Any] = {}
        for case, settings in self._settings():
            table = _changed(base, settings, self, case)
            try:
                trial = parse(Trial, self._with_validated(table, base), checked=checked)
            except InputError as error:
                key = self._blame(error.key, settings, case) or self.place_of("", case).rstrip(".")
                raise InputError(error.problem, key=key) from error
            try:
                trial.matching.check()
            except InputError as error:
                key = self._blame(f"matching.{error.key}", settings, case) or f"trial.matching.{error.key}"
                raise InputError(error.problem, key=key) from error
            place = {key: settings[key] if key in settings else value_at(table, key) for key in columns}
            key = trial.key
            if key in trials:
                raise InputError(
                    f"two trials are the same: {shown(trials[key][0])}, and {shown(place)}; remove one",
                    key="axes" if case is None else f"cases[{case}]",
                )
            trials[key] = place, trial
        names = method_names(trial.matching for _, trial in trials.values())
        return tuple(Planned(key, *each, names[method_id(each[1].matching)]) for key, each in trials.items())

    def _with_validated(self, table: Settings, base: Settings) -> Settings:
        """A trial's table with the base trial's own parts for those that are unchanged: they need no second check."""
        return {
            name: getattr(self.trial, name) if name in base and part is base[name] else part
            for name, part in table.items()
        }

    @cached_property
    def scene_fingerprints(self) -> frozenset[str]:
        """The `fingerprint` of each scene of the trials."""
        return frozenset(fingerprint(each.trial.scene) for each in self.planned)

    def _check_count(self) -> None:
        """Count before anything is enumerated."""
        counts = {f"{len(self.cases)} cases": len(self.cases)} if self.cases else {}
        counts |= {f"{key} ({len(values)} values)": len(values) for key, values in self.axes.items()}
        total = math.prod(counts.values())
        if total > MOST_TRIALS:
            several = " x ".join(text for text, count in counts.items() if count > 1)
            problem = f"{total} trials are more than the {MOST_TRIALS} that an experiment may have: {several}"
            raise InputError(problem, key="axes" if self.axes else "cases")

    def _settings(self) -> Iterator[tuple[int | None, Settings]]:
        """The number of the case, if there are any, and what changes in the base trial."""
        for number, case in enumerate(self.cases or [{}]):
            for values in itertools.product(*self.axes.values()):
                yield number if self.cases else None, case | dict(zip(self.axes, values, strict=True))

    def _blame(self, place: str | None, settings: Settings, case: int | None) -> str | None:
        """The axis or the key of a case that a complaint about a place of the trial is due to, if it is due to one."""
        path = (place or "").replace("[", ".").replace("]", "").split(".")
        for key in settings:
            keys = key.split(".")
            shorter = min(len(keys), len(path))
            if keys[:shorter] == path[:shorter]:
                return self.place_of(key, case)
        return None

    def place_of(self, key: str, case: int | None) -> str:
        """Where in the experiment a key is given."""
        return f"axes.{key}" if key in self.axes or case is None else f"cases[{case}].{key}"


# --- Reading ------------------------------------------------------------------------------------------------------


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
        `matching.kind`, so are axes over settings that this matcher has not got.
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
        settings = {str(key): _plain(value) for key, value in sets.items()}
    else:
        settings = dict(read_value("--set", each) for each in sets)
    if isinstance(axes, Mapping):
        values = {str(key): _listed(str(key), each) for key, each in axes.items()}
    else:
        values = {key: _values(text, key) for key, text in (_split("--axis", each) for each in axes)}
    changed = _with_axes(_with_sets(experiment, settings, set_option), values, axis_option)
    try:
        _ = changed.planned
    except InputError as error:
        if error.file is not None:  # a file of the scene is at fault
            raise
        if error.key in {f"axes.{key}" for key in values}:
            raise InputError(error.problem, file=axis_option, key=error.key.removeprefix("axes.")) from error
        for key in settings:
            if f"{error.key}.".startswith(f"trial.{key}."):
                raise InputError(error.problem, file=set_option, key=key) from error
        raise InputError(error.problem, file=file, key=error.key) from error
    return changed


def _read_experiment(source: Source) -> tuple[Experiment, Path | None]:
    """An experiment as it is given, and the file that it is from."""
    if isinstance(source, Experiment):
        return source, None
    if isinstance(source, Mapping):
        table, folder, file = dict(source), Path(), None
    else:
        file = shipped.find("experiments", str(source))
        table, folder = read_toml(file), file.parent
    if isinstance(table.get("trial"), dict):
        trial = _read_in(table["trial"], folder, file, "trial")
        table["trial"] = {key: _of_matcher(key, value, folder) for key, value in trial.items()}
    return _with_absolute_paths(parse(Experiment, table, file=file), folder, file or ""), file


def _plain(value: Any) -> Any:
    """A value as TOML has it: NumPy's numbers and arrays as plain ones, tuples as lists, paths as text."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Spec):
        return as_table(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def _listed(key: str, values: Any) -> list[Any]:
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(f"must be a list of values; found {values!r}", file="axes", key=key)
    return [_plain(each) for each in values]


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
        table = {"matching": _absolute("", trial["matching"], file.parent, file)}
    settings = {
        key: _absolute(key, value, Path(), "--set") for key, value in (read_value("--set", each) for each in sets)
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


def _with_sets(experiment: Experiment, settings: Settings, option: str) -> Experiment:
    for number, case in enumerate(experiment.cases):
        for key in settings.keys() & case.keys():
            raise InputError(f"cases[{number}] gives this key; a case cannot be overruled", file=option, key=key)
    if not settings:
        return experiment
    settings = {key: _absolute(key, value, Path(), option) for key, value in settings.items()}
    trial = parse(Trial, changed(as_table(experiment.trial), settings, file=option), file=option)
    axes = {key: values for key, values in experiment.axes.items() if key not in settings}
    if _KIND in settings:  # what another matcher does not know cannot be varied
        axes = {key: values for key, values in axes.items() if _is_known(key, settings[_KIND])}
    return experiment.model_copy(update={"trial": trial, "axes": axes})


def _with_axes(experiment: Experiment, given: Mapping[str, list[Any]], option: str) -> Experiment:
    for key, values in given.items():
        if not values:
            raise InputError("give at least one value", file=option, key=key)
        for number, case in enumerate(experiment.cases):
            if key in case:
                raise InputError(f"cases[{number}] gives this key; a case cannot be overruled", file=option, key=key)
    absolute = {key: [_absolute(key, value, Path(), option) for value in values] for key, values in given.items()}
    merged = experiment.axes | absolute
    if _KIND in given:  # an axis of the experiment that one of these matchers does not know cannot be varied
        merged = {
            key: values
            for key, values in merged.items()
            if key in given or all(_is_known(key, kind) for kind in given[_KIND])
        }
    return experiment.model_copy(update={"axes": merged})


def read_value(option: str, text: str) -> tuple[str, Any]:
    """The key and the value of `key=value` on the command line.

    Raises
    ------
    InputError
        When it is not written so; names the option.
    """
    key, value = _split(option, text)
    try:
        return key, _value(value)
    except InputError as error:
        raise InputError(error.problem, file=option, key=key) from error


def _is_known(key: str, kind: Any) -> bool:
    first, *rest = key.split(".")
    return first != "matching" or not rest or registry.knows(kind, rest[0])


def _split(option: str, text: str) -> tuple[str, str]:
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


def _values(text: str, key: str) -> list[Any]:
    try:
        table = parse_toml(f"values = [{text}]")
    except InputError as error:
        raise InputError(error.problem, file="--axis", key=key) from error
    except ValueError:
        table = {}
    return table["values"] if len(table) == 1 else [_value(each.strip()) for each in text.split(",") if each.strip()]


def _with_absolute_paths(experiment: Experiment, folder: Path, file: str | Path) -> Experiment:
    for number, case in enumerate(experiment.cases):
        for key in case.keys() & experiment.axes.keys():
            raise InputError(
                "this key is an axis too; give it in one of the two", file=file or None, key=f"cases[{number}].{key}"
            )
    axes = {
        key: [_absolute(key, value, folder, file, f"axes.{key}") for value in values]
        for key, values in experiment.axes.items()
    }
    cases = [
        {key: _absolute(key, value, folder, file, f"cases[{number}].{key}") for key, value in case.items()}
        for number, case in enumerate(experiment.cases)
    ]
    return experiment.model_copy(update={"axes": axes, "cases": cases})


def _absolute(key: str, value: Any, folder: Path, file: str | Path, where: str | None = None) -> Any:
    """A value that names a file by a relative path, with its absolute path; any other as it is."""
    last = key.rpartition(".")[2]
    if (last == "command" or key == "matching.files") and isinstance(value, list):
        return with_absolute_files(value, folder, patterns=last == "files")
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else ((key, each) for each in value)
        above = "matching." if isinstance(value, dict) and "command" in value else ""  # a program's table
        parts = [(name, _absolute(f"{above}{name}", each, folder, file, where)) for name, each in items]
        return dict(parts) if isinstance(value, dict) else [each for _, each in parts]
    if not isinstance(value, str):
        return value
    if key == "scene":
        path = _scene_file(value, folder, file, where or key)
        return value if path.parent == shipped.folder("scenes") and path.stem == value else str(path.resolve())
    if key == "sensor" or last == "file" or last.endswith("_file"):
        return str(path_of(value, folder, file=file, key=where or key or None).resolve())
    return value


def _of_matcher(key: str, value: Any, folder: Path) -> Any:
    """A key of a trial's table: the files that a matcher's settings name made absolute, all else as it is."""
    return _absolute("", value, folder, folder) if key == "matching" and isinstance(value, dict) else value


def _scene_file(name_or_path: str, folder: Path, file: str | Path, key: str) -> Path:
    try:
        return shipped.find("scenes", name_or_path, relative_to=folder)
    except InputError as error:
        raise InputError(f"'{error.file}': {error.problem}", file=file, key=key) from error


# --- Changing one place of a table --------------------------------------------------------------------------------


def changed(table: Mapping[str, Any], settings: Settings, *, file: str | Path | None = None, key: str = "") -> Any:
    """A trial's table with some of its places changed, those further in last; scene and sensor files are read in.

    Raises
    ------
    InputError
        When a key leads through a value that has no keys, or past the end of a list.
    """
    for place in sorted(settings, key=lambda each: (each.count("."), each != _KIND)):
        where = f"{key}.{place}" if key else place
        if place == _KIND and isinstance(table.get("matching"), Mapping):
            # Before what else is said of the matcher: another kind has other keys.
            table = {**table, "matching": registry.carried_over(table["matching"], settings[place])}
        table = _with(table, place.split("."), settings[place], file, where)
        if place in {"scene", "sensor"}:
            table = _read_in(table, Path(), file, key)
    return table


def _changed(base: Settings, settings: Settings, experiment: Experiment, case: int | None) -> Any:
    try:
        return changed(base, settings)
    except InputError as error:
        if error.file is not None:  # a scene's or sensor's own file is at fault
            raise
        raise InputError(error.problem, key=experiment.place_of(error.key or "", case)) from error


def value_at(table: Any, key: str) -> Any:
    """The value at a dotted key, None when there is none."""
    for part in key.split("."):
        try:
            table = table[int(part)] if isinstance(table, list | tuple) else table.get(part)
        except (AttributeError, IndexError, ValueError):
            return None
    return table


def _with(table: Any, keys: list[str], value: Any, file: str | Path | None, where: str) -> Any:
    first, *rest = keys
    if isinstance(table, list | tuple):
        if not (first.isdecimal() and int(first) < len(table)):
            raise InputError(f"'{first}' is no item of a list of {len(table)}; the first is 0", file=file, key=where)
        i = int(first)
        return [*table[:i], _with(table[i], rest, value, file, where) if rest else value, *table[i + 1 :]]
    if table is not None and not isinstance(table, Mapping):
        raise InputError(f"there is no key '{first}' in {text_of(table)}, which is a plain value", file=file, key=where)
    table = table or {}
    return {**table, first: _with(table.get(first), rest, value, file, where) if rest else value}


def _read_in(trial: Mapping[str, Any], folder: Path, file: str | Path | None, key: str) -> dict[str, Any]:
    """The table of a trial with the scene and sensor files that it names read in."""
    resolved = dict(trial)
    where = f"{key}." if key else ""
    scene, sensor = resolved.get("scene"), resolved.get("sensor")
    if isinstance(scene, str):
        path = _scene_file(scene, folder, file or "", f"{where}scene")
        resolved["scene"] = _scene_table(path.resolve())
    elif isinstance(scene, dict):
        resolved["scene"] = _absolute("", scene, folder, file or "")
    if isinstance(sensor, str):
        resolved["sensor"] = as_table(load_sensor(path_of(sensor, folder, file=file, key=f"{where}sensor")))
    return resolved


def _scene_table(path: Path) -> Mapping[str, Any]:
    state = state_of(path)
    return _scene_table_of(path, state) if state else as_table(load_scene(str(path)))


@lru_cache(maxsize=64)
def _scene_table_of(path: Path, _state: State) -> Mapping[str, Any]:
    return as_table(load_scene(str(path)))
