"""`omnirange sensor`: describe a sensor from a calibration file of any known format, or convert the file."""

import math
import os
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.options import Commands, add_out, positive
from harness.cli.out_folder import check_default_page
from harness.cli.sensor_options import add_choices, chosen
from harness.errors import InputError

if TYPE_CHECKING:
    from harness.io.calibrations.conversion import WrittenSensor
    from harness.io.calibrations.sensors import SensorFile

FORMATS = ("toml", "opencv", "opencv-xml", "kalibr", "camodocal", "basalt", "ocamcalib", "colmap")
_PAGE = Path("sensor.html")
_ENDINGS = (".html", ".htm", ".svg", ".png")
"""Those of a page and of pictures."""


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "sensor",
        run,
        brief="describe a sensor; read and write calibration files",
        description="Describe a sensor and its field of view, and draw it; or write it as another program's "
        "calibration. The file may be a sensor's TOML or a calibration by OpenCV, Kalibr, CamOdoCal, basalt, "
        "OCamCalib, OmniMVS or COLMAP.",
        epilog="A calibration does not contain the mount of its camera or its field of view. Defaults: up, not "
        "mirrored, and as far as model and image allow. A camera below a mirror has --looks down --mirrored.",
    )
    file = command.add_argument(
        "file", type=Path, metavar="FILE", help="a sensor or a calibration; the format is recognised by its content"
    )
    completers.offer(file, completers.sensors, completers.files())
    add_choices(command)
    command.add_argument(
        "--central",
        action="store_true",
        help="take the nearest sensor whose rays meet in one viewpoint, which matching needs: OCamCalib's model in "
        "place of a mirror's profile, camera and mirror aligned",
    )
    command.add_argument("--to", choices=FORMATS, metavar="FORMAT", help=f"write it as one of {', '.join(FORMATS)}")
    command.add_argument(
        "--model", metavar="KIND", help="the camera model to write (default: the best of the format's)"
    )
    command.add_argument(
        "--allow-residual",
        type=positive,
        metavar="PX",
        help="accept the closest camera if its RMS residual is at most so many pixels (0.2)",
    )
    add_out(
        command,
        "the page (.html) or picture (.svg, .png), default sensor.html; with --to the file, default standard output",
        metavar="FILE",
    )


def run(options: Namespace) -> None:
    """Describe the sensor, or write its calibration."""
    from harness.runs.executors import ONE_THREAD

    # The matrices of a fit are small: threads would wait for each other.
    os.environ.update({name: value for name, value in ONE_THREAD.items() if "NUMBA" not in name} | os.environ)

    from harness.files import check_replaces_none, make_folder_of
    from harness.io.calibrations.sensors import read_sensor

    _check_out(options)
    read = read_sensor(options.file, chosen(options, options.camera))
    make_folder_of(options.out)
    check_replaces_none([options.out], [options.file])
    if options.out is None and options.to is None:
        check_default_page(_PAGE)
    try:
        if options.central:
            read = _central(read)
        if options.to is None:
            _describe(read, options)
        else:
            _convert(read, options)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.problem, file=options.file, key=error.key) from error


def _check_out(options: Namespace) -> None:
    """Refuse a page, or a picture, whose name has another ending."""
    if options.to is None and options.out is not None and options.out.suffix.lower() not in _ENDINGS:
        problem = "must end in .html, .svg or .png; give --to FORMAT, such as --to toml, to write the sensor itself"
        raise InputError(problem, file=options.out, key="--out")


def _central(read: "SensorFile") -> "SensorFile":
    """The nearest sensor whose rays meet in one viewpoint; says what is left out."""
    from harness.camera.central import central_of
    from harness.report.sensor_words import misalignment_of

    for line in misalignment_of(read.sensor):
        print(line, file=sys.stderr)
    return replace(read, sensor=central_of(read.sensor))


def _describe(read: "SensorFile", options: Namespace) -> None:
    import harness

    described = harness.describe_sensor(read.sensor)
    print(f"{options.file}: {_origin(read)}")
    print(described)
    for note in read.notes:
        print(f"  note: {note}")
    for line in _motion(read):
        print(f"  {line}")
    page = options.out or _PAGE
    described.write(page, read.notes)
    print(f"picture: {page}")


