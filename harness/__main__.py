"""The command `omnirange`, also as `python -m harness`.

Ctrl-C ends it quietly from the first line to the last: while libraries are loaded, and while Python shuts down.
"""

import atexit
import signal
import sys

from harness.interrupts import EXIT_CODE, end_at_once


def main() -> int:
    """Run the command with the process's arguments; the exit code."""
    at_first = signal.getsignal(signal.SIGINT)
    listens = at_first in (signal.default_int_handler, end_at_once)  # not when run in the background
    if listens:
        signal.signal(signal.SIGINT, end_at_once)
    from harness.cli import main as command

    code = None
    try:
        code = command()
    finally:
        if listens:
            # All is written. Python removes its handlers on shutdown, and the default one would kill the process.
            signal.signal(signal.SIGINT, end_at_once)
            atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
        # Python kills itself in the end if a KeyboardInterrupt went through an `exec` of text, such as that of a named
        # tuple: the last one counts, and this one goes well.
        exec("")  # noqa: S102
        if code == EXIT_CODE:  # destructors find things half done
            sys.unraisablehook = lambda _: None
    return code


if __name__ == "__main__":
    sys.exit(main())
