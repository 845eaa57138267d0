"""Experiments: a base trial, axes along which its settings vary, and named cases."""

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, PrivateAttr, field_validator

from harness.camera.sensor import check_mask
from harness.display import shortened
from harness.errors import InputError
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys
from harness.runs.cases import (
    CASE,
    NAME,
    check_cases,
    keys_of,
    may_be_methods,
    method_labels,
    settings_of,
    with_names,
    without,
)
from harness.runs.dotted import changed, value_at, worked_out
from harness.runs.methods import METHOD_KEYS, MethodName, method_id, method_names, names_for_people
from harness.runs.named_files import SENSORS
from harness.runs.values import Settings, identity_of, shown, text_of
from harness.simulation.fingerprint import fingerprint
from harness.spec import Spec, as_given, checked_plain, parse

MOST_TRIALS = 100_000
"""The most trials of an experiment: what can be planned within seconds."""


@dataclass(frozen=True)
class Planned:
    """A trial of an experiment."""

    key: str
    """`Trial.key`."""
    coordinates: Settings
    """The case's name, if there are cases, and the values of all axes, in the order of the columns."""
    trial: Trial
    method: MethodName
    """The name of its method in this experiment."""
    scene_file: str = ""
    """The file of its scene, for messages; empty for a shipped scene and for a table."""
    case_keys: tuple[str, ...] = ()
    """The keys that a case stands for: those that the cases set, or those of a method where each case is one."""

    def coordinates_without(self, is_left_out: Callable[[str], bool]) -> Settings:
        """The coordinates without some keys, and without the case where cases set none but these."""
        return without(self.coordinates, self.case_keys, is_left_out)

    @property
    def condition(self) -> str:
        """The coordinates in words without method and seed: intervals over seeds are taken within a condition."""
        return shown(self.coordinates_without(lambda key: key in ("seed", *METHOD_KEYS)))


def _folder_name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}", text):
        raise ValueError(
            f"must be 1 to 80 letters, digits, '_', '.' and '-', the first a letter or a digit; found {text!r}"
        )
    return text


