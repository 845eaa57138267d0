"""Declaration of sub-commands, and the options that several of them have."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from harness.cli import completers
from harness.cli.command_line import Parser


class Commands:
    """The sub-commands of a program."""

    def __init__(self, parser: Parser) -> None:
        self._parsers = parser.add_subparsers(title="commands", metavar="COMMAND", parser_class=type(parser))

    def add(
        self,
        name: str,
        run: Callable[[argparse.Namespace], int | None],
        *,
        brief: str,
        description: str,
        epilog: str = "",
    ) -> Parser:
        """Declare a sub-command, with the options that all have.

        Parameters
        ----------
        run
            Executes it, and returns the exit code; None is 0.
        brief
            The summary in the program's `--help`.
        description, epilog
            The text before and after the options in its own `--help`.
        """
        command = self._parsers.add_parser(name, help=brief, description=description, epilog=epilog)
        command.add_argument("--debug", action="store_true", help="show the traceback of an error")
        command.set_defaults(run=run)
        return command


def add_experiment(command: Parser) -> None:
    """Add `experiment`: a name or a path."""
    argument = command.add_argument(
        "experiment", metavar="EXPERIMENT", help="a shipped experiment's name, or a TOML file"
    )
    completers.offer(argument, completers.experiments, completers.files(".toml"))


def add_images(command: Parser) -> None:
    """Add `LEFT`, `RIGHT` and `--bits`: the images of both views, and their white level."""
    command.add_argument("left", type=Path, metavar="LEFT", help="image of view 1 (PNG, JPEG, TIFF ...)")
    command.add_argument("right", type=Path, metavar="RIGHT", help="image of view 2")
    command.add_argument(
        "--bits",
        type=int,
        choices=range(8, 17),
        metavar="N",
        help="white is the level 2^N - 1 in both images, N from 8 to 16, such as 10 or 12 for raw images in "
        "16-bit files (default: by the file's type, 255 for 8 bits, 65535 for 16 bits, 1 for floating point)",
    )


def add_out(command: Parser, what: str = "output folder", *, metavar: str = "DIR", required: bool = False) -> None:
    """Add `--out` as `out`: a path, or None when it is optional and missing."""
    out = command.add_argument("--out", type=Path, metavar=metavar, required=required, help=what)
    completers.offer(out, completers.folders if metavar == "DIR" else completers.files())


def add_changes(command: Parser, *, axes: bool = True) -> None:
    """Add `--set` and `--axis` as `set` and `axis`: lists of text, parsed by `load_experiment`."""
    changed = command.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting of the base trial; repeatable"
    )
    completers.offer(changed, completers.changes)
    if axes:
        varied = command.add_argument(
            "--axis",
            action="append",
            default=[],
            metavar="KEY=A,B,C",
            help="add an axis, or replace one; repeatable",
        )
        completers.offer(varied, completers.changes)


def add_backend(command: Parser) -> None:
    """Add `--workers` and `--dask` as `workers` and `dask`: a number or an address, parsed by `backend_for`."""
    where = command.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=whole_number, metavar="N", help="number of processes (default: one per CPU, if it saves time)"
    )
    where.add_argument("--dask", metavar="ADDRESS", help="run on a Dask cluster, such as tcp://127.0.0.1:8786")


def whole_number(text: str) -> int:
    """The whole number, of at least 1, that a text spells."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1; found '{text}'")
    return int(text)


def positive(text: str) -> float:
    """A number above 0, for `type` of an argument."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be a number above 0; found '{text}'")
    return value
