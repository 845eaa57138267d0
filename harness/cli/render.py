"""`omnirange render`: render one view with its true range."""

from argparse import Namespace

from harness import shipped
from harness.cli import completers
from harness.cli.options import Commands, add_out
from harness.cli.sensor_options import add_sensor, first_sensor
from harness.errors import InputError

_OPTIONS = frozenset({"--at", "--yaw-deg", "--pitch-deg", "--roll-deg", "--samples"})


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "render",
        run,
        brief="render one view with its true range",
        description="Render one view of a scene into a folder that can be used without this program.",
        epilog=f"shipped scenes: {', '.join(shipped.names('scenes'))}",
    )
    scene = command.add_argument("scene", metavar="SCENE", help="a shipped scene's name, or a TOML file")
    completers.offer(scene, completers.scenes, completers.files(".toml"))
    add_sensor(command, "sensor TOML or calibration file (default: the paper experiment's)")
    command.add_argument(
        "--at", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help="viewpoint in the world, metres"
    )
    for angle, axis in (("yaw", "the vertical axis z"), ("pitch", "y"), ("roll", "x")):
        command.add_argument(f"--{angle}-deg", type=float, default=0.0, metavar="A", help=f"turn about {axis}, degrees")
    command.add_argument(
        "--samples", type=int, default=16, metavar="N", help="least number of rays per pixel, a square number (16)"
    )
    command.add_argument(
        "--colour", action="store_true", help="render red, green and blue, from the scene's coloured textures"
    )
    command.add_argument(
        "--pov",
        action="store_true",
        help="write a scene for POV-Ray too, with the physical mirror; hyperboloid mirrors without lens terms only",
    )
    add_out(command, required=True)


def run(options: Namespace) -> None:
    """Render the view, and write the folder."""
    import harness
    from harness.files import check_empty_or_own, check_folder
    from harness.pipeline.rendered_view import OF_A_RENDERED_VIEW

    check_folder(options.out)
    check_empty_or_own(options.out, OF_A_RENDERED_VIEW)
    try:
        view = harness.render(
            options.scene,
            sensor=first_sensor(options),
            position_m=options.at,
            yaw_deg=options.yaw_deg,
            pitch_deg=options.pitch_deg,
            roll_deg=options.roll_deg,
            samples=options.samples,
            colour=options.colour,
        )
    except InputError as error:
        key = "" if error.file is not None else error.key or ""
        option = "--at" if key.startswith("position_m") else f"--{key.replace('_', '-')}"
        raise (InputError(error.problem, file=option) if option in _OPTIONS else error) from error
    view.write(options.out, pov=options.pov)
    print(f"{view.scene.name} seen from {tuple(options.at)} m: {options.out}")
