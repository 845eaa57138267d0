"""The command `omnirange`: its sub-commands, and how their errors are reported."""

import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import TextIO

from harness import interrupts
from harness.cli import (
    cache,
    calibrate,
    check,
    compare,
    completion,
    dataset,
    design,
    motion,
    render,
    report,
    run,
    scan,
    score,
    sensor,
    settings,
    warp,
)
from harness.cli import list as list_command
from harness.cli import map as map_command
from harness.cli import range as range_command
from harness.cli.command_line import Parser
from harness.cli.exits import BUG, INPUT, INTERRUPTED, OK
from harness.cli.heartbeat import heartbeat
from harness.cli.options import Commands
from harness.cli.output import patient_output
from harness.errors import InputError, Notice, described, one_line
from harness.version import __version__

_COMMANDS = (
    run,
    report,
    compare,
    cache,
    render,
    motion,
    range_command,
    warp,
    scan,
    map_command,
    calibrate,
    check,
    sensor,
    design,
    dataset,
    score,
    list_command,
    settings,
    completion,
)
"""The sub-commands, in the order of `--help`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `omnirange` command.

    Returns
    -------
    int
        0 on success, 1 when a trial failed, 2 for invalid input (with one line on stderr), 70 for a bug in this program
        (likewise), 130 after Ctrl-C.
    """
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions: answer, and end the program
        import argcomplete

        argcomplete.autocomplete(_parser())
    arguments = sys.argv[1:] if arguments is None else arguments
    for each in arguments:
        if not _is_unicode(each):
            print(f"omnirange: {each!a}: an argument must be UTF-8, without null bytes", file=sys.stderr)
            return INPUT
    debug = "--debug" in arguments
    try:
        with interrupts.heard(), patient_output(), heartbeat(), warnings.catch_warnings():
            warnings.showwarning = _Notices().show
            warnings.simplefilter("default", Notice)  # shown, whatever filters apply to other warnings
            options = _parser().parse_args(arguments)
            try:
                return options.run(options) or OK
            except SystemExit as error:  # only the parser may end the program
                raise RuntimeError(f"a library tried to end the program ({error.code})") from error
    except KeyboardInterrupt as error:
        detail = error.args[0] if error.args else "files that were being written are unchanged"
        print(f"\nomnirange: interrupted; {detail}", file=sys.stderr)
        return INTERRUPTED
    except SystemExit:
        raise
    except BaseException as error:  # noqa: BLE001 - nothing leaves this program as a traceback
        if debug:
            traceback.print_exc()
        text, code = _explained(error)
        print(f"omnirange: {one_line(text)}", file=sys.stderr)
        return code


def _explained(error: BaseException) -> tuple[str, int]:
    """The message of an error, and the exit code."""
    if isinstance(error, InputError):
        return str(error), INPUT
    if isinstance(error, MemoryError):
        return "there is not enough memory for this; smaller images, fewer samples or fewer workers need less", INPUT
    if isinstance(error, RecursionError):
        return "something that was given is nested too deeply", INPUT
    if isinstance(error, OSError) and error.strerror:
        where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, (str, bytes)) else ""
        return f"{where}{error.strerror}", INPUT
    if isinstance(error, UnicodeError):
        return f"something that was given is not text in UTF-8 ({error})", INPUT
    report = "this is a bug in omnirange; please report it with the output of the same command with --debug"
    return f"{described(error)}: {report}", BUG


def _is_unicode(text: str) -> bool:
    """Whether a text can be encoded: it contains no bytes that were not valid UTF-8."""
    return "\0" not in text and not any("\ud800" <= letter <= "\udfff" for letter in text)


class _Notices:
    """Shows each notice once, as one line like other messages; warnings of libraries as Python does.

    Python's own register of shown warnings is reset whenever a library changes its filters for a while.
    """

    def __init__(self) -> None:
        self._said: set[str] = set()

    def show(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        """Replaces `warnings.showwarning`."""
        if not issubclass(category, Notice):
            # A library that swallowed the interrupt may warn about the consequences: pydantic does.
            if not interrupts.asked():
                print(
                    warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr, end=""
                )
        elif str(message) not in self._said:
            self._said.add(str(message))
            print(f"omnirange: {message}", file=sys.stderr)


def _parser() -> Parser:
    parser = Parser(prog="omnirange", description="Simulation-driven evaluation of omnidirectional stereo.")
    parser.set_defaults(run=list_command.run)  # for the program without a sub-command
    parser.add_argument("--version", action="version", version=f"omnirange {__version__}")
    commands = Commands(parser)
    for command in _COMMANDS:
        command.add(commands)
    return parser
