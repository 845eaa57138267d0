"""`omnirange run`: run an experiment's trials, and write its tables and its report."""

import json
import os
import warnings
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from harness import interrupts, shipped
from harness.api.progress import Progress, duration
from harness.cli import options as declare
from harness.cli.exits import OK
from harness.cli.results import say_unused_rows, show, show_report, write
from harness.display import counted, listed
from harness.errors import InputError, Notice

if TYPE_CHECKING:
    from harness.runs.details import Made
    from harness.runs.experiment import Experiment

_START_S = 1.5
"""Seconds until the first trial runs: libraries and compiled code are loaded."""
_REPORT_S = 3.5
"""Seconds that a report takes."""
_SHORT_S = 0.5
"""Seconds of a trial below which the base trial is run here while workers run the others: they do not wait for long."""
_LEAST_BASELINES = 3
"""Baselines over which the law can be tested."""
_MOST_CHECKED = 8
"""Most different sensors that a dry run checks."""


def add(commands: declare.Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "run",
        run,
        brief="run an experiment and write its report",
        description="Run an experiment, print its figures and write results and an HTML report into a folder.",
        epilog=f"shipped experiments: {', '.join(shipped.names('experiments'))}",
    )
    declare.add_experiment(command)
    declare.add_out(command, "output folder (default: results/NAME)")
    declare.add_changes(command)
    command.add_argument(
        "--dry-run", action="store_true", help="print the number of trials and an estimate of the time"
    )
    command.add_argument("--no-report", action="store_true", help="leave out the summary and the report: tables only")
    command.add_argument(
        "--keep-arrays",
        action="store_true",
        help="store every trial's maps (range, angles, truth, sigma) as NPZ files in the folder maps of the output",
    )
    declare.add_backend(command)


def run(options: Namespace) -> int:
    """Run the trials that are not yet done, then write all output files."""
    shipped.find("experiments", options.experiment)  # a mistyped name is told at once
    # Heavy libraries are loaded here, so that it and --help answer before that.
    from harness.runs.executors import ONE_THREAD, backend_for

    os.environ.update(ONE_THREAD | os.environ)  # threads are ours to deal out; read as the libraries are loaded

    from harness.files import check_replaces_none, make_folder
    from harness.pipeline.maps import FOLDER, prepare_folder
    from harness.runs.load import load_experiment
    from harness.runs.preflight import preflight
    from harness.runs.run import is_reported, open_run, run_plan, run_status
    from harness.runs.store import DATABASE
    from harness.runs.written import WRITTEN

    experiment = load_experiment(options.experiment, options.set, options.axis)
    _say_left_out(options, experiment)
    _say_law(experiment)
    shown = options.out or Path("results") / experiment.name
    if not options.dry_run:
        make_folder(shown)
    if not (shown / DATABASE).exists():  # a run's own file says what is written into its place again
        check_replaces_none([shown / name for name in WRITTEN], [Path(options.experiment)])
    if options.dry_run:
        return _dry_run(experiment, options.experiment, shown, with_report=not options.no_report)
    folder = shown.absolute()  # matchers of other people may change the working folder
    with open_run(experiment, folder) as store:
        maps = prepare_folder(folder / FOLDER) if options.keep_arrays else None
        before = run_status(experiment, store, maps)
        interrupts.check()
        say_unused_rows(before.unused)
        if before.done == before.total and is_reported(experiment, store, folder):
            print(f"{experiment.name}: all {before.total} trials are done and the report is written; nothing to do")
            show(json.loads((folder / "summary.json").read_text(encoding="utf-8")))
            show_report(shown)
            return OK
        if before.left:
            preflight(before.left, before.total, options.experiment)
        beforehand: dict[str, Made] = {}
        with Progress(experiment.name, before.total, before.done) as progress:
            try:
                left = before.plan
                if left.trials:
                    backend = backend_for(left.total_s, len(left.trials), options.workers, options.dask)
                    progress.say(
                        f"{counted(len(left.trials), 'trial')} to run {backend.name}, {before.done} done before"
                    )
                    idle = backend.workers > 1 and left.total_s < _SHORT_S * len(left.trials)
                    meanwhile = _meanwhile(experiment, beforehand) if idle and not options.no_report else ()
                    run_plan(left, store, backend, progress.update, maps, meanwhile)
            except KeyboardInterrupt:
                progress.stop()
                states = store.states(each.key for each in experiment.planned)
                done = sum(state == "done" for state in states.values())
                raise KeyboardInterrupt(
                    f"{done} of {before.total} trials are done and stored; run the same command to resume"
                ) from None
            progress.finish()
        return write(
            experiment,
            store,
            folder,
            given=options.experiment,
            shown=shown,
            with_report=not options.no_report,
            beforehand=beforehand,
        )


