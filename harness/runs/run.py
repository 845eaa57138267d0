"""Run an experiment: rows of all trials in one file, the base trial in detail, tables and reports."""

import contextlib
import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from harness.display import OneLine
from harness.errors import InputError
from harness.evaluation.metrics import Measures, measure
from harness.files import check_folder, clear_leftovers, make_folder
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.environment import environment, source_hash
from harness.pipeline.maps import has_maps
from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome
from harness.runs import executors
from harness.runs.cases import CASE
from harness.runs.details import Beforehand, Details, details_of, keep
from harness.runs.dotted import value_at
from harness.runs.earlier import of_earlier_trials
from harness.runs.experiment import Experiment, Planned
from harness.runs.methods import MethodId, MethodName, method_id, method_names
from harness.runs.path_maps import write_path_maps
from harness.runs.plan import Plan, plan
from harness.runs.recorded import record
from harness.runs.scheduler import run_batches
from harness.runs.store import DATABASE, Finished, Store, UnusedRows
from harness.runs.values import Settings, text_of
from harness.runs.written import (
    FAILURES,
    check_begins_no_run,
    check_no_others_in,
    is_written,
    remove_failures,
    remove_stale,
    set_reported,
    write_files,
)
from harness.spec import as_table, dump_toml

if TYPE_CHECKING:  # loading it takes long, and trials can be run without
    import pandas as pd

    from harness.runs.all_trials import AllTrials

SCHEMA = 1
METHODS = {"none": "pixel", "parabola": "subpixel"}
"""The keys of the paper's two methods in `summary.json` and the report."""


@dataclass(frozen=True)
class Row:
    """A finished trial of an experiment."""

    planned: Planned
    finished: Finished

    @property
    def coordinates(self) -> Settings:
        """The values of the keys that vary."""
        return self.planned.coordinates

    @property
    def state(self) -> str:
        """`done` or `failed`."""
        return self.finished.state

    @cached_property
    def payload(self) -> dict[str, Any]:
        """The row from `row.row_of`; empty if the trial failed."""
        return json.loads(self.finished.payload)


@dataclass(frozen=True, repr=False)
class Result(OneLine):
    """An experiment and its results."""

    experiment: Experiment
    rows: list[Row]
    """The rows of all trials that are finished, in the experiment's order."""
    cells: "pd.DataFrame"
    """The cells of all trials that are done, see `analysis.cell_table`."""
    details: Details
    """The base trial by each method."""
    summary: dict[str, Any]
    environment: dict[str, Any]

    @property
    def outcomes(self) -> list[Outcome]:
        """The outcomes of the trials that are shown in detail."""
        return self.details.outcomes

    @property
    def coordinates(self) -> list[Settings]:
        """The coordinates of each of the `outcomes`."""
        columns = columns_of(self.experiment)
        names = names_in([outcome.trial for outcome in self.outcomes], self.experiment.planned)
        coordinates = []
        for outcome in self.outcomes:
            # The base trial belongs to no case, unless cases name methods.
            case = self.experiment.method_labels.get(names[method_id(outcome.trial.matching)])
            table = as_table(outcome.trial) | {CASE: case}
            coordinates.append({key: value_at(table, key) for key in columns if key != CASE or case})
        return coordinates


@dataclass(frozen=True)
class RunStatus:
    """The progress of a run."""

    left: list[Planned]
    """The trials that are still to be run, including failed ones."""
    total: int
    done: int
    failed: int
    unused: UnusedRows

    @cached_property
    def plan(self) -> Plan:
        """The order in which they are best run."""
        return plan(self.left)


def check_folder_of_run(experiment: Experiment, folder: Path) -> None:
    """Refuse a folder that `open_run` would refuse, and change nothing in it.

    Raises
    ------
    InputError
        As `open_run`.
    """
    check_folder(folder)
    check_begins_no_run(folder)
    database = folder / DATABASE
    is_empty = database.is_file() and not database.stat().st_size
    if os.path.lexists(database) and not is_empty:  # an empty one is a run that has just begun
        with Store(database, read_only=True) as store:
            _check_run(experiment, folder, store)


