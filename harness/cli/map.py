"""`omnirange map`: a sequence of photographs of your own as an occupancy grid."""

import csv
import io
import sys
from argparse import Namespace
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_images, add_out
from harness.cli.out_folder import check_out_folder
from harness.cli.range import add_matching, motions_between, ranging, sequence_settings, warn_of
from harness.cli.scan import add_band, band_of, naming_options
from harness.errors import InputError
from harness.files import PICTURE_MARK, OwnFiles

if TYPE_CHECKING:
    from harness.api.mapping import RangeScan
    from harness.api.motion import MotionEstimate
    from harness.camera.sensor import Sensor
    from harness.pipeline.geometry_check import Verdict

_COLUMNS = ("left", "right", "x_m", "y_m", "yaw_deg", "share_with_obstacle", "geometry")
"""Those of `pairs.csv`."""
OF_A_MAP = OwnFiles(
    "map", {"map.png": None, "map.yaml": None, "pairs.csv": ",".join(_COLUMNS).encode()}, {"map.png": PICTURE_MARK}
)
"""The files of a folder with a map."""
Place = tuple[float, float, float]
"""X and y on the map, metres, and yaw, degrees."""


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "map",
        run,
        brief="a map of free and occupied space, from images of your own",
        description="Match each of several omnidirectional images with the next, as omnirange range does, make range "
        "profiles of the pairs, as omnirange scan does, and put them together on a grid: map.png and map.yaml, as "
        "ROS's map_server reads them, and pairs.csv, what each pair was worth.",
        epilog="The map's frame is that of the first view's scan: origin at its viewpoint, x where its x axis points, "
        "y to the left. Each answer counts by its standard deviation.",
    )
    add_images(command)
    command.add_argument("more", type=Path, nargs="*", default=[], metavar="IMAGE", help="images that follow")
    add_matching(command)
    add_band(command)
    command.add_argument("--cell", type=float, default=0.05, metavar="M", help="side of a cell, metres (0.05)")
    add_out(command, required=True)


def run(options: Namespace) -> int:
    """Match each image with the next, gather, and write the map."""
    import harness
    from harness.api.mapping import level_poses
    from harness.files import make_folder, write
    from harness.geometry.pose import Motion, Pose
    from harness.mapping.occupancy import Cell
    from harness.mapping.settings import OccupancyMap
    from harness.spec import parse

    band = band_of(options)
    try:
        parse(OccupancyMap, {"cell_m": options.cell})
    except InputError as error:
        raise InputError(error.problem, file="--cell") from error
    sensor, settings = sequence_settings(options)
    images = [options.left, options.right, *options.more]
    motions: Sequence[Motion | MotionEstimate] | None = motions_between(options, sensor, len(images))
    check_out_folder(options, OF_A_MAP)
    make_folder(options.out)
    motions = motions or _estimated(options, sensor, images)
    if motions is None:
        return FAILED
    tilt = dict(zip(("pitch_deg", "roll_deg"), options.tilt_deg, strict=True))
    first = Pose(position_m=(0.0, 0.0, options.height), **tilt)
    scans, places, verdicts = [], [], []
    poses = level_poses([each if isinstance(each, Motion) else each.motion for each in motions], first)
    pairs = zip(pairwise(images), motions, poses[:-1], strict=True)
    for (left, right), motion, (pose, place) in pairs:
        estimate = harness.estimate_range(left, right, sensor, motion, settings.matching, **ranging(options, settings))
        with naming_options():
            scan = harness.range_scan(
                estimate, pose.position_m[2], pitch_deg=pose.pitch_deg, roll_deg=pose.roll_deg, **band
            )
        scans.append(scan)
        places.append(place)
        verdicts.append(estimate.geometry.verdict)
        print(f"{left}, {right}: {scan.profile.known.mean():.1%} of the bearings have an obstacle", flush=True)
        for line in estimate.geometry.lines():
            print(f"  {line}", flush=True)
    grid = harness.range_map(scans, places, cell_m=options.cell)
    write(options.out / "pairs.csv", _table(images, scans, places, verdicts))  # first: the folder is known by it
    grid.write(options.out)
    if not any(each.profile.known.any() for each in scans):
        low, high = options.band
        print(
            f"the map is empty: no bearing has an obstacle between {low:g} and {high:g} m; {options.out / 'map.yaml'}"
        )
        return FAILED
    free, occupied = (int((grid.state == each).sum()) * options.cell**2 for each in (Cell.FREE, Cell.OCCUPIED))
    print(f"{free:.2f} m2 free, {occupied:.2f} m2 occupied; {options.out / 'map.yaml'}")
    warn_of(*verdicts, pairs=[f"{left}, {right}" for left, right in pairwise(images)])
    return OK


def _table(images: list[Path], scans: "list[RangeScan]", places: list[Place], verdicts: "list[Verdict]") -> str:
    """The pairs as CSV: where each was taken on the map, and whether its motion and calibration agree with it."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for (left, right), scan, place, verdict in zip(pairwise(images), scans, places, verdicts, strict=True):
        where = [f"{each:.6g}" for each in place]
        writer.writerow([left, right, *where, f"{scan.profile.known.mean():.4f}", verdict])
    return stream.getvalue()


def _estimated(options: Namespace, sensor: "Sensor", images: list[Path]) -> "list[MotionEstimate] | None":
    """The motions from the images; None, and a line on the terminal, where one is not known in metres."""
    import harness

    if options.baseline_length is None:
        raise InputError("a map needs metres; give --baseline, --pose or --baseline-length", file="--height")
    motions = []
    for left, right in pairwise(images):
        motion = harness.estimate_motion(
            left, right, sensor, sensor, baseline_m=options.baseline_length, bits=options.bits
        )
        if motion.direction_v1 is None:
            why = "; ".join(motion.reasons)
            print(f"no map: the motion from {left.name} to {right.name} is not known: {why}", file=sys.stderr)
            return None
        motions.append(motion)
    return motions
