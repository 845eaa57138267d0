"""`omnirange calibrate`: calibrate a sensor from images of a chessboard."""

import argparse
import re
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.command_line import Parser
from harness.cli.options import Commands, add_out
from harness.cli.sensor_options import add_mount_and_field, elevations

if TYPE_CHECKING:
    from harness.api.calibrating import CalibrationResult

_ARGUMENTS = ("corners", "fix", "free", "lens", "start", "model")
"""Arguments of `harness.calibrate` that are also options."""
_IN_TABLES = {
    ("board", "square_m"): "--square-m",
    ("board", "columns"): "--board",
    ("board", "rows"): "--board",
    ("field", "angle_max_deg"): "--angle-max",
}
"""The options that are keys of its tables."""


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "calibrate",
        run,
        brief="calibrate a sensor from images of a chessboard",
        description="Calibrate the sensor that took images of a chessboard: camera model, lens and image centre, with "
        "their covariance and the standard deviation of the rays. Writes the sensor file, and beside it all numbers "
        "(JSON) and a page (HTML).",
        epilog="Boards do not show whether an image is a mirror image, nor which way the camera looks: say so with "
        "--looks and --mirrored if the model's defaults are wrong. Example: omnirange calibrate "
        "images/*.png --board 9x6 --square-m 0.04 --model unified --looks down --mirrored --out sensor.toml",
    )
    images = command.add_argument("images", nargs="*", type=Path, metavar="IMAGE", help="images, each of a whole board")
    completers.offer(images, completers.files())
    command.add_argument(
        "--board", type=_board, metavar="NxM", help="inner corners of the board, those where four squares meet: 9x6"
    )
    command.add_argument("--square-m", type=float, metavar="S", help="side of a square, metres")
    corners = command.add_argument(
        "--corners",
        type=Path,
        metavar="FILE",
        help="corners instead of images: CSV, JSON, NPZ, OpenCV's XML or YAML",
    )
    completers.offer(corners, completers.files())
    command.add_argument(
        "--size", type=int, nargs=2, metavar=("W", "H"), help="size of the images, where the file of corners has none"
    )
    _add_model(command)
    add_out(command, "sensor file (default: print it)", metavar="FILE")


def _add_model(command: Parser) -> None:
    command.add_argument("--model", default="unified", metavar="KIND", help="the camera model (default: unified)")
    command.add_argument(
        "--lens",
        type=_words,
        metavar="TERMS",
        help="lens terms to estimate, such as k1,k2,p1,p2, or none (default: these four for unified, else none)",
    )
    command.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="KEY[=VALUE]",
        help="do not estimate a parameter, such as aspect or xi=0.98; repeatable",
    )
    command.add_argument(
        "--free",
        action="append",
        default=[],
        metavar="KEY",
        help="estimate a parameter that is usually given, such as skew; repeatable",
    )
    command.add_argument(
        "--misalignment",
        action="store_true",
        help="also estimate how the camera is displaced and rotated with respect to its hyperboloid mirror",
    )
    command.add_argument("--start", type=Path, metavar="FILE", help="sensor TOML to start from, instead of a search")
    add_mount_and_field(
        command,
        looks="down for a hyperboloid mirror, up for all others",
        mirrored="yes for a hyperboloid mirror alone",
        angle_max="what the boards cover",
    )


def run(options: Namespace) -> None:
    """Calibrate, write the files, and print the result."""
    import harness
    from harness.errors import InputError
    from harness.spec import dump_toml

    _check_out(options)
    board = None
    if options.board is not None and options.corners is not None:
        raise InputError("leave it out: the file of corners contains their positions on the board", file="--board")
    if options.board is not None:
        if options.square_m is None:
            raise InputError("give the side of a square: --square-m 0.04 for 40 mm", file="--square-m")
        board = {"columns": options.board[0], "rows": options.board[1], "square_m": options.square_m}
    elif options.square_m is not None:  # the corners' unit, for a file that counts squares
        board = {"columns": 2, "rows": 2, "square_m": options.square_m}
    elif options.corners is None:
        raise InputError("give the board's inner corners, as 9x6 for 9 by 6", file="--board")
    mount = {"looks": options.looks, "mirrored": options.mirrored}
    try:
        calibration = harness.calibrate(
            options.images,
            board=board,
            corners=options.corners,
            size=None if options.size is None else tuple(options.size),
            model=options.model,
            lens=options.lens,
            free=[*options.free, *(["misalignment"] if options.misalignment else [])],
            fix=dict(_fixed(each) for each in options.fix),
            start=options.start,
            mount={key: value for key, value in mount.items() if value is not None} or None,
            field=_field(options),
            tell=lambda line: print(line, flush=True),
        )
    except InputError as error:
        if option := _IN_TABLES.get((error.file or "", error.key or "")):
            raise InputError(error.problem, file=option) from error
        if error.file is not None or error.key not in _ARGUMENTS:
            raise
        file = options.start if error.key == "start" else None
        option = "misalignment" if options.misalignment and "misaligned" in error.problem else error.key
        raise InputError(error.problem, file=file, key=f"--{option}") from error
    print("\n".join(_summary(calibration, mount_is_given=None not in mount.values())))
    if options.out is None:
        print(f"\n{dump_toml(calibration.sensor)}")
    else:
        print(", ".join(str(each) for each in calibration.write(options.out)))


