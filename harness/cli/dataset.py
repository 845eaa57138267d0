"""`omnirange dataset`: make a data set, or check one for faults."""

import os
import shutil
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness import interrupts, shipped
from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_backend, add_changes, add_out
from harness.display import counted
from harness.errors import InputError

if TYPE_CHECKING:
    from harness.datasets.specification import DatasetSpec

_CHECK = "check"
"""The word in place of a specification that stands for a check."""
_START_S = 2.0
"""Seconds until the first pair is made: libraries and compiled code are loaded."""


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "dataset",
        run,
        brief="make a data set of pairs with their truth over random scenes, or check one",
        description="Make a data set: pairs of images with range, correspondences, occlusion, normals, poses and "
        "calibrations over seeded random scenes. An interrupted set goes on where it stopped. With "
        "check DIR: check any data set for faults, made by this program or another.",
        epilog=f"shipped data sets: {', '.join(shipped.names('datasets'))}",
    )
    argument = command.add_argument(
        "spec",
        nargs="?",
        default="rooms",
        metavar="SPEC",
        help="a shipped data set's name, or a TOML file (rooms); or the word check",
    )
    checked = command.add_argument("folder", nargs="?", type=Path, metavar="DIR", help="after check: the set's folder")
    completers.offer(checked, completers.folders)
    completers.offer(argument, completers.datasets, completers.files(".toml"))
    add_out(command)
    add_changes(command, axes=False)
    command.add_argument(
        "--dry-run", action="store_true", help="make a few pairs in memory; print the time and the space that all need"
    )
    command.add_argument("--describe", action="store_true", help="print every key of a specification, and its meaning")
    command.add_argument("--only", metavar="A,B", help="with check: names of checks, such as values,images")
    add_backend(command)


def run(options: Namespace) -> int:
    """Make the missing part of the set, or check one."""
    if options.describe:
        _describe()
        return OK
    if options.spec == _CHECK:
        if options.folder is None:
            raise InputError("is missing: the folder of the set to be checked", file="DIR")
        return _check(options.folder, options.only.split(",") if options.only else [])
    if options.folder is not None:
        raise InputError(f"is not expected; a set is made with --out {options.folder}", file=str(options.folder))
    from harness.runs.executors import ONE_THREAD, backend_for

    os.environ.update(ONE_THREAD | os.environ)  # threads are ours to deal out; read as the libraries are loaded

    from harness.datasets.loading import load_spec

    spec = load_spec(options.spec, options.set)
    if options.dry_run:
        _plan(spec)
        return OK
    if options.out is None:
        raise InputError("is missing: the folder in which the set is to be made", key="--out")

    from harness.api.progress import Progress
    from harness.datasets.making import Journal, is_complete, make
    from harness.files import make_folder

    folder: Path = options.out
    make_folder(folder)
    if is_complete(spec, folder):
        print(f"{spec.name}: all {spec.pairs} pairs are made; nothing to do")
        return OK
    journal = Journal(spec, folder)
    interrupts.check()
    done = len(journal.done) * spec.pairs_per_scene
    with Progress(spec.name, spec.pairs, done, "pairs") as progress:
        try:
            left = spec.scenes - len(journal.done)
            backend = backend_for(float(spec.pairs - done), max(left, 1), options.workers, options.dask)
            progress.say(f"{counted(spec.pairs - done, 'pair')} to make {backend.name}, {done} made before")
            make(spec, folder, backend, journal, progress.count)
        except KeyboardInterrupt:
            progress.stop()
            done = len(journal.done) * spec.pairs_per_scene
            raise KeyboardInterrupt(f"{done} of {spec.pairs} pairs are made; run the same command to resume") from None
        progress.finish()
    print(f"{counted(spec.pairs, 'pair')} in {counted(spec.scenes, 'scene')}, {spec.layout} layout: {folder}")
    return OK


def _check(folder: Path, names: list[str]) -> int:
    """Print a line for each check, and its findings below it."""
    from harness.api.datasets import open_dataset
    from harness.cli.check import marks

    data = open_dataset(folder)
    print(f"{folder}: {counted(len(data), 'pair')} in {data.stored.layout.title} layout")
    mark, faults, done = marks(), 0, 0
    for check, findings in data.checks(names):
        interrupts.check()
        if findings is None:
            print(f"{mark[None]} {check.title}: the set has no data for this check", flush=True)
            continue
        print(f"{mark[not findings]} {check.title}", flush=True)
        done += 1
        for each in findings:
            print(f"    {each.where}: {each.text}" if each.where else f"    {each.text}", flush=True)
        faults += len(findings)
    if faults:
        print(f"{faults} finding{'s' * (faults != 1)}")
        return FAILED
    print(f"no fault was found by {done} checks")
    return OK


def _plan(spec: "DatasetSpec") -> None:
    from harness.api.progress import duration
    from harness.datasets.making import measure
    from harness.machine import available_cpus

    cost = measure(spec)
    seconds, cpus = cost.seconds(spec), available_cpus()
    print(
        f"{spec.name}: {counted(spec.pairs, 'pair')} in {counted(spec.scenes, 'scene')}, "
        f"{cost.bytes(spec) / 1e9:.3g} GB, about {duration(_START_S + seconds / cpus)} on {cpus} CPUs "
        f"(measured on a few: {cost.seconds_a_pair:.2f} s of CPU time and "
        f"{cost.bytes_a_pair / 1e6:.2g} MB a pair, {cost.seconds_a_scene:.2f} s a scene)"
    )
    for workers in (16, 128):
        print(f"  on {workers} workers of a cluster, each as fast: {duration(_START_S + seconds / workers)}")


def _describe() -> None:
    from harness.cli.settings import entry
    from harness.datasets.specification import DatasetSpec
    from harness.runs.settings_reference import reference_of

    width = min(100, shutil.get_terminal_size().columns)
    print("\n\n".join(entry(each, width) for each in reference_of(DatasetSpec)))
