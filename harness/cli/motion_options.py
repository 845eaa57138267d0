"""The options for the length of a motion that is estimated from images."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager

from harness.cli.command_line import Parser


def add_length(command: Parser, *, before: str = "") -> None:
    """Add `--baseline-length` and `--camera-height`, of which one may be given.

    Parameters
    ----------
    before
        The beginning of their help texts.
    """
    length = command.add_mutually_exclusive_group()
    length.add_argument(
        "--baseline-length",
        type=float,
        metavar="M",
        help=f"{before}distance of the viewpoints, metres, which images do not determine (default: 1)",
    )
    length.add_argument(
        "--camera-height",
        type=float,
        metavar="M",
        help=f"{before}how high view 1's viewpoint is above the floor, metres: the distance follows from it where a "
        "level floor is seen",
    )


def check_length(options: Namespace) -> None:
    """Check that the lengths are above 0.

    Raises
    ------
    InputError
        Names the option.
    """
    from harness.errors import InputError

    for option, value in (("--baseline-length", options.baseline_length), ("--camera-height", options.camera_height)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"must be above 0; found {value:g}", file=option)


@contextmanager
def naming_options() -> Iterator[None]:
    """An error of `harness.estimate_motion` names the option."""
    from harness.errors import InputError

    try:
        yield
    except InputError as error:
        if error.key != "camera_height_m":
            raise
        raise InputError(error.problem, file="--camera-height") from error
