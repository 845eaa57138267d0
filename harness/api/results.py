"""The results of an experiment: tables of its trials, the maps of each, and the report."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from harness.errors import InputError, Notice
from harness.files import write
from harness.pipeline.maps import FOLDER, TrialMaps, maps_of, read_maps
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys, dotted_up_to_date
from harness.runs.cases import CASE
from harness.runs.details import with_method
from harness.runs.dotted import value_at
from harness.runs.experiment import Experiment, Planned
from harness.runs.recorded import recorded
from harness.runs.run import Result, Row, columns_of, result_from, rows_of, write_report, write_summary, write_tables
from harness.runs.settings_reference import unit_of
from harness.runs.store import DATABASE, OTHER_CODE, Store
from harness.runs.values import shown
from harness.runs.worker import run_here
from harness.spec import as_table

_MOST_ROWS = 20
"""Most rows of a table in a notebook."""

_SHOWN = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "range_rmse_m")


class RunResult:
    """The finished trials of an experiment, and the results derived from them.

    Attributes
    ----------
    experiment : Experiment
        The experiment that was run.
    folder : pathlib.Path or None
        The folder of the run; None for a run in memory.
    """

    def __init__(
        self, experiment: Experiment, rows: list[Row], folder: Path | None = None, *, run_code: bool = True
    ) -> None:
        self.experiment = experiment
        self.folder = folder
        self._rows = rows
        self._run_code = run_code

    def __repr__(self) -> str:
        done = sum(row.state == "done" for row in self._rows)
        failed = len(self._rows) - done
        where = f", in {self.folder}" if self.folder else ""
        total = len(self.experiment.planned)
        return (
            f"RunResult({self.experiment.name!r}, {done} of {total} trials done"
            f"{f', {failed} failed' if failed else ''}{where})"
        )

    def _repr_html_(self) -> str:
        """The main figures of the first trials."""
        from html import escape

        trials = self.trials
        columns = [*columns_of(self.experiment), *(name for name in _SHOWN if name in trials)]
        rest = f"<div>and {len(trials) - _MOST_ROWS} more</div>" if len(trials) > _MOST_ROWS else ""
        table = trials[columns].head(_MOST_ROWS).to_html(float_format=lambda value: f"{value:.4g}")
        return f"<div><b>{escape(repr(self))}</b></div>{table}{rest}"

    @cached_property
    def trials(self) -> pd.DataFrame:
        """One row for each finished trial, indexed by its key: its state, the keys that vary, and its figures."""
        table = [
            {"key": row.planned.key, "state": row.state, **row.coordinates, **row.payload.get("figures", {})}
            for row in self._rows
        ]
        return pd.DataFrame(table).set_index("key")

    @cached_property
    def timings(self) -> pd.DataFrame:
        """Seconds that each stage of each trial took, indexed by the trial's key."""
        import json

        done = [row for row in self._rows if row.state == "done"]
        table = [{"key": row.planned.key, **json.loads(row.finished.seconds)} for row in done]
        return pd.DataFrame(table).set_index("key")

    @property
    def failures(self) -> pd.DataFrame:
        """The trials that failed, indexed by key: the keys that vary, the message and the traceback."""
        table = [
            {
                "key": row.planned.key,
                **row.coordinates,
                "message": row.finished.message,
                "traceback": row.finished.traceback,
            }
            for row in self._rows
            if row.state == "failed"
        ]
        columns = ["key", *columns_of(self.experiment), "message", "traceback"]
        return pd.DataFrame(table, columns=columns).set_index("key")

    @property
    def cells(self) -> pd.DataFrame:
        """The errors of every trial in cells of surface, direction and range: the data of the sensitivity test."""
        return self._result.cells

    @cached_property
    def summary(self) -> pd.DataFrame:
        """The main figures of the base trial by every method, over the pixels that all methods matched.

        Indexed by `pixels` (`walls`, `all`) and `method`; the columns are those of `summary.json`.
        """
        parts = (("walls", "comparison_wall"), ("all", "comparison"))
        table = [
            {"pixels": pixels, "method": method, **figures}
            for pixels, key in parts
            for method, figures in self._result.summary[key].items()
        ]
        return pd.DataFrame(table).set_index(["pixels", "method"])

    @property
    def law(self) -> dict[str, Any] | None:
        """The test of the sensitivity law, as in `summary.json`; None if the experiment does not ask for it, see the
        key `law`, or its trials do not differ enough.
        """
        return self._result.summary.get("law")

    @property
    def limit(self) -> pd.DataFrame:
        """Each method's spread over noise draws against the Cramér-Rao bound; empty if pixels were not stored."""
        return pd.DataFrame(self._result.summary.get("limit", []))

    @property
    def settings(self) -> pd.DataFrame:
        """The settings of the base trial, indexed by key: value and unit."""
        base = as_table(self.experiment.trial)
        table = [{"key": key, "value": value_at(base, key), "unit": unit_of(key)} for key in _leaves(base)]
        return pd.DataFrame(table).set_index("key")

    @property
    def environment(self) -> dict[str, Any]:
        """Current versions, CPU, and hashes of source and scenes."""
        return self._result.environment

    def outcome(self, trial: str | int | Mapping[str, Any] | None = None) -> TrialMaps:
        """The maps of one trial: read if the run stored them, else computed again.

        Parameters
        ----------
        trial
            The trial's key, its number in the experiment's order, or values of enough of the keys that vary to
            identify it; the first trial when None. Where the trials that match differ in the seed alone, the base
            trial is meant, if it matches too.

        Returns
        -------
        TrialMaps
            `range_m`, `true_range_m`, `range_error_m`, `alpha_2`, `sigma_alpha_2` ... as arrays; `to_xarray()`.

        Raises
        ------
        InputError
            When no trial matches, or more than one, or the trial fails.

        Examples
        --------
        >>> import harness
        >>> result = harness.run("smoke", sets={"view_2.baseline_m": 0.5, "noise.sigma_grey": 0, "seed": 1})
        >>> outcome = result.outcome({"matching.window_px": 7, "matching.subpixel": "none"})
        >>> outcome.range_m.shape
        (50, 180)
        """
        planned = self._planned(trial)
        stored = None if self.folder is None else read_maps(self.folder / FOLDER, planned.trial)
        if stored is None and planned.trial.matching.runs_third_party_code and not self._run_code:
            raise InputError(
                "its maps are not stored, and its matcher is not part of omnirange; "
                "open_results(folder, run_code=True) allows it to run",
                key=planned.key,
            )
        return stored or maps_of(run_here(planned.trial))

    def report(self, file: str | Path | None = None) -> Path:
        """Write the report: one HTML file that needs nothing else.

        Parameters
        ----------
        file
            The output file; when None, the run's folder, with `summary.json` and `environment.json` beside it.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        InputError
            When no trial is done, the file cannot be written, or a run in memory has no folder.
        """
        from harness.report.build import build_report

        if file is not None:
            write(Path(file), build_report(self._result))
            return Path(file)
        if self.folder is None:
            raise InputError("the run is in memory: give a path for the report", key="file")
        page = build_report(self._result)
        with Store(self.folder / DATABASE) as store:
            store.read_earlier(each.key for each in self.experiment.planned)
            write_tables(self.experiment, self._rows, store, self.folder)  # others may have been run into it since
            write_summary(self._result, store, self.folder)
            write_report(self._result, page, store, self.folder)
        return self.folder / "report.html"

    @cached_property
    def _result(self) -> Result:
        if self.folder is None:
            return result_from(self.experiment, self._rows, run_code=self._run_code)
        with Store(self.folder / DATABASE) as store:
            store.read_earlier(each.key for each in self.experiment.planned)
            return result_from(self.experiment, self._rows, store, run_code=self._run_code)

    def _planned(self, trial: str | int | Mapping[str, Any] | None) -> Any:
        every = self.experiment.planned
        if trial is None:
            return every[0]
        if isinstance(trial, str):
            matching = [each for each in every if each.key == trial]
        elif isinstance(trial, Mapping):
            chosen, _ = dotted_up_to_date(DottedKeys(Trial), trial)
            for key in chosen.keys() - every[0].coordinates.keys():
                varied = ", ".join(every[0].coordinates) or "none"
                raise InputError(f"'{key}' is not a key that varies; those are: {varied}", key="trial")
            matching = [each for each in every if all(each.coordinates[key] == value for key, value in chosen.items())]
            if len(matching) > 1 and (base := self._base_of(matching, chosen)):
                return base
        else:
            if not -len(every) <= trial < len(every):
                raise InputError(f"there is no trial {trial}: there are {len(every)}, the first is 0", key="trial")
            return every[trial]
        if len(matching) != 1:
            count = f"{len(matching)} trials match; give more keys" if matching else "no trial matches"
            raise InputError(
                f"{count} ({', '.join(every[0].coordinates) or 'one trial'}); found {trial!r}", key="trial"
            )
        return matching[0]

    def _base_of(self, matching: list[Planned], chosen: Mapping[str, Any]) -> Planned | None:
        """The base trial by the method of trials that differ in the seed alone; None where it is not as chosen."""
        variants = {shown(each.coordinates_without(lambda key: key == "seed")) for each in matching}
        base = with_method(self.experiment.trial, matching[0].trial)
        table = as_table(base)
        if len(variants) > 1 or CASE in chosen or any(value_at(table, key) != value for key, value in chosen.items()):
            return None
        return replace(matching[0], key=base.key, trial=base)


