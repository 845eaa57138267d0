"""`omnirange compare`: compare runs side by side."""

from argparse import Namespace
from pathlib import Path

from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_out
from harness.cli.out_folder import check_default_page
from harness.cli.tables import differences_table
from harness.display import counted


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "compare",
        run,
        brief="compare runs",
        description="Pair the trials of runs by their settings (scene, pose, noise; the method may differ), print how "
        "their main figures differ and what has no partner, and write a page. The exit code is 1 if nothing pairs.",
    )
    runs = command.add_argument(
        "folders", type=Path, nargs="+", metavar="DIR", help="output folders of runs; two or more"
    )
    completers.offer(runs, completers.folders)
    add_out(command, "the page (default: comparison.html in the last DIR)", metavar="FILE")


def run(options: Namespace) -> int:
    """Write the page, and print a table for every pair of runs; the exit code is 1 if nothing was paired."""
    from rich.console import Console

    from harness.errors import InputError
    from harness.files import check_folder, is_same, make_folder_of, write
    from harness.report.paired_differences import build_comparison
    from harness.runs.earlier import COMPARISON
    from harness.runs.store import DATABASE
    from harness.runs.written import FAILURES, WRITTEN

    make_folder_of(options.out)
    own = (*WRITTEN, FAILURES, DATABASE)
    compared = [folder / name for folder in options.folders for name in own]
    if options.out is not None and any(is_same(options.out, each) for each in compared):
        raise InputError("is a file of a run that is compared; give another name", file=options.out, key="--out")
    page = options.out or options.folders[-1] / COMPARISON
    if options.out is None:
        if page.parent.is_dir():  # what it is otherwise, is told where it is read
            check_folder(page.parent, None)
        check_default_page(page)
    comparison = build_comparison(*options.folders)
    write(page, comparison.html)
    console = Console()
    lines = list(comparison.lines())
    for pairing in comparison.pairings:
        first, second = pairing.first.name, pairing.second.name
        if pairing.why_none:
            console.print(f"{second} against {first}: {pairing.why_none}", markup=False, highlight=False)
            continue
        changed = "; ".join(f"{key}: {old} -> {new}" for key, (old, new) in pairing.differing.items())
        pairs = f"{counted(pairing.pairs, 'pair')}, {counted(pairing.seeds, 'seed')}"
        title = f"{second} against {first}: {pairs}; {changed or 'same settings'}"
        console.print(title, markup=False, highlight=False)
        console.print(differences_table(cells for name, *cells in lines if name == second))
        for phrase in pairing.left_out:
            console.print(f"not paired: {phrase}", markup=False, highlight=False)
    console.print(f"comparison: {page}", soft_wrap=True, highlight=False, markup=False)
    return OK if any(pairing.pairs for pairing in comparison.pairings) else FAILED