def _check_run(experiment: Experiment, folder: Path, store: Store) -> None:
    name = store.fact("name")
    if name not in (None, experiment.name):
        raise InputError(
            f"holds a run of the experiment '{name}', not of '{experiment.name}'; give another folder with --out",
            file=folder,
        )
    check_no_others_in(folder, store)


def open_run(experiment: Experiment, folder: Path) -> Store:
    """Open the run of an experiment in a folder, or start it.

    Raises
    ------
    InputError
        When the folder holds another experiment's run, or somebody's files in the place of a run's, or its file
        cannot be used.
    """
    make_folder(folder)
    check_begins_no_run(folder)
    with contextlib.ExitStack() as until_it_is_opened:
        store = until_it_is_opened.enter_context(Store(folder / DATABASE))
        _check_run(experiment, folder, store)
        clear_leftovers(folder)  # the database is locked, so that no other process writes here
        store.set_fact("name", experiment.name)
        record(experiment, store)
        until_it_is_opened.pop_all()  # from here on it is the caller's to close
    return store


def run_status(experiment: Experiment, store: Store, maps: Path | None = None) -> RunStatus:
    """The state of a run: how many trials are done, failed and left.

    Parameters
    ----------
    maps
        The folder in which trials' maps are kept: a trial whose maps are not there is still to be run.
    """
    states = store.states(each.key for each in experiment.planned)
    left = [
        each
        for each in experiment.planned
        if states.get(each.key) != "done" or not (maps is None or has_maps(maps, each.key))
    ]
    return RunStatus(
        left=left,
        total=len(experiment.planned),
        done=len(experiment.planned) - len(left),
        failed=sum(state == "failed" for state in states.values()),
        unused=store.unused_rows((each.key for each in experiment.planned), experiment.scene_fingerprints),
    )


def run_plan(
    plan: Plan,
    store: Store,
    backend: executors.Backend,
    observe: Callable[[Sequence[Finished]], None] = lambda _: None,
    maps: Path | None = None,
    meanwhile: Iterable[object] = (),
) -> None:
    """Run the remaining trials; see `scheduler.run_batches`.

    Raises
    ------
    InputError
        When maps are to be kept and workers may be on another machine, which does not have the folder.
    """
    if maps is not None and backend.remote:
        raise InputError(
            "writes into a folder of this machine, which workers on a cluster may not have", key="--keep-arrays"
        )
    # One worker takes single trials: there is nobody else to keep busy, and a kill costs one trial.
    longest = 0.0 if backend.workers == 1 and not backend.remote else plan.total_s / (12 * backend.workers)
    run_batches(plan.batches(min(longest, 1.0)), store, backend, observe, maps, meanwhile)


def result_of(experiment: Experiment, store: Store, *, run_code: bool = True) -> Result:
    """The result of a run so far; see `result_from`."""
    return result_from(experiment, rows_of(experiment, store), store, run_code=run_code)


def rows_of(experiment: Experiment, store: Store) -> list[Row]:
    """The rows of all trials that are finished, in the experiment's order."""
    finished = store.finished(each.key for each in experiment.planned)
    return [Row(each, finished[each.key]) for each in experiment.planned if each.key in finished]


def result_from(
    experiment: Experiment,
    rows: list[Row],
    store: Store | None = None,
    *,
    run_code: bool = True,
    beforehand: Beforehand = MappingProxyType({}),
    all_trials: "Callable[[], AllTrials] | None" = None,
) -> Result:
    """The result that follows from the rows, with the trials that are shown in detail; see `details.details_of`.

    Parameters
    ----------
    all_trials
        Gives what the rows say together, if that is being worked out already.

    Raises
    ------
    InputError
        When no trial is done.
    """
    from harness.runs.all_trials import all_trials_of  # it loads pandas, which takes long

    done = [row for row in rows if row.state == "done"]
    if not done:
        raise InputError("no trial was finished with the present version of the program, so there is nothing to report")
    details = details_of(experiment, [row.planned for row in done], store, run_code=run_code, beforehand=beforehand)
    comparison = details.comparison or _comparison(details.outcomes, experiment.planned)
    if store and not store.other_code:
        keep(details, comparison, experiment, store, beforehand)
    summary = {"schema": SCHEMA, "experiment": experiment.name} | comparison
    summary |= {"trials": {"total": len(experiment.planned), "done": len(done), "failed": len(rows) - len(done)}}
    found = all_trials() if all_trials else all_trials_of(experiment, rows)
    entries = found.entries | {"labels": _labels(details, experiment)}
    summary |= {name: value for name, value in entries.items() if value}
    environment_table = environment() | {"scene_sha256": " ".join(sorted(experiment.scene_fingerprints))}
    if store and store.other_code:
        environment_table["trials_made_by"] = f"other code or libraries than these, {store.other_code}"
    return Result(experiment, rows, found.cells, details, summary, environment_table)


