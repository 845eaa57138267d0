"""`omnirange range`: range from two photographs of one's own."""

from argparse import Namespace
from pathlib import Path

from harness.cli import completers
from harness.cli.options import Commands, add_out


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "range",
        run,
        brief="range from two mirror images of your own",
        description="Match two mirror images and write the range of every pixel of the first view's panorama, its "
        "predicted standard deviation, a coloured point cloud and a page. No truth is needed.",
        epilog="Frames are the sensor's, z up along the mirror's axis; the panorama is an experiment's by default.",
    )
    command.add_argument("left", type=Path, metavar="LEFT", help="mirror image of view 1 (PNG, JPEG, TIFF ...)")
    command.add_argument("right", type=Path, metavar="RIGHT", help="mirror image of view 2")
    command.add_argument("--sensor", type=Path, required=True, metavar="FILE", help="sensor TOML: mirror, camera, lens")
    command.add_argument(
        "--sensor-2", type=Path, metavar="FILE", help="sensor TOML of view 2, if another sensor took it"
    )
    command.add_argument(
        "--bits",
        type=int,
        choices=range(8, 17),
        metavar="N",
        help="white is the level 2^N - 1 in both images, N from 8 to 16, as 10 or 12 for raw images in 16-bit files "
        "(default: by the file's type, 255 for 8 bits, 65535 for 16 bits, 1 for floating point)",
    )
    command.add_argument(
        "--baseline",
        type=float,
        nargs=3,
        required=True,
        metavar=("X", "Y", "Z"),
        help="viewpoint 2 seen from viewpoint 1, in view 1's frame, metres",
    )
    command.add_argument(
        "--rotation-deg",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("YAW", "PITCH", "ROLL"),
        help="how view 2 is turned against view 1: about z, then y, then x (0 0 0)",
    )
    matcher = command.add_argument(
        "--matcher", default="", metavar="KIND", help="any matcher's kind (default: slanted)"
    )
    completers.offer(matcher, completers.kinds)
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting of the matcher, such as window_px=15 or d_min_m=0.5, or of the panorama, such as "
        "panorama.width_px=1440; repeatable",
    )
    add_out(command, required=True)


def run(options: Namespace) -> None:
    """Match, and write the folder."""
    import harness
    from harness.errors import InputError
    from harness.runs.photograph_settings import own_settings
    from harness.spec import parse

    sensor = harness.load_sensor(options.sensor)
    yaw, pitch, roll = options.rotation_deg
    second = parse(
        harness.Pose,
        {"position_m": options.baseline, "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll},
        file="--baseline",
    )
    motion = harness.relative_motion(harness.Pose(), second)
    if not motion.baseline_m > 0:
        raise InputError("must not be zero: two views from one place tell no range", file="--baseline")
    settings = own_settings(options.matcher, options.set)
    estimate = harness.estimate_range(
        options.left,
        options.right,
        sensor,
        motion,
        settings.matching,
        sensor_2=options.sensor_2,
        grid=settings.panorama,
        bits=options.bits,
    )
    estimate.write(options.out)
    for photograph in estimate.photographs:
        print(f"{photograph.file}: {photograph.scale}")
    print(f"{estimate.valid.mean():.1%} of the panorama has a range; {options.out / 'range.html'}")
