"""`omnirange check`: test whether a matcher does what every matcher has to do."""

import os
import sys
from argparse import Namespace

from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_changes


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "check",
        run,
        brief="test a matcher, such as your own",
        description="Test a matcher on small scenes, and report the rules that it breaks.",
        epilog="docs/matchers.md says how to write one",
    )
    matcher = command.add_argument(
        "matcher",
        metavar="KIND",
        help="package.module:function, the name of a matcher, or a TOML file with a table [matching]",
    )
    completers.offer(matcher, completers.kinds, completers.files(".toml"))
    add_changes(command, axes=False)


def run(options: Namespace) -> int:
    """Run every check, and print a line for each."""
    from harness.runs.executors import ONE_THREAD

    os.environ.update(ONE_THREAD | os.environ)

    from harness.runs.load import load_matcher

    matcher = load_matcher(options.matcher, options.set)

    from harness.testing.conformity import CHECKS, conformity

    mark = marks()
    width = max(len(check.title) for check in CHECKS)
    passed = 0
    for finding in conformity(matcher):
        passed += finding.passed is True
        print(f"{mark[finding.passed]} {finding.check.title:<{width}}  {finding.text}", flush=True)
    verdict = "all" if passed == len(CHECKS) else f"{passed} of"
    print(f"{options.matcher}: {verdict} {len(CHECKS)} checks passed")
    return OK if passed == len(CHECKS) else FAILED


def marks() -> dict[bool | None, str]:
    """The marks at the beginning of lines; plain letters if the terminal has no others."""
    best: dict[bool | None, str] = {True: "✓", False: "✗", None: "-"}
    try:
        "".join(best.values()).encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return {True: "ok", False: "NO", None: "--"}
    return best
