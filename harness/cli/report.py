"""`omnirange report`: rebuild the tables and the report of a run."""

import os
import warnings
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.options import Commands
from harness.cli.results import say_unused_rows, write
from harness.errors import InputError, Notice

if TYPE_CHECKING:
    from harness.runs.experiment import Experiment
    from harness.runs.store import Store


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
    command.add_argument(
        "--figures", type=Path, metavar="DIR", help="write every figure of the report into a folder, as SVG and PDF"
    )
    tables = command.add_argument(
        "--latex", type=Path, metavar="FILE", help="write the report's tables as LaTeX (package booktabs)"
    )
    completers.offer(tables, completers.files(".tex"))


def run(options: Namespace) -> int:
    """Write all output files of a run."""
    from harness.runs.executors import ONE_THREAD

    os.environ.update(ONE_THREAD | os.environ)  # the threads of libraries get in the way of a copy of this process

    from harness.runs.recorded import recorded
    from harness.runs.run import run_status
    from harness.runs.store import DATABASE, OTHER_CODE, Store
    from harness.runs.written import check_no_others_in

    database = options.folder / DATABASE
    if not options.folder.is_dir():
        problem = "is no folder" if options.folder.exists() else "no such folder"
        raise InputError(f"{problem}; give the output folder of a run", file=options.folder)
    if not database.is_file():
        raise InputError(f"holds no run: there is no {DATABASE} in it", file=options.folder)
    _check_files(options)
    with Store(database) as store:
        check_no_others_in(options.folder, store)
        experiment = recorded(store, database)
        now = run_status(experiment, store)
        if store.other_code:
            warnings.warn(f"{options.folder}: {OTHER_CODE}", Notice, stacklevel=1)
        say_unused_rows(now.unused)
        if now.done < now.total:
            print(f"{experiment.name}: {now.done} of {now.total} trials are done; the report covers those")
        code = write(experiment, store, options.folder, given=options.folder, run_code=options.run_code)
        if options.figures is not None or options.latex is not None:
            _export(experiment, store, options)
        return code


def _check_files(options: Namespace) -> None:
    """Check before anything is rebuilt that the figures and tables can be written, and over nothing of the run."""
    from harness.files import check_folder, is_same, make_folder, make_folder_of
    from harness.pipeline import maps
    from harness.runs import path_maps
    from harness.runs.store import DATABASE
    from harness.runs.written import FAILURES, WRITTEN

    check_folder(options.folder, None)
    if options.figures is not None:
        make_folder(options.figures, "--figures")
    make_folder_of(options.latex, "--latex")
    own = [options.folder / name for name in (*WRITTEN, FAILURES, DATABASE)]
    for name in (maps.FOLDER, path_maps.FOLDER):
        own += (options.folder / name).glob("*")
    if options.latex is not None and any(is_same(options.latex, each) for each in own):
        raise InputError("is a file of the run; give another name", file=options.latex, key="--latex")


def _export(experiment: "Experiment", store: "Store", options: Namespace) -> None:
    """Write figures and tables as files of their own."""
    from harness.files import OwnFiles, check_no_others
    from harness.files import write as write_file
    from harness.report.export import FIGURE_MARK, exported, figures_in, latex_of
    from harness.runs.run import result_of

    sections = exported(result_of(experiment, store, run_code=options.run_code), may_copy=True)
    files = figures_in(sections) if options.figures is not None else {}
    if options.figures is not None:  # before anything is written
        marks = {name: FIGURE_MARK if name.endswith(".svg") else None for name in files}
        check_no_others(options.figures, OwnFiles("report", marks), option="--figures")
    if options.latex is not None:
        write_file(options.latex, latex_of(sections))
        print(f"tables: {options.latex}")
    if options.figures is not None:
        for name, content in files.items():
            write_file(options.figures / name, content)
        print(f"figures: {len(files) // 2} as SVG and PDF in {options.figures}")
