"""Names of shipped scenes and sensors in the place of tables that say the same."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache

from harness import shipped
from harness.report.written_runs import Run, flat
from harness.runs.load import load_experiment
from harness.runs.values import identity_of
from harness.spec import dump_toml

_KINDS: Mapping[str, shipped.Kind] = {"scene": "scenes", "sensor": "sensors", "sensor_2": "sensors"}


def with_names(*runs: Run) -> tuple[Run, ...]:
    """The runs with scenes and sensors by name where one of them has names for values, as on an axis.

    A run whose scene is no axis has it as a table, key by key.
    """
    named = [key for key in _KINDS if any(key in settings for run in runs for settings in run.settings)]
    if not named:
        return runs
    return tuple(replace(run, settings=[_named(settings, named) for settings in run.settings]) for run in runs)


def _named(settings: dict[str, str], keys: Iterable[str]) -> dict[str, str]:
    for key in keys:
        table = _under(settings, key)
        name = _shipped(key).get(frozenset(table.items())) if table else None
        if name is not None:
            others = {each: value for each, value in settings.items() if each not in table}
            settings = others | {key: identity_of(key, name)}
    return settings


@lru_cache
def _shipped(key: str) -> Mapping[frozenset[tuple[str, str]], str]:
    """The shipped names by the settings that runs record for their tables."""
    names = {}
    for name in shipped.names(_KINDS[key]):
        experiment = load_experiment({"name": name, "trial": {key: name}})
        written = tomllib.loads(dump_toml(experiment, given=True))
        names[frozenset(_under(dict(flat(written["trial"])), key).items())] = name
    return names


def _under(settings: Mapping[str, str], key: str) -> dict[str, str]:
    return {each: value for each, value in settings.items() if each.startswith(f"{key}.")}
