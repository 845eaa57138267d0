"""Running an experiment."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from harness.api.loading import load_experiment
from harness.api.progress import Progress, someone_watches
from harness.api.results import RunResult
from harness.display import listed
from harness.errors import InputError, Notice
from harness.files import make_folder
from harness.pipeline.maps import FOLDER, prepare_folder
from harness.runs.executors import backend_for
from harness.runs.experiment import Experiment
from harness.runs.run import open_run, rows_of, run_plan, run_status, write_tables
from harness.runs.store import Finished, Store


def run(
    experiment: str | Path | Mapping[str, Any] | Experiment,
    *,
    axes: Mapping[str, Sequence[Any]] | None = None,
    cases: Mapping[str, Mapping[str, Any]] | None = None,
    sets: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    keep_arrays: bool = False,
    progress: bool | None = None,
) -> RunResult:
    """Run the trials of an experiment that are not yet done.

    Parameters
    ----------
    experiment
        A shipped name, the path of a TOML file, a table like that of a file, or an experiment.
    axes
        Dotted keys of a trial and the values of each: further axes, or other values of one that is there.
    cases
        Names, each with dotted keys of a trial and their values: cases instead of the experiment's own.
    sets
        Dotted keys of a trial and values: settings of the base trial. The experiment's axis over a key is dropped.
    out
        The run's folder, in which an interrupted run is resumed; when None, the run is in memory.
    workers
        Number of processes; when None, as many as save time.
    keep_arrays
        Whether to store every trial's maps in `out`.
    progress
        Whether to show progress; when None, in a terminal and in a notebook.

    Returns
    -------
    RunResult
        `trials`, `summary`, `settings` as tables; `outcome(...)`, `report(...)`.

    Raises
    ------
    InputError
        When an argument is invalid, or every trial failed: the first one's message.

    Examples
    --------
    >>> import harness
    >>> result = harness.run("smoke", sets={"view_2.baseline_m": 0.5, "noise.sigma_grey": 0, "seed": 1})
    >>> result
    RunResult('smoke', 4 of 4 trials done)
    >>> result.trials[["matching.window_px", "matching.subpixel", "density"]].round(3).reset_index(drop=True)
       matching.window_px matching.subpixel  density
    0                   5              none    0.772
    1                   5          parabola    0.772
    2                   7              none    0.738
    3                   7          parabola    0.738
    """
    experiment = load_experiment(experiment, axes=axes, cases=cases, sets=sets)
    if workers is not None and workers < 1:
        raise InputError(f"must be at least 1; found {workers}", key="workers")
    if keep_arrays and out is None:
        raise InputError("needs a folder; give out as well", key="keep_arrays")
    folder = None if out is None else Path(out)
    with ExitStack() as stack:
        if folder is not None:
            make_folder(folder)
        store = stack.enter_context(Store() if folder is None else open_run(experiment, folder))
        maps = prepare_folder(folder / FOLDER) if folder and keep_arrays else None
        before = run_status(experiment, store, maps)
        left = before.plan
        if left.trials:
            shown = someone_watches() if progress is None else progress
            bar = stack.enter_context(Progress(experiment.name, before.total, before.done)) if shown else None
            run_plan(left, store, backend_for(left.total_s, len(left.trials), workers), _observer(bar), maps)
            if bar:
                bar.finish()
        rows = rows_of(experiment, store)
        if folder:
            _say_earlier(folder, *write_tables(experiment, rows, store, folder))
    if all(row.state == "failed" for row in rows):
        raise InputError(rows[0].finished.message)
    return RunResult(experiment, rows, folder)


def _say_earlier(folder: Path, removed: list[str], still_there: list[str]) -> None:
    """Tell what of earlier trials was in the folder, and what is."""
    for what, files in (("removed", removed), ("still there", still_there)):
        if files:
            warnings.warn(f"{folder}: {what}: {listed(files)} of earlier trials", Notice, stacklevel=3)


def _observer(bar: Progress | None) -> Callable[[Sequence[Finished]], None]:
    """The function to call with trials as they finish."""
    return bar.update if bar else lambda _: None
