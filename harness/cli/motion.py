"""`omnirange motion`: estimate the motion between two photographs of your own."""

from argparse import Namespace
from pathlib import Path

from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.motion_options import add_length, check_length, naming_options
from harness.cli.options import Commands, add_images, add_out
from harness.cli.sensor_options import add_sensor, first_sensor, second_sensor


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "motion",
        run,
        brief="estimate rotation and direction between two images of your own",
        description="Estimate from two images how view 2 is turned and in which direction it stands, and say whether "
        "that can be trusted. Needs pip install 'omnirange[motion]'.",
        epilog="Exit code 1 if the images do not determine the motion.",
    )
    add_images(command)
    add_sensor(command, "sensor TOML or calibration file of both views", required=True, second=True)
    group = command.add_mutually_exclusive_group()
    group.add_argument("--upright", action="store_true", help="the sensor's z is vertical in both views")
    group.add_argument("--planar", action="store_true", help="and the sensor has moved horizontally")
    add_length(command)
    command.add_argument(
        "--sparse", action="store_true", help="use keypoints only: faster, and several times less accurate"
    )
    command.add_argument(
        "--calibration-sigma-px",
        type=float,
        default=0.0,
        metavar="PX",
        help="standard deviation of the calibration, pixels of the image, which is counted into the sigmas (0)",
    )
    command.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the random samples (0)")
    add_out(command, "write view 2's pose in view 1's frame, TOML for omnirange range --pose", metavar="FILE")
    report = command.add_argument("--json", type=Path, metavar="FILE", help="write all figures as JSON")
    completers.offer(report, completers.files(".json"))


def run(options: Namespace) -> int:
    """Estimate the motion, print it, and write the requested files."""
    import harness
    from harness.errors import InputError
    from harness.files import check_replaces_none, make_folder_of

    check_length(options)
    if not 0 <= options.calibration_sigma_px < float("inf"):
        raise InputError(f"must be 0 or more; found {options.calibration_sigma_px:g}", file="--calibration-sigma-px")
    if options.seed < 0:
        raise InputError(f"must be 0 or more; found {options.seed}", file="--seed")
    make_folder_of(options.out)
    make_folder_of(options.json, "--json")
    read = [options.left, options.right, options.sensor, options.sensor_2]
    check_replaces_none([options.out], read)
    check_replaces_none([options.json], read, "--json")
    if options.json is not None and options.json == options.out:
        raise InputError("is the file of --out, too; give another name", file=options.json, key="--json")
    sensor = first_sensor(options, central=True)
    assert sensor is not None
    with naming_options():
        estimate = harness.estimate_motion(
            options.left,
            options.right,
            sensor,
            second_sensor(options),
            freedom="planar" if options.planar else "upright" if options.upright else "free",
            baseline_m=options.baseline_length,
            camera_height_m=options.camera_height,
            direct=not options.sparse,
            calibration_px=options.calibration_sigma_px,
            bits=options.bits,
            seed=options.seed,
        )
    for line in estimate.lines():
        print(line)
    if options.json is not None:
        estimate.write_json(options.json)
    if estimate.direction_v1 is None:
        if options.out is not None:
            print(f"{options.out} is not written: no motion was found")
        return FAILED
    if options.out is not None:
        estimate.write(options.out)
        print(f"{options.out}: view 2's pose in view 1's frame")
    return OK