def _labels(details: Details, experiment: Experiment) -> dict[str, str]:
    """The names that cases give to methods, by the methods' keys in the summary."""
    if not experiment.method_labels:
        return {}
    names = names_in(details.trials, experiment.planned)
    return {
        key: experiment.method_labels[name]
        for key, i in methods_in(details.trials, experiment.planned).items()
        if (name := names[method_id(details.trials[i].matching)]) in experiment.method_labels
    }


def run_experiment(experiment: Experiment, folder: Path | None = None, *, workers: int | None = None) -> Result:
    """Run all trials that are not done, in a folder or in memory, without output.

    Raises
    ------
    InputError
        When the folder cannot be used, or no trial could be carried out; the first one's message.
    """
    with open_run(experiment, folder) if folder else Store() as store:
        left = run_status(experiment, store).plan
        run_plan(left, store, executors.backend_for(left.total_s, len(left.trials), workers))
        finished = store.finished(each.key for each in experiment.planned).values()
        if all(row.state == "failed" for row in finished):
            raise InputError(next(iter(finished)).message)
        return result_of(experiment, store)


# --- What is written ----------------------------------------------------------------------------------------------


def write_tables(experiment: Experiment, rows: list[Row], store: Store, folder: Path) -> tuple[list[str], list[str]]:
    """Write the files without a report: `experiment.toml`, `trials.csv`, `timings.csv`, and `failures.csv` if needed.

    A report and a summary of other rows are removed.

    Parameters
    ----------
    rows
        Those of `rows_of`.

    Returns
    -------
    removed
        The names of files that were.
    left
        What there still is of earlier trials, in words; see `earlier.of_earlier_trials`.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    tables = {
        "experiment.toml": dump_toml(experiment, given=True),
        "trials.csv": _trials(experiment, rows),
        "timings.csv": _timings(rows),
    }
    removed, left = remove_stale(_digest(experiment, store), store, folder)
    write_files(tables, folder, store)
    if any(row.state == "failed" for row in rows):
        write_files({FAILURES: _failures(experiment, rows)}, folder, store)
    else:
        left += remove_failures(folder, store)
    return removed, left + of_earlier_trials(folder, {each.key for each in experiment.planned})


def write_summary(result: Result, store: Store, folder: Path) -> None:
    """Write `environment.json` and `summary.json`, and the maps of trials that have one.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    files = {"environment.json": _json(result.environment), "summary.json": _json(result.summary)}
    write_files(files, folder, store)
    write_path_maps([(row.planned, row.payload) for row in result.rows if row.state == "done"], folder)


