"""`omnirange warp`: two photographs of your own as a view from somewhere else."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager

from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_images, add_out
from harness.cli.out_folder import check_out_folder
from harness.cli.range import add_matching, estimate_of
from harness.errors import InputError

_OPTIONS = {
    "position_m": "--to",
    "yaw_deg": "--yaw-deg",
    "pitch_deg": "--pitch-deg",
    "roll_deg": "--roll-deg",
    "field_deg": "--field-deg",
    "width_px": "--view-size",
    "height_px": "--view-size",
}


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "warp",
        run,
        brief="show two images of your own from another viewpoint",
        description="Estimate the ranges of two omnidirectional images, as omnirange range does, and warp both to the "
        "view from another viewpoint.",
        epilog="Frames are the sensor's, z up along the mirror's axis. What neither image shows is black unless --fill "
        "is given.",
    )
    add_images(command)
    add_matching(command)
    command.add_argument(
        "--to",
        type=float,
        nargs=3,
        required=True,
        metavar=("X", "Y", "Z"),
        help="the new viewpoint in view 1's frame, metres; baselines where the scale is not known",
    )
    for angle, axis in (("yaw", "the vertical axis z"), ("pitch", "y"), ("roll", "x")):
        command.add_argument(f"--{angle}-deg", type=float, default=0.0, metavar="A", help=f"turn about {axis}, degrees")
    command.add_argument(
        "--as",
        dest="projection",
        choices=("panorama", "mirror", "perspective"),
        default="panorama",
        help="a panorama, an image of view 1's sensor or that of --as-sensor, or a pinhole image along x (panorama)",
    )
    seen_by = command.add_argument("--as-sensor", metavar="FILE", help="with --as mirror: whose image it is to be")
    completers.offer(seen_by, completers.files(".toml"))
    command.add_argument(
        "--field-deg", type=float, default=90.0, metavar="A", help="with --as perspective: horizontal field (90)"
    )
    command.add_argument(
        "--view-size",
        type=int,
        nargs=2,
        default=(640, 480),
        metavar=("W", "H"),
        help="with --as perspective: pixels (640 480)",
    )
    command.add_argument("--fill", action="store_true", help="fill holes from their surroundings")
    add_out(command, required=True)


def run(options: Namespace) -> int:
    """Match, warp, and write the folder."""
    import harness
    from harness.api.warping import OF_A_VIEW, check_perspective, viewpoint
    from harness.warping.warp import shares_in_words

    angles = options.yaw_deg, options.pitch_deg, options.roll_deg
    with _naming_options():  # before anything is matched
        viewpoint(options.to, *angles)
        check_perspective(options.field_deg, *options.view_size)
    check_out_folder(options, OF_A_VIEW)
    estimate = estimate_of(options)
    if estimate is None:
        return FAILED
    with _naming_options():
        view = harness.warp_view(
            estimate,
            options.to,
            yaw_deg=angles[0],
            pitch_deg=angles[1],
            roll_deg=angles[2],
            projection=options.projection,
            sensor=options.as_sensor,
            field_deg=options.field_deg,
            width_px=options.view_size[0],
            height_px=options.view_size[1],
            fill=options.fill,
        )
    view.write(options.out)
    print(f"of the pixels {', '.join(shares_in_words(view.state))}; {options.out / 'view.png'}")
    return OK


@contextmanager
def _naming_options() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        option = _OPTIONS.get((error.key or "").partition("[")[0])
        raise (InputError(error.problem, file=option) if option else error) from error
