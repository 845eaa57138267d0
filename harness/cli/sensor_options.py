"""Options for sensors: a file of any known format, and values that calibrations do not contain."""

import argparse
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.command_line import Parser
from harness.cli.options import positive

if TYPE_CHECKING:
    from harness.camera.sensor import Sensor
    from harness.io.calibrations.sensors import Chosen


def add_sensor(command: Parser, what: str, *, required: bool = False, second: bool = False) -> None:
    """Add `--sensor` and the options of `add_choices`, which apply to those of two sensors that are calibrations.

    Parameters
    ----------
    what
        Its help.
    second
        Whether view 2 may have one of its own, `--sensor-2` with `--camera-2`.
    """
    options = [command.add_argument("--sensor", type=Path, required=required, metavar="FILE", help=what)]
    if second:
        words = "the same of view 2, if another sensor took it; what follows then holds for those that are calibrations"
        options.append(command.add_argument("--sensor-2", type=Path, metavar="FILE", help=words))
    for each in options:
        completers.offer(each, completers.sensors, completers.files())
    add_choices(command)
    if second:
        command.add_argument("--camera-2", type=int, metavar="N", help="which camera of --sensor-2, from 0")


def add_choices(command: Parser) -> None:
    """Add the options for values that a calibration file does not contain, or that override a sensor file's."""
    command.add_argument(
        "--camera", type=int, metavar="N", help="number of the camera in a calibration with several, from 0"
    )
    add_mount_and_field(command, looks="up, for a calibration", mirrored="no, for a calibration")
    command.add_argument(
        "--size",
        type=int,
        nargs=2,
        metavar=("W", "H"),
        help="size of the image, for a calibration that does not contain it",
    )


def add_mount_and_field(command: Parser, *, looks: str, mirrored: str, angle_max: str = "") -> None:
    """Add `--looks`, `--mirrored`, `--angle-max` and `--elevation`, with the defaults for their help texts."""
    command.add_argument(
        "--looks",
        choices=("up", "down", "forward"),
        help=f"where its optical axis points (default: {looks})",
    )
    command.add_argument(
        "--mirrored",
        action=argparse.BooleanOptionalAction,
        help=f"whether its image is reversed left to right, as in a mirror (default: {mirrored})",
    )
    default = f" (default: {angle_max})" if angle_max else ""
    command.add_argument(
        "--angle-max",
        type=positive,
        metavar="DEG",
        help=f"largest angle of the field off the optical axis, degrees{default}",
    )
    command.add_argument(
        "--elevation",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="lowest and highest elevation of the field, degrees",
    )


def elevations(options: Namespace) -> tuple[float, float] | None:
    """The lowest and the highest elevation of `--elevation`; None if it is not given."""
    from harness.errors import InputError

    if options.elevation is None:
        return None
    low, high = options.elevation
    if not -90 <= low < high <= 90:
        problem = f"the first must be below the second, both within -90 .. 90; found {low:g} and {high:g}"
        raise InputError(problem, file="--elevation")
    return low, high


def chosen(options: Namespace, camera: int | None) -> "Chosen":
    """The values of the options of `add_choices`, with the number of a camera."""
    from harness.io.calibrations.sensors import Chosen

    return Chosen(
        camera=camera,
        looks=options.looks,
        mirrored=options.mirrored,
        size=tuple(options.size) if options.size else None,
        angle_max_deg=options.angle_max,
        elevation_deg=elevations(options),
    )


def first_sensor(options: Namespace, *, central: bool = False) -> "Sensor | None":
    """The sensor of `--sensor`; None if it is not given.

    Parameters
    ----------
    central
        Whether a misaligned one is refused.
    """
    from harness.camera.sensor import require_central
    from harness.errors import InputError
    from harness.io.calibrations.sensors import Chosen, load_sensor

    if options.sensor is None:
        if chosen(options, options.camera) != Chosen():
            raise InputError("is missing: there is no file for the other options to choose from", file="--sensor")
        return None
    other = getattr(options, "sensor_2", None)
    sensor = load_sensor(options.sensor, _of_file(options, options.sensor, options.camera, other))
    if central:
        require_central(sensor, options.sensor)
    return sensor


def second_sensor(options: Namespace) -> "Sensor | None":
    """The sensor of `--sensor-2`; None if it is not given. A misaligned one is refused."""
    from harness.camera.sensor import require_central
    from harness.errors import InputError
    from harness.io.calibrations.sensors import load_sensor

    if options.sensor_2 is None:
        if options.camera_2 is not None:
            raise InputError("is missing: there is no file for --camera-2 to choose from", file="--sensor-2")
        return None
    try:
        sensor = load_sensor(options.sensor_2, _of_file(options, options.sensor_2, options.camera_2, options.sensor))
        require_central(sensor, options.sensor_2)
    except InputError as error:
        key = "--camera-2" if error.key == "--camera" else error.key
        raise InputError(error.problem, file=error.file, key=key) from error
    return sensor


def _of_file(options: Namespace, file: Path, camera: int | None, other: Path | None) -> "Chosen":
    """The options that apply to a file.

    Of two sensors they hold for those that are calibrations of other programs, which need them: a sensor's own TOML
    says how it is mounted.
    """
    from harness.errors import InputError
    from harness.io.calibrations.sensors import Chosen, says_its_mount

    choices = chosen(options, camera)
    if other is None or choices == Chosen(camera=camera) or not says_its_mount(file):
        return choices
    if says_its_mount(other):
        raise InputError(
            "both are sensor files, which say their mount, field and size: leave these options out",
            file="--sensor and --sensor-2",
        )
    return Chosen(camera=camera)