def open_results(folder: str | Path, *, run_code: bool = False) -> RunResult:
    """The results of a run in a folder.

    Parameters
    ----------
    folder
        The output folder of `omnirange run` or `harness.run`.
    run_code
        Whether programs and plug-ins that the run names may be executed. The report needs none: its data are stored
        with the run.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        When the folder holds no run, or no trial of it is finished.

    Examples
    --------
    >>> import harness
    >>> harness.open_results("nowhere")
    Traceback (most recent call last):
        ...
    harness.errors.InputError: nowhere: holds no run: there is no run.sqlite in it
    """
    folder = Path(folder)
    database = folder / DATABASE
    if not database.is_file():
        raise InputError(f"holds no run: there is no {DATABASE} in it", file=folder)
    with Store(database) as store:
        experiment = recorded(store, database)
        rows = rows_of(experiment, store)
        if store.other_code:
            warnings.warn(f"{folder}: {OTHER_CODE}", Notice, stacklevel=2)
    if not rows:
        raise InputError("holds no finished trial; run the experiment again", file=folder)
    return RunResult(experiment, rows, folder, run_code=run_code)


def _leaves(table: Mapping[str, Any], stem: str = "") -> list[str]:
    keys: list[str] = []
    for name, value in table.items():
        items = value if isinstance(value, Mapping) else {}
        if isinstance(value, list) and value and isinstance(value[0], Mapping):
            items = {str(number): each for number, each in enumerate(value)}
        keys += _leaves(items, f"{stem}{name}.") if items else [f"{stem}{name}"]
    return keys
