"""`omnirange scan`: two photographs of your own as a range profile, as a laser scanner would give it."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from harness.cli.command_line import Parser
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_images, add_out, positive
from harness.cli.out_folder import check_out_folder
from harness.cli.range import add_matching, estimate_of, tell_matching, warn_of
from harness.errors import InputError

_OPTIONS = {
    "position_m": "--height",
    "pitch_deg": "--tilt-deg",
    "roll_deg": "--tilt-deg",
    "bearings": "--bearings",
    "low_m": "--band",
    "high_m": "--band",
    "range_max_m": "--range-max",
    "support_px": "--support",
}


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "scan",
        run,
        brief="the nearest obstacle for each bearing, from two images of your own",
        description="Estimate the ranges of two omnidirectional images, as omnirange range does, and write for each "
        "bearing the horizontal distance of the nearest obstacle in a band of heights, with its standard deviation: as "
        "CSV, as the fields of ROS's sensor_msgs/LaserScan (JSON), as PCD and as PLY.",
        epilog="The scan's frame has its origin at viewpoint 1, z up in the world, and x where view 1's x axis points, "
        "projected on the horizontal plane. Bearings turn from x to y, counter-clockwise seen from above.",
    )
    add_images(command)
    add_matching(command)
    add_band(command)
    add_out(command, required=True)


def add_band(command: Parser) -> None:
    """Declare the options for the obstacles' band of heights, and for the height of view 1 above the floor."""
    command.add_argument(
        "--height", type=positive, required=True, metavar="M", help="viewpoint 1 above the floor, metres"
    )
    command.add_argument(
        "--band",
        type=float,
        nargs=2,
        default=(0.1, 1.8),
        metavar=("LOW", "HIGH"),
        help="heights above the floor between which things are obstacles, metres (0.1 1.8)",
    )
    command.add_argument(
        "--tilt-deg",
        type=float,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("PITCH", "ROLL"),
        help="how view 1 is tilted, about y, then x; positive pitch turns x down (0 0)",
    )
    command.add_argument("--bearings", type=int, default=360, metavar="N", help="bearings around the view (360)")
    command.add_argument("--range-max", type=float, default=30.0, metavar="M", help="look no farther, metres (30)")
    command.add_argument(
        "--support", type=int, default=8, metavar="N", help="pixels of the panorama that agree on an obstacle (8)"
    )


def band_of(options: Namespace) -> dict[str, Any]:
    """The settings of a profile that were given; refuses what cannot be."""
    from harness.api.mapping import checked_scan
    from harness.api.warping import viewpoint

    settings = {
        "bearings": options.bearings,
        "low_m": options.band[0],
        "high_m": options.band[1],
        "range_max_m": options.range_max,
        "support_px": options.support,
    }
    low, high = options.band
    if low >= high:
        raise InputError(f"the first must be below the second; found {low:g} and {high:g}", file="--band")
    with naming_options():
        checked_scan(**settings)
        viewpoint((0.0, 0.0, options.height), 0.0, *options.tilt_deg)
    return settings


def run(options: Namespace) -> int:
    """Match, gather, and write the folder."""
    import harness
    from harness.mapping.scan_files import OF_A_SCAN

    settings = band_of(options)  # before anything is matched
    check_out_folder(options, OF_A_SCAN)
    estimate = estimate_of(options)
    if estimate is None:
        return FAILED
    if not estimate.has_metres:
        raise InputError("a band of heights needs metres; give --baseline, --pose or --baseline-length", file="--band")
    with naming_options():
        scan = harness.range_scan(
            estimate, options.height, pitch_deg=options.tilt_deg[0], roll_deg=options.tilt_deg[1], **settings
        )
    scan.write(options.out)
    tell_matching(estimate)
    known = scan.profile.known
    if not known.any():
        print(f"no bearing has an obstacle between {options.band[0]:g} and {options.band[1]:g} m; {options.out}")
        return FAILED
    nearest = scan.range_m[known].min()
    print(
        f"{known.mean():.1%} of {known.size} bearings have an obstacle, the nearest at {nearest:.2f} m; "
        f"{options.out / 'scan.json'}"
    )
    warn_of(estimate.geometry.verdict)
    return OK


@contextmanager
def naming_options() -> Iterator[None]:
    """Name the option that an error is about."""
    try:
        yield
    except InputError as error:
        option = _OPTIONS.get((error.key or "").partition("[")[0])
        raise (InputError(error.problem, file=option) if option else error) from error