def write_report(result: Result, report: str, store: Store, folder: Path) -> None:
    """Write `report.html`, and record in the store which files belong to its rows.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    write_files({"report.html": report}, folder, store)
    set_reported(_digest(result.experiment, store), store, folder)


def is_reported(experiment: Experiment, store: Store, folder: Path) -> bool:
    """Whether all files that follow from the rows exist and are unchanged."""
    return is_written(_digest(experiment, store), store, folder)


def columns_of(experiment: Experiment) -> list[str]:
    """The keys that vary, in the order of the columns."""
    return list(experiment.planned[0].coordinates)


def _digest(experiment: Experiment, store: Store) -> str:
    """SHA-256 of all that the output files depend on. Rows follow from their keys, the code and their states."""
    states = store.states(each.key for each in experiment.planned)
    parts = [source_hash(), dump_toml(experiment, given=True), json.dumps(states, sort_keys=True)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _trials(experiment: Experiment, rows: list[Row]) -> str:
    figures = [row.payload.get("figures", {}) if row.state == "done" else {} for row in rows]
    names = list(dict.fromkeys(name for each in figures for name in each))
    return _csv(
        ["state", *columns_of(experiment), *names, "key"],
        (
            [row.state, *map(text_of, row.coordinates.values()), *(each.get(name) for name in names), row.planned.key]
            for row, each in zip(rows, figures, strict=True)
        ),
    )


def _timings(rows: list[Row]) -> str:
    seconds = [json.loads(row.finished.seconds) for row in rows]
    stages = list(dict.fromkeys(stage for each in seconds for stage in each))
    return _csv(
        [*(f"{stage}_s" for stage in stages), "key"],
        (
            [*(each.get(stage) for stage in stages), row.planned.key]
            for row, each in zip(rows, seconds, strict=True)
            if row.state == "done"
        ),
    )


def _failures(experiment: Experiment, rows: list[Row]) -> str:
    return _csv(
        [*columns_of(experiment), "message", "traceback", "key"],
        (
            [*map(text_of, row.coordinates.values()), row.finished.message, row.finished.traceback, row.planned.key]
            for row in rows
            if row.state == "failed"
        ),
    )


def _csv(heading: list[str], lines: Iterable[list[Any]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows([value if isinstance(value, str) else text_of(value) for value in line] for line in lines)
    return stream.getvalue()


def _json(value: Any) -> str:
    return json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


# --- The base trial in detail -------------------------------------------------------------------------------------


def compare(outcomes: dict[str, Outcome], *, wall_only: bool) -> dict[str, Measures]:
    """Figures of several methods on the same pixels: those for which all of them have an estimate."""
    anyone = next(iter(outcomes.values()))
    domain = anyone.reference.domain & anyone.reference.wall if wall_only else anyone.reference.domain
    valid = np.logical_and.reduce([outcome.valid for outcome in outcomes.values()])
    return {name: measure(domain, valid, outcome.errors) for name, outcome in outcomes.items()}


def names_in(trials: Sequence[Trial], planned: Sequence[Planned] = ()) -> Mapping[MethodId, MethodName]:
    """The names of the methods of trials, unique within an experiment if its trials are given."""
    return method_names([each.matching for each in (*(one.trial for one in planned), *trials)])


def by_method(outcomes: list[Outcome], planned: Sequence[Planned] = ()) -> dict[str, Outcome]:
    """The first outcome of each method, by the name that `summary.json` has for it; see `methods_in`."""
    return {name: outcomes[i] for name, i in methods_in([each.trial for each in outcomes], planned).items()}


def methods_in(trials: Sequence[Trial], planned: Sequence[Planned] = ()) -> dict[str, int]:
    """The names that `summary.json` has for the methods of some trials, and the first trial of each.

    `pixel` and `subpixel` when the paper's two methods are all there are; otherwise the matcher and its sub-pixel step.
    """
    names = names_in(trials, planned)
    methods: dict[MethodName, int] = {}
    for i, trial in enumerate(trials):
        methods.setdefault(names[method_id(trial.matching)], i)
    windows = all(isinstance(trial.matching, WindowMatcher) for trial in trials)
    kinds, steps = {kind for kind, _ in methods}, {step for _, step in methods}
    if windows and len(kinds) == 1 and steps <= METHODS.keys():
        return {METHODS[step]: i for (_, step), i in methods.items()}
    return {key_of(method): i for method, i in methods.items()}


def key_of(method: MethodName) -> str:
    """The key of a method in `summary.json`: the matcher, and its sub-pixel step unless it has its own."""
    kind, step = method
    return kind if step == "own" else f"{kind} {step}"


def _comparison(outcomes: list[Outcome], planned: Sequence[Planned]) -> dict[str, Any]:
    named = by_method(outcomes, planned)
    return {
        "comparison": compare(named, wall_only=False) if named else {},
        "comparison_wall": compare(named, wall_only=True) if named else {},
    }