def _origin(read: "SensorFile") -> str:
    """The format of the file, and the camera in it."""
    from harness.io.calibrations import READERS as KNOWN

    if read.calibration is None or read.camera is None:
        return "a sensor file"
    cameras = read.calibration.cameras
    number = cameras.index(read.camera)
    title = KNOWN[read.calibration.format].title
    if len(cameras) == 1:
        return title
    name = f" ({read.camera.name})" if read.camera.name not in ("", f"camera {number}") else ""
    return f"{title}, camera {number}{name} of {len(cameras)}"


def _motion(read: "SensorFile") -> list[str]:
    """The camera's motion from the file's first one, as options of `omnirange range`."""
    from harness.camera.sensor import lens_from_sensor
    from harness.io.calibrations.rigs import transform_between
    from harness.io.motions import motion_of
    from harness.io.view_folder import pose_in

    if read.calibration is None or read.camera is None or read.camera.T_cam_from_first is None:
        return []
    number = read.calibration.cameras.index(read.camera)
    if number == 0:
        return []
    sensor = read.sensor
    pose = pose_in(motion_of(transform_between(read.calibration, 0, number), (lens_from_sensor(sensor),) * 2))
    # Adding 0 takes the sign off a -0.
    position = " ".join(f"{round(each, 9) + 0.0:.6g}" for each in pose.position_m)
    turn = " ".join(f"{round(each, 9) + 0.0:.6g}" for each in (pose.yaw_deg, pose.pitch_deg, pose.roll_deg))
    return [f"motion from camera 0, if both look {sensor.looks}: --baseline {position} --rotation-deg {turn}"]


def _convert(read: "SensorFile", options: Namespace) -> None:
    import harness
    from harness.api.sensors import LARGEST_RESIDUAL_PX
    from harness.camera.sensor import require_central
    from harness.files import write

    require_central(read.sensor, options.file)
    allowed = LARGEST_RESIDUAL_PX if options.allow_residual is None else options.allow_residual
    written = harness.convert_sensor(read.sensor, options.to, model=options.model, allow_residual_px=allowed)
    if options.out is None:
        print(written.text, end="")
    else:
        write(options.out, written.text)
    for line in _conversion_lines(written, read, options.out):
        print(line, file=sys.stdout if options.out else sys.stderr)


def _conversion_lines(written: "WrittenSensor", read: "SensorFile", out: Path | None) -> list[str]:
    """The residuals of the written camera, and what its file does not contain."""
    conversion = written.conversion
    low, high = (math.degrees(each) for each in conversion.angles_rad)
    where = f"over {conversion.pixels} pixels, {low:.4g} to {high:.4g} deg off the optical axis"
    title = conversion.optics.model.title
    if conversion.is_exact:
        nearness = f"exact; rays differ by {math.degrees(conversion.largest_rad):.1e} deg at most {where}"
    else:
        nearness = (
            f"the nearest: RMS {math.degrees(conversion.rms_rad):.2g} deg ({conversion.rms_px:.2g} px), at most "
            f"{math.degrees(conversion.largest_rad):.2g} deg ({conversion.largest_px:.2g} px), {where}"
        )
    lines = [f"{out or written.format}: {title}, {nearness}"]
    if written.format != "toml":
        lines.append(f"mount and field are not in it; read it with {_reading(read)}")
        if read.sensor.mask is not None:
            lines.append(f"the mask is not in it either: {read.sensor.mask.file}")
    return lines


def _reading(read: "SensorFile") -> str:
    """The options with which the file has the sensor's mount and field when it is read back."""
    sensor = read.sensor
    options = [f"--looks {sensor.looks}", *(["--mirrored"] if sensor.mirrored else [])]
    if sensor.field.angle_max_deg < 180:
        options.append(f"--angle-max {sensor.field.angle_max_deg:g}")
    options.append(f"--elevation {sensor.field.elevation_min_deg:g} {sensor.field.elevation_max_deg:g}")
    return " ".join(options)
