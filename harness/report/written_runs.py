"""Runs as their folders describe them, read from the files that every run writes."""

import csv
import io
import itertools
import json
import os
import tomllib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from harness.errors import InputError, Notice
from harness.runs.cases import CASE, NAME, keys_of, settings_of
from harness.runs.earlier import mark_of
from harness.runs.values import identity_of, value_of
from harness.runs.written import read_written

READ = ("experiment.toml", "trials.csv")
"""The files that are read: every run writes them, so that runs of other code can be compared."""
_FACTS = "environment.json"
"""The files of facts, written with the summary."""

COMPARED = (
    "wall_disparity_median_abs_px",
    "wall_range_median_abs_m",
    "floor_disparity_median_abs_px",
    "floor_range_median_abs_m",
    "disparity_median_abs_px",
    "range_median_abs_m",
    "range_rmse_m",
    "bad_1px",
    "density",
)
"""The metrics that runs are compared by."""

NONE = identity_of("", None)
"""The identity of a setting that is not there."""


@dataclass(frozen=True)
class Run:
    """A run as its folder describes it."""

    folder: Path
    name: str
    """Unique among the runs compared."""
    experiment: str
    settings: list[dict[str, str]]
    """Settings of each trial: dotted key and the value's `identity_of`; without those that are None."""
    cases: list[str]
    """The name of each trial's case; empty without cases."""
    case_keys: tuple[str, ...]
    """The keys that the run's cases set."""
    figures: list[dict[str, float]]
    """The figures of each trial that is done; NaN for a missing figure."""
    facts: dict[str, str]
    """Versions, machine, hash of the source."""
    mark: str = ""
    """The text by which a page says that it is of this run's table of trials."""


def names_of_folders(folders: Sequence[Path]) -> list[str]:
    """The shortest ends of the paths that are unique."""
    parts = [Path(os.path.realpath(folder)).parts for folder in folders]  # of links in a circle, too
    if len(set(parts)) < len(parts):
        raise InputError(
            "is given twice", file=next(f for f, p in zip(folders, parts, strict=True) if parts.count(p) > 1)
        )
    length = 1
    while len({each[-length:] for each in parts}) < len(parts):
        length += 1
    return ["/".join(each[-length:]) for each in parts]


def read_run(folder: Path, name: str) -> Run:
    """The run in a folder, of any code and version.

    Parameters
    ----------
    name
        Its name in the comparison.

    Raises
    ------
    InputError
        When the folder holds no run, or its files cannot be read or are damaged.
    """
    for file in READ:
        if not (folder / file).is_file():
            raise InputError(f"holds no run that can be compared: it has no {file}", file=folder)
    files, checked = read_written(folder, (*READ, _FACTS))
    path = folder
    try:
        path = folder / "experiment.toml"
        experiment = tomllib.loads(files["experiment.toml"].decode())
        base = dict(flat(experiment["trial"]))
        path = folder / _FACTS
        facts = json.loads(files.get(_FACTS, b"{}"))
        path = folder / "trials.csv"
        rows = list(csv.DictReader(io.StringIO(files["trials.csv"].decode(), newline="")))
        run = replace(_run(folder, name, experiment, base, rows, facts), mark=mark_of([files["trials.csv"]]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = f"there is no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"cannot be read as part of a run ({why})", file=path) from error
    if not checked:
        warnings.warn(
            f"{folder}: has no database with the hashes of its tables, so they cannot be checked for changes",
            Notice,
            stacklevel=2,
        )
    return run


def _run(
    folder: Path,
    name: str,
    experiment: dict[str, Any],
    base: dict[str, str],
    rows: list[dict[str, str]],
    facts: dict[str, Any],
) -> Run:
    done = [row for row in rows if row["state"] == "done"]
    cases: list[dict[str, Any]] = experiment.get("cases", [])
    by_name = {case[NAME]: settings_of(case) for case in cases if NAME in case and CASE in (rows[0] if rows else ())}
    # Earlier versions had cases without a name, and a column for each of their keys.
    keys = dict.fromkeys(itertools.chain(experiment.get("axes", {}), *([] if by_name else cases)))
    settings = []
    for row in done:
        changed = {key: identity_of(key, value_of(row[key])) for key in keys}
        if by_name:
            case = by_name[_case_of(row)]
            changed |= {key: identity_of(key, value) for key, value in case.items()}
        # A setting that is a table or a list replaces all settings below it.
        unchanged = {
            key: value for key, value in base.items() if not any(key.startswith(f"{each}.") for each in changed)
        }
        settings.append({key: value for key, value in (unchanged | changed).items() if value != NONE})
    figures = [{key: _number(row.get(key)) for key in COMPARED} for row in done]
    packages = facts.pop("packages", {})
    flat = {key: str(value) for key, value in (facts | packages).items() if key != "finished"}
    names = [_case_of(row) if by_name else "" for row in done]
    return Run(folder, name, str(experiment["name"]), settings, names, keys_of(list(by_name.values())), figures, flat)


def _case_of(row: dict[str, str]) -> str:
    return str(value_of(row[CASE]))


def _number(text: str | None) -> float:
    return float(text) if text else float("nan")


def flat(value: Any, above: str = "") -> Iterator[tuple[str, str]]:
    """Dotted keys; lists of plain values in one piece, as in `trials.csv`."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from flat(each, f"{above}.{key}" if above else key)
    elif isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
        for index, each in enumerate(value):
            yield from flat(each, f"{above}.{index}")
    else:
        yield above, identity_of(above, value)