class Experiment(Spec):
    """A named set of trials: for each of the cases, the full product of the axes over the base trial's settings."""

    name: Annotated[str, AfterValidator(_folder_name)]
    """The experiment's name: letters, digits, `_`, `.` and `-`. It also names the output folder."""
    description: str = ""
    """A description for people."""
    law: bool = False
    """Whether the law of sensitivity is tested: whether errors of the range grow as the law says across ranges and
    three or more baselines. Slopes, a verdict and sections of the report."""
    trial: Trial
    """The base trial."""
    axes: Annotated[dict[str, Annotated[list[Any], Field(min_length=1)]], DottedKeys(Trial, listed=True)] = Field(
        default_factory=dict
    )
    """Dotted keys of a trial, and the values that each takes: all combinations are run."""
    cases: Annotated[list[Settings], DottedKeys(Trial)] = Field(default_factory=list)
    """Named cases: each has a `name` and dotted keys of a trial with values that replace the base trial's together.
    A case is one line in tables and legends, under its name, and is run with all combinations of the axes; without
    any, there is one case that changes nothing."""

    _scene_file: str = PrivateAttr(default="")

    def __repr__(self) -> str:
        """The name, how many trials there are, and what varies."""
        count = math.prod(map(len, self.axes.values())) * max(1, len(self.cases))
        varied = [f"{key} ({len(values)})" for key, values in self.axes.items() if len(values) > 1]
        varied += [f"{len(self.cases)} cases"] if self.cases else []
        trials = f"{count} trial{'s' if count != 1 else ''}"
        return f"Experiment({self.name!r}, {shortened(': '.join([trials, ', '.join(varied)]).rstrip(': '))})"

    __str__ = __repr__

    @field_validator("axes", "cases", mode="before")
    @classmethod
    def _plain(cls, given: Any) -> Any:
        return checked_plain(given) if isinstance(given, Mapping | list | tuple) else given

    @field_validator("cases", mode="after")
    @classmethod
    def _named(cls, cases: list[Settings]) -> list[Settings]:
        return with_names(cases)

    @cached_property
    def planned(self) -> tuple[Planned, ...]:
        """Every trial, case by case, in the order of the product, the last axis fastest.

        Raises
        ------
        InputError
            When there are more than `MOST_TRIALS`, a case has no name of its own or the key of an axis, a key is no
            key of a trial, a value is not valid there, a third-party matcher does not exist or does not take its
            parameters, or two trials are the same. `error.key` is the key in the experiment.
        """
        self._check_count()
        check_cases(self.cases, self.axes)
        base = as_given(self.trial)
        of_methods = METHOD_KEYS if may_be_methods(self.cases, self.axes) else ()
        columns = [*(key for key in keys_of(self.cases) if key in of_methods), *self.axes]
        scenes: dict[str, str] = {}
        trials: dict[str, tuple[Settings, Trial]] = {}
        checked: dict[int, Any] = {}
        for case, settings in self._settings():
            table = _changed(base, settings, self, case)
            try:
                trial = parse(Trial, self._with_validated(table, base), checked=checked)
            except InputError as error:
                key = self._blame(error.key, settings, case) or self.key_in_file("", case).rstrip(".")
                raise InputError(error.problem, key=key) from error
            for name, sensor in zip(SENSORS, trial.sensors, strict=True):
                try:
                    check_mask(sensor, key=f"{name}.mask")
                except InputError as error:
                    key = self._blame(error.key, settings, case) or f"trial.{error.key}"
                    raise InputError(error.problem, key=key) from error
            try:
                trial.matching.check()
            except InputError as error:
                key = self._blame(f"matching.{error.key}", settings, case) or f"trial.matching.{error.key}"
                raise InputError(error.problem, key=key) from error
            coordinates = {} if case is None else {CASE: self.cases[case][NAME]}
            coordinates |= {
                key: worked_out(settings[key] if key in settings else value_at(table, key), trial, key)
                for key in columns
            }
            key = trial.key
            if key in trials:
                self._check_twice()
                raise InputError(
                    f"two trials are the same: {shown(trials[key][0])}, and {shown(coordinates)}; remove one",
                    key="axes" if case is None else f"cases[{case}]",
                )
            trials[key] = coordinates, trial
            scenes[key] = self._scene_file_at(settings)
        names = method_names(trial.matching for _, trial in trials.values())
        planned = tuple(
            Planned(key, coordinates, trial, names[method_id(trial.matching)], scenes[key])
            for key, (coordinates, trial) in trials.items()
        )
        return with_case_keys(planned, self.cases, self.axes)

    def with_scene_file(self, file: str) -> Self:
        """The same experiment, with the file that its base trial's scene was read from for messages."""
        copy = self.model_copy()
        copy._scene_file = file  # noqa: SLF001 - of its own class
        return copy

    @cached_property
    def method_labels(self) -> Mapping[MethodName, str]:
        """The names that cases give to methods; empty unless each case is a method of its own."""
        return labels_in(self.planned, self.cases, self.axes)

    @cached_property
    def names_of_methods(self) -> Mapping[MethodName, str]:
        """The names of all methods in legends, tables and sentences."""
        return names_for_people((each.method for each in self.planned), self.method_labels)

    def _scene_file_at(self, settings: Settings) -> str:
        named = settings.get("scene", self._scene_file)
        return named if isinstance(named, str) and Path(named).is_absolute() else ""

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

    def _check_twice(self) -> None:
        """Refuse an axis that has a value twice."""
        for key, values in self.axes.items():
            identities = [identity_of(key, value) for value in values]
            twice = next((value for i, value in enumerate(values) if identities.index(identities[i]) < i), None)
            if twice is not None:
                raise InputError(f"has the value {text_of(twice)} twice; leave one out", key=f"axes.{key}")

    def _settings(self) -> Iterator[tuple[int | None, Settings]]:
        """The number of the case, if there are any, and what changes in the base trial."""
        for number, case in enumerate(map(settings_of, self.cases or [{}])):
            for values in itertools.product(*self.axes.values()):
                yield number if self.cases else None, case | dict(zip(self.axes, values, strict=True))

    def _blame(self, path: str | None, settings: Settings, case: int | None) -> str | None:
        """The axis or the key of a case that has set a key of the trial, such as `scene.objects[0].size_m`, if any
        has.
        """
        parts = (path or "").replace("[", ".").replace("]", "").split(".")
        for key in settings:
            keys = key.split(".")
            shorter = min(len(keys), len(parts))
            if keys[:shorter] == parts[:shorter]:
                return self.key_in_file(key, case)
        return None

    def key_in_file(self, key: str, case: int | None) -> str:
        """The key in the experiment that sets a key of a trial: of an axis, or of a case."""
        return f"axes.{key}" if key in self.axes or case is None else f"cases[{case}].{key}"


def labels_in(
    planned: Sequence[Planned], cases: Sequence[Settings], axes: Mapping[str, Any]
) -> Mapping[MethodName, str]:
    """The names that the cases of some trials give to methods; see `method_labels`."""
    named = [(str(each.coordinates[CASE]), each.method) for each in planned if CASE in each.coordinates]
    return method_labels(cases, axes, named)


def with_case_keys(
    planned: tuple[Planned, ...], cases: Sequence[Settings], axes: Mapping[str, Any]
) -> tuple[Planned, ...]:
    """The trials with `case_keys` set."""
    keys = METHOD_KEYS if labels_in(planned, cases, axes) else keys_of(cases)
    return tuple(replace(each, case_keys=keys) for each in planned) if keys else planned


def _changed(base: Settings, settings: Settings, experiment: Experiment, case: int | None) -> Any:
    try:
        return changed(base, settings)
    except InputError as error:
        if error.file is not None:  # a scene's or sensor's own file is at fault
            raise
        raise InputError(error.problem, key=experiment.key_in_file(error.key or "", case)) from error