def _meanwhile(experiment: "Experiment", beforehand: "dict[str, Made]") -> Iterator[None]:
    """What the report needs besides the rows, in steps: the base trial's outcomes, and libraries."""
    from harness.runs.details import made_beforehand

    yield from made_beforehand(experiment, beforehand)
    from harness.report import build  # noqa: F401

    yield


def _say_left_out(options: Namespace, experiment: "Experiment") -> None:
    """Tell which of the experiment's axes a matcher or camera model of an option has left without a meaning."""
    from harness.runs.dotted import KIND, MODEL_KINDS
    from harness.runs.load import own_axes

    kinds = [
        f"{option} {each}"
        for option, given in (("--set", options.set), ("--axis", options.axis))
        for each in given
        if each.partition("=")[0].strip() in (KIND, *MODEL_KINDS)
    ]
    if not kinds:
        return
    meant = {each.partition("=")[0].strip() for each in options.set}  # these say themselves that they replace an axis
    gone = [key for key in own_axes(options.experiment) if key not in experiment.axes and key not in meant]
    if gone:
        one = len(gone) == 1
        text = f"{experiment.name}: the {'axis' if one else 'axes'} {listed(gone)} {'is' if one else 'are'} left out: "
        has_none = "has no such setting" if len(kinds) == 1 else "have no such setting, or not all of them"
        warnings.warn(f"{text}{listed(kinds)} {has_none}", Notice, stacklevel=1)


def _say_law(experiment: "Experiment") -> None:
    """Tell that the law cannot be tested, where it is asked for; and for one version more that it is not unasked."""
    from harness.runs.headline import BASELINE

    baselines = len({each.trial.view_2.baseline_m for each in experiment.planned})
    if experiment.law and baselines < _LEAST_BASELINES:
        text = f"{experiment.name}: law: the law cannot be tested with {counted(baselines, 'baseline')}; it takes "
        warnings.warn(f"{text}{_LEAST_BASELINES}, such as --axis {BASELINE}=0.25,0.5,1", Notice, stacklevel=1)
    if "law" not in experiment.model_fields_set and len(experiment.axes.get(BASELINE, ())) >= _LEAST_BASELINES:
        text = f"{experiment.name}: the law is not tested; `law = true` in the experiment's file asks for it, `law = "
        warnings.warn(f"{text}false` says that it is meant (earlier versions tested it unasked)", Notice, stacklevel=1)


def _dry_run(experiment: "Experiment", given: str, folder: Path, *, with_report: bool) -> int:
    from harness.machine import available_cpus
    from harness.pipeline.sight import check_sight
    from harness.runs.cases import CASE
    from harness.runs.plan import plan
    from harness.runs.preflight import preflight
    from harness.runs.run import check_folder_of_run

    check_folder_of_run(experiment, folder)
    preflight(experiment.planned, len(experiment.planned), given)
    # The first trial of each pair of sensors: give the errors and notices that it would give when run.
    by_sensors = {each.trial.sensors: each.trial for each in reversed(experiment.planned)}
    for trial in list(by_sensors.values())[:_MOST_CHECKED]:
        try:
            check_sight(trial, trial.true_motion)
        except InputError as error:
            warnings.warn(f"{error}: this trial will fail", Notice, stacklevel=1)
    whole = plan(experiment.planned)
    cpus = available_cpus()
    seconds = _START_S + whole.total_s / cpus + (_REPORT_S if with_report else 0.0)
    rounded = duration(float(f"{seconds:.2g}"))
    time = (
        f"about {rounded} on {cpus} CPU{'s' * (cpus != 1)} (a guess from sizes of images and the matchers)"
        if not whole.unknown
        else f"no estimate of the time: that of {listed(f'“{each}”' for each in whole.unknown)} is not known"
    )
    print(
        f"{experiment.name}: {counted(len(whole.trials), 'trial')}, {counted(whole.renders, 'distinct render')}, {time}"
    )
    counts = Counter(each.coordinates.get(CASE) for each in experiment.planned)
    for name, count in counts.items():
        if name is not None:
            print(f"  case {name}: {count} trial{'s' * (count != 1)}")
    return OK