def _check_out(options: Namespace) -> None:
    """Check that the files can be written and none is read, and make their folder."""
    from harness.api.calibrating import check_beside, files_of
    from harness.errors import InputError
    from harness.files import check_replaces_none, make_folder_of

    if options.out is None:
        return
    if options.out.suffix.lower() != ".toml":
        raise InputError("must end in .toml: the page and all numbers are written beside it", file=options.out)
    make_folder_of(options.out)
    written = files_of(options.out, has_central=options.misalignment)
    check_replaces_none(written, [options.corners, options.start, *options.images])
    check_beside(written)


def _field(options: Namespace) -> dict[str, float] | None:
    """The field of view in the options; None if no option gives it."""
    if options.angle_max is None and options.elevation is None:
        return None
    low, high = elevations(options) or (-90.0, 90.0)
    angle = 180.0 if options.angle_max is None else options.angle_max
    return {"elevation_min_deg": low, "elevation_max_deg": high, "angle_max_deg": angle}


def _summary(calibration: "CalibrationResult", *, mount_is_given: bool) -> list[str]:
    """The parameters, the residuals of corners, the uncertainty of rays, and warnings, as lines of text."""
    import numpy as np

    values, sigmas = calibration.uncertainty.values.tolist(), calibration.uncertainty.sigma.tolist()
    width = max(20, *map(len, calibration.keys))
    lines = [
        f"  {key:<{width}} {value:>12.6g}  ± {sigma:.2g}"
        for key, value, sigma in zip(calibration.keys, values, sigmas, strict=True)
    ]
    worst = int(np.argmax(calibration.rms_of_images_px))
    lines.append(
        f"{calibration.sensor.model.title}: RMS {calibration.rms_px:.3f} px over "
        f"{len(calibration.corners.image)} corners of {len(calibration.corners.images)} images; "
        f"the worst is {calibration.corners.images[worst]} with {calibration.rms_of_images_px[worst]:.3f} px"
    )
    if calibration.central is not None:
        lines.append(
            f"the best central sensor, with camera and mirror aligned, leaves {calibration.central.rms_px:.3f} px"
        )
    lines.append(
        f"standard deviation of rays, up to a rotation of the sensor: {np.median(calibration.ray_sigma_px):.2g} px "
        f"(median), {calibration.ray_sigma_px.max():.2g} px (largest)"
    )
    if calibration.halves is not None:
        known = calibration.halves.difference_px[np.isfinite(calibration.halves.difference_px)]
        lines.append(
            f"two halves of the images differ by {np.median(known):.2g} px (median), {known.max():.2g} px (largest)"
        )
    coverage = calibration.coverage
    lines.append(
        f"corners lie {coverage.innermost_deg:.0f}° to {coverage.outermost_deg:.0f}° off the axis, in "
        f"{coverage.share:.0%} of the field"
    )
    mirrored = "a mirror image" if calibration.sensor.mirrored else "not a mirror image"
    mount = f"the camera looks {calibration.sensor.looks}, {mirrored}"
    lines.append(mount if mount_is_given else f"assumed: {mount} (--looks, --mirrored)")
    return lines + [f"note: {each}" for each in calibration.notes]


def _board(text: str) -> tuple[int, int]:
    size = re.fullmatch(r"(\d{1,3})\s*[xX×,]\s*(\d{1,3})", text)
    if not size:
        raise argparse.ArgumentTypeError(f"must be two numbers of inner corners, as 9x6; found '{text}'")
    return int(size[1]), int(size[2])


def _words(text: str) -> list[str]:
    return [] if text == "none" else [each.strip() for each in text.split(",") if each.strip()]


def _fixed(text: str) -> tuple[str, float | None]:
    from harness.errors import InputError

    key, equals, value = text.partition("=")
    try:
        return key.strip(), float(value) if equals else None
    except ValueError:
        raise InputError(f"must be KEY or KEY=NUMBER; found '{text}'", file="--fix") from None
