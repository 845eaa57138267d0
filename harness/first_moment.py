"""Handling of Ctrl-C from the command's first moment, before imports that it would end with a traceback.

Python loads the package `harness` before `harness.__main__`, so the package itself begins with this module, which in
turn needs nothing that is not in memory already.
"""

import os
import sys
from _signal import (  # type: ignore[import-not-found]  # `signal` itself loads `enum` first
    SIGINT,
    default_int_handler,
    getsignal,
    signal,
)

EXIT_CODE = 130
"""Exit code of a program that was ended by Ctrl-C."""

_exit = os._exit  # the original, should other code replace it


def end_at_once(_number: int = 0, _frame: object = None) -> None:
    """A signal's handler: end the process without a word to anybody else.

    For the time before there is anything to be lost, or after all is written.
    """
    end("omnirange: interrupted")


def end(line: str) -> None:
    """End the process with a line on stderr and the exit code of Ctrl-C."""
    show_cursor = b"\x1b[?25h" if os.isatty(2) else b""  # a progress bar has hidden it
    try:
        os.write(2, show_cursor + f"\n{line}\n".encode())
    finally:
        _exit(EXIT_CODE)  # the database is whole at any moment, and workers end with their parent


def listen(arguments: list[str]) -> None:
    """Answer Ctrl-C from now on, if this process is the command: in a script or a notebook nothing changes.

    Parameters
    ----------
    arguments
        With which Python was started, `sys.orig_argv`.
    """
    if _is_command(arguments) and getsignal(SIGINT) is default_int_handler:  # not when run in the background
        signal(SIGINT, end_at_once)


def _is_command(arguments: list[str]) -> bool:
    rest = iter(arguments[1:])
    for each in rest:
        if each in ("-X", "-W"):
            next(rest, None)
        elif each == "-m":
            return next(rest, "") == "harness"
        elif not each.startswith("-"):
            return os.path.basename(each).removesuffix(".exe") == "omnirange"  # noqa: PTH119 - pathlib is not loaded yet
        elif each == "-c":
            return False
    return False


listen(sys.orig_argv)
