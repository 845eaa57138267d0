"""The command `omnirange`: its sub-commands, and what becomes of their errors."""

import sys
import traceback
from collections.abc import Sequence

from harness import __version__
from harness.cli import cache, check, compare, render, report, run, settings
from harness.cli import photographs as own_pair
from harness.cli.exits import INPUT, INTERRUPTED, OK
from harness.cli.options import Commands, Parser
from harness.errors import InputError

_COMMANDS = (run, report, compare, cache, render, own_pair, check, settings)
"""In the order in which `--help` lists them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `omnirange` command.

    Returns
    -------
    int
        0 when all went well, 1 when a trial failed, 2 when something given is wrong (one line on stderr says what),
        130 after Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        return options.run(options) or OK
    except InputError as error:
        if options.debug:
            traceback.print_exc()
        print(f"omnirange: {error}", file=sys.stderr)
        return INPUT
    except KeyboardInterrupt:
        print("\nomnirange: interrupted; what was being written is left as it was before", file=sys.stderr)
        return INTERRUPTED


def _parser() -> Parser:
    parser = Parser(prog="omnirange", description="Simulation-driven evaluation of omnidirectional stereo.")
    parser.add_argument("--version", action="version", version=f"omnirange {__version__}")
    commands = Commands(parser)
    for command in _COMMANDS:
        command.add(commands)
    return parser
