"""`omnirange report`: rebuild the tables and the report of a run."""

import warnings
from argparse import Namespace
from pathlib import Path

from harness.cli import completers
from harness.cli.options import Commands
from harness.cli.results import say_unused_rows, write
from harness.errors import InputError, Notice


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "report",
        run,
        brief="rebuild the report of a run",
        description="Rebuild the tables, the summary and the report of a run from its folder. "
        "No program and no plug-in that the run names is run.",
    )
    finished = command.add_argument("folder", type=Path, metavar="DIR", help="output folder of a run")
    completers.offer(finished, completers.folders)
    command.add_argument(
        "--run-code",
        action="store_true",
        help="run the programs and plug-ins that the run names where their results are not stored; only for runs that "
        "you trust",
    )


def run(options: Namespace) -> int:
    """Write all output files of a run."""
    from harness.runs.recorded import recorded
    from harness.runs.run import run_status
    from harness.runs.store import DATABASE, OTHER_CODE, Store

    database = options.folder / DATABASE
    if not database.is_file():
        raise InputError(f"holds no run: there is no {DATABASE} in it", file=options.folder)
    with Store(database) as store:
        experiment = recorded(store, database)
        now = run_status(experiment, store)
        if store.other_code:
            warnings.warn(f"{options.folder}: {OTHER_CODE}", Notice, stacklevel=1)
        say_unused_rows(now.unused)
        if now.done < now.total:
            print(f"{experiment.name}: {now.done} of {now.total} trials are done; the report covers those")
        return write(experiment, store, options.folder, given=options.folder, run_code=options.run_code)
