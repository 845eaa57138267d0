"""The command `omnirange`, also as `python -m harness`.

Ctrl-C ends it quietly from the first line to the last: while libraries are loaded, and while Python shuts down.
"""

import atexit
import gc
import signal
import sys

from harness.interrupts import EXIT_CODE, end_at_once

_OBJECTS = 20_000
"""How many objects are made before Python looks for garbage: most of what a command makes stays, and 700 is often."""


def main() -> int:
    """Run the command with the process's arguments; the exit code."""
    at_first = signal.getsignal(signal.SIGINT)
    listens = at_first in (signal.default_int_handler, end_at_once)  # not when run in the background
    if listens:
        signal.signal(signal.SIGINT, end_at_once)
    gc.set_threshold(_OBJECTS)
    from harness.cli import main as command

    code = None
    try:
        code = command()
    finally:
        gc.freeze()  # Python looks for garbage as it shuts down, and all goes with the process
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
