"""`omnirange range`: estimate range from two photographs of your own."""

import math
import sys
import warnings
from argparse import Namespace
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness.cli import completers
from harness.cli.command_line import Parser
from harness.cli.exits import FAILED, OK
from harness.cli.masks import masked, without_body
from harness.cli.motion_options import add_length, check_length, naming_options
from harness.cli.options import Commands, add_images, add_out
from harness.cli.out_folder import check_out_folder
from harness.cli.sensor_options import add_sensor, first_sensor, second_sensor
from harness.display import counted, listed

if TYPE_CHECKING:
    from harness.api.motion import MotionEstimate
    from harness.api.ranging import RangeEstimate
    from harness.api.sequence import PairRange
    from harness.camera.sensor import Sensor
    from harness.geometry.pose import Motion
    from harness.pipeline.geometry_check import Verdict
    from harness.runs.photograph_settings import OwnSettings

_LARGE_MP = 3.0
"""Megapixels of an image from which its cost is said before it is matched."""
_SPARING_MP = 2.0
"""Megapixels from which memory that is free goes back to the system at once, not before:
to be handed it again takes time."""
_SECONDS_A_MP = 5.0
"""CPU time of slanted windows and semi-global matching for a megapixel, on the panorama that suits the sensor, within a
factor of two."""
_LEAST_GIGABYTES, _GIGABYTES, _GIGABYTES_A_MP = 1.1, 0.45, 0.15
"""Their memory, at least, and before the first megapixel and for each: 1.11, 1.17 and 2.23 GB at 2.1, 4.9 and 12."""
_SAVING = "--scale 0.5 --set panorama.width_px=1080"


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "range",
        run,
        brief="estimate range from two images of your own",
        description="Match two omnidirectional images and write the range of every pixel of the first view's "
        "panorama, its predicted standard deviation, a coloured point cloud and a page. No ground truth is needed. "
        "Without --pose and --baseline the motion is estimated from the images, as by omnirange motion.",
        epilog="Frames are the sensor's, z up along the mirror's axis. If nothing of it is set, the panorama has the "
        "rows that both sensors see, in square pixels of nearly their resolution; where d_min_m and d_max_m are not "
        "set, the range searched follows from keypoints that match (extra motion).",
    )
    add_images(command)
    command.add_argument(
        "more",
        type=Path,
        nargs="*",
        default=[],
        metavar="IMAGE",
        help="images that follow: each is matched with the next",
    )
    add_matching(command)
    add_out(command, required=True)


def add_matching(command: Parser) -> None:
    """Declare how two images are matched: sensors, masks, motion, matcher."""
    add_sensor(command, "sensor TOML or calibration file", required=True, second=True)
    command.add_argument(
        "--mask",
        type=Path,
        metavar="FILE",
        help="8-bit grey image, white where pixels of both images are used, instead of the sensor's own mask; of the "
        "left image alone if view 2 has a sensor or a mask of its own. auto: what moves with the camera, such as "
        "the robot itself, is left out, and mask.png is written",
    )
    command.add_argument("--mask-2", type=Path, metavar="FILE", help="the same for the right image")
    _add_motion(command)
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
    command.add_argument(
        "--scale",
        type=float,
        default=1.0,
        metavar="S",
        help="match images made smaller, by 0.5 or one over another whole number, on the same panorama (1)",
    )


def _add_motion(command: Parser) -> None:
    """Declare the options for the motion to view 2."""
    where = command.add_mutually_exclusive_group()
    pose = where.add_argument(
        "--pose",
        type=Path,
        action="append",
        metavar="FILE",
        help="where view 2 is: its pose in view 1's frame, TOML as omnirange motion writes it; a rig's calibration, "
        "such as a Kalibr camchain; or a trajectory in TUM's or KITTI's format. Repeated, the pose of each view in one "
        "frame, as omnirange render writes it",
    )
    completers.offer(pose, completers.files())
    where.add_argument(
        "--baseline",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="viewpoint 2 seen from viewpoint 1, in view 1's frame, metres",
    )
    add_length(command, before="without --pose and --baseline: ")
    command.add_argument(
        "--rotation-deg",
        type=float,
        nargs=3,
        metavar=("YAW", "PITCH", "ROLL"),
        help="with --baseline: rotation of view 2 relative to view 1, about z, then y, then x (0 0 0)",
    )
    command.add_argument(
        "--views",
        type=int,
        nargs=2,
        metavar=("I", "J"),
        help="with --pose: which cameras of the rig, or poses of the trajectory, took the images, from 0 (0 1)",
    )
    command.add_argument(
        "--frame",
        choices=("sensor", "lens"),
        help="with --pose and a trajectory: whether it moves the sensor's frame, z up, or the lens's, Z along its axis",
    )


def run(options: Namespace) -> int:
    """Match, and write the folder."""
    from harness.pipeline.photographs import OF_A_RANGE

    if options.more:
        return _sequence(options)
    check_out_folder(options, OF_A_RANGE)
    estimate = estimate_of(options)
    if estimate is None:
        return FAILED
    estimate.write(options.out)
    tell_matching(estimate)
    unit = "" if estimate.has_metres else ", in units of the baseline"
    print(f"{estimate.valid.mean():.1%} of the panorama has a range{unit}; {options.out / 'range.html'}")
    return OK if estimate.valid.any() else FAILED


def _settings(options: Namespace) -> "tuple[tuple[Sensor, Sensor], OwnSettings]":
    """The sensors with their masks, and the settings of matcher and panorama; prints the cost of large images."""
    from harness.runs.photograph_settings import own_settings

    if options.pose is not None or options.baseline is not None:  # else the estimate says that nothing moves
        _check_images([options.left, options.right, *getattr(options, "more", ())])
    sensor = first_sensor(options, central=True)
    assert sensor is not None
    sensor = masked(sensor, None if options.mask == Path("auto") else options.mask, "--mask")
    sensor_2 = masked(second_sensor(options) or sensor, options.mask_2, "--mask-2")
    settings = own_settings(options.matcher, options.set)
    _check_scale(options, (sensor, sensor_2))
    _tell_size(options, sensor, settings)
    return (sensor, sensor_2), settings


def _check_images(images: list[Path]) -> None:
    """Refuse the same image for two views in a row."""
    from harness.errors import InputError

    for one, other in pairwise(images):
        if one.exists() and other.exists() and one.samefile(other):
            raise InputError("is given for two views in a row; give the image of each", file=other)


def estimate_of(options: Namespace) -> "RangeEstimate | None":
    """The ranges of two images; None, and a line on the terminal, where the motion is not known."""
    import harness
    from harness.errors import InputError

    sensors, settings = _settings(options)
    motion: Motion | MotionEstimate
    if options.pose is None and options.baseline is None:
        motion = _estimated(options, sensors)
        if motion.direction_v1 is None:
            print(f"no range: the motion is not known ({motion.status}): {'; '.join(motion.reasons)}", file=sys.stderr)
            return None
        for line in motion.lines():
            print(line)
    else:
        motion = _given_motion(options, sensors)
        if not motion.baseline_m > 0 and options.pose is None:
            raise InputError("must not be zero: two views from one point determine no range", file="--baseline")
        _check_apart(options, [motion])
    if options.mask == Path("auto"):
        sensor = without_body(options, sensors, motion, settings)
        sensors = sensor, sensor
    return harness.estimate_range(
        options.left,
        options.right,
        sensors[0],
        motion,
        settings.matching,
        sensor_2=sensors[1],
        **ranging(options, settings),
    )


def tell_matching(estimate: "RangeEstimate") -> None:
    """Print how the images were matched, and whether motion and calibration agree with them."""
    grid = estimate.pair.grid
    low, high = (math.degrees(math.atan(z)) for z in (grid.z_min, grid.z_max))
    print(f"panorama: {grid.width_px} x {grid.height_px} pixels, elevation {low:.1f} to {high:.1f} deg")
    if estimate.search:
        print(estimate.search)
    for photograph in estimate.photographs:
        print(f"{photograph.file}: {photograph.scale}")
    if estimate.matches.remark:
        print(estimate.matches.remark)
    for line in estimate.lines():
        print(line)


def warn_of(*verdicts: "Verdict", pairs: Sequence[str] = ()) -> None:
    """Say last of all that what was made of these geometries is not to be trusted, where that is so.

    Parameters
    ----------
    pairs
        The names of the pairs, if there are several.
    """
    from harness.errors import Notice
    from harness.pipeline.geometry_check import Verdict

    bad = [each for each in verdicts if each in (Verdict.WRONG, Verdict.UNKNOWN)]
    if bad:
        of, which = "", ""
        if len(verdicts) > 1:
            of = f" of {counted(len(bad), 'pair')} of {len(verdicts)}"
            which = f" ({'; '.join(pair for pair, each in zip(pairs, verdicts, strict=True) if each in bad)})"
        kinds = listed(dict.fromkeys(map(str, bad)))
        warnings.warn(f"the geometry{of} is {kinds}{which}: do not trust it", Notice, stacklevel=1)


def ranging(options: Namespace, settings: "OwnSettings") -> dict[str, Any]:
    """The arguments of `estimate_range` for panorama, limits and images."""
    own_panorama = "panorama" in settings.model_fields_set
    return {
        "grid": settings.panorama if own_panorama else "auto",
        "bits": options.bits,
        "scale": options.scale,
        "fit_limits": True,
    }


def _check_scale(options: Namespace, sensors: "tuple[Sensor, Sensor]") -> None:
    """Refuse an invalid scale before any computation."""
    from harness.api.photographs import side_of
    from harness.errors import InputError

    try:
        side_of(options.scale, sensors)
    except InputError as error:
        raise InputError(error.problem, file="--scale") from error


def _tell_size(options: Namespace, sensor: "Sensor", settings: "OwnSettings") -> None:
    """Print the expected time and memory of large images before they are matched."""
    from harness.machine import give_back_memory

    megapixels = sensor.camera.width_px * sensor.camera.height_px / 1e6
    if megapixels >= _SPARING_MP:
        give_back_memory()
    if options.scale == 1 and megapixels >= _LARGE_MP and settings.matching.kind in ("slanted", "sgm"):
        seconds = _SECONDS_A_MP * megapixels
        gigabytes = max(_LEAST_GIGABYTES, _GIGABYTES + _GIGABYTES_A_MP * megapixels)
        print(
            f"{megapixels:.1f} megapixels: about {seconds:.0f} s of CPU time and {gigabytes:.1f} GB of memory; "
            f"{_SAVING} takes two fifths of the time",
            flush=True,
        )


def sequence_settings(options: Namespace) -> "tuple[Sensor, OwnSettings]":
    """The sensor of a sequence with its mask, and the settings of matcher and panorama."""
    from harness.errors import InputError

    (sensor, _), settings = _settings(options)
    if options.mask == Path("auto"):
        raise InputError("is for two images; write the mask of a pair, and give that", file="--mask auto")
    for option in ("sensor_2", "mask_2", "views", "camera_height"):
        if getattr(options, option) is not None:
            name = f"--{option.replace('_', '-')}"
            raise InputError("is for two images; a sequence has one sensor, and a pose for each image", file=name)
    return sensor, settings


def motions_between(options: Namespace, sensor: "Sensor", count: int) -> "list[Motion] | None":
    """The motions between successive ones of so many images, as they were given; None where they are estimated."""
    if options.pose is not None and (count > 2 or len(options.pose) > 1):
        return _along(options, sensor, count)
    if options.pose is not None or options.baseline is not None:
        return [_given_motion(options, (sensor, sensor))] * (count - 1)
    _check_estimated(options)
    return None


def _sequence(options: Namespace) -> int:
    """Match each image with the next, and write a folder for each pair and a page on all."""
    import harness
    from harness.api.sequence import OF_A_SEQUENCE, folders_of_others

    check_out_folder(options, OF_A_SEQUENCE)
    sensor, settings = sequence_settings(options)
    images = [options.left, options.right, *options.more]
    motions = motions_between(options, sensor, len(images))

    def tell(pair: "PairRange") -> None:
        why = f": {'; '.join(pair.reasons)}" if pair.reasons else ""
        judged = f", geometry {pair.verdict}" if pair.verdict else ""
        print(
            f"{pair.left}, {pair.right}: {pair.density:.1%} with a range, motion {pair.status}{judged}{why}", flush=True
        )

    sequence = harness.estimate_sequence(
        images,
        sensor,
        options.out,
        motions,
        settings.matching,
        baseline_m=options.baseline_length,
        **ranging(options, settings),
        tell=tell,
    )
    print(f"page: {options.out / 'range.html'}")
    if others := folders_of_others(sequence):
        print(f"still in {options.out} of another sequence: {listed(others)}")
    return OK if any(each.density for each in sequence.pairs) else FAILED


def _along(options: Namespace, sensor: "Sensor", count: int) -> "list[Motion]":
    """The motions between successive poses of a trajectory, or of files of poses, one pose for each image."""
    from harness.camera.sensor import lens_from_sensor
    from harness.errors import InputError
    from harness.io.motions import motions_of_poses, read_motions

    _check_given(options)
    file = options.pose[0]
    if len(options.pose) > 1:
        motions = motions_of_poses(options.pose, count)
    else:
        try:
            motions = read_motions(file, lens_from_sensor(sensor), options.frame)
        except InputError as error:
            key = "--frame" if error.key == "frame" else error.key
            raise InputError(error.problem, file=error.file, key=key) from error
        if len(motions) != count - 1:
            raise InputError(f"has {len(motions) + 1} poses; there are {count} images", file=file)
    _check_apart(options, motions)
    return motions


def _check_apart(options: Namespace, motions: "Sequence[Motion]") -> None:
    """Refuse motions of `--pose` that leave a view where it was."""
    from harness.errors import InputError

    poses: Sequence[Path] = options.pose or ()
    standing = next((i for i, each in enumerate(motions) if not each.baseline_m > 0), None)
    if standing is None:
        return
    which = "both views" if len(motions) == 1 else f"views {standing} and {standing + 1}"
    problem = f"{which} are in one place, which determines no range"
    if len(poses) > len(motions) and poses[standing] == poses[standing + 1]:
        problem = f"{poses[standing]} is given for {which}; give the pose of each"
    raise InputError(problem, file="--pose" if len(poses) > 1 else poses[0])


def _estimated(options: Namespace, sensors: "tuple[Sensor, Sensor]") -> "MotionEstimate":
    """The motion from view 1 to view 2, from the images."""
    import harness

    _check_estimated(options)
    with naming_options():
        return harness.estimate_motion(
            options.left,
            options.right,
            *sensors,
            baseline_m=options.baseline_length,
            camera_height_m=options.camera_height,
            bits=options.bits,
        )


def _given_motion(options: Namespace, sensors: "tuple[Sensor, Sensor]") -> "Motion":
    """The motion from view 1 to view 2, as it was given."""
    import harness
    from harness.camera.sensor import lens_from_sensor
    from harness.errors import InputError
    from harness.io.motions import motions_of_poses, read_motion
    from harness.spec import parse

    _check_given(options)
    if options.pose is not None:
        if len(options.pose) > 1:
            return motions_of_poses(options.pose, 2)[0]
        lenses = lens_from_sensor(sensors[0]), lens_from_sensor(sensors[1])
        views = None if options.views is None else (options.views[0], options.views[1])
        try:
            return read_motion(options.pose[0], lenses, views, options.frame)
        except InputError as error:
            key = {"views": "--views", "frame": "--frame"}.get(error.key or "", error.key)
            raise InputError(error.problem, file=error.file, key=key) from error
    yaw, pitch, roll = options.rotation_deg or (0.0, 0.0, 0.0)
    table = {"position_m": options.baseline, "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}
    try:
        return harness.relative_motion(harness.Pose(), parse(harness.Pose, table))
    except InputError as error:
        option = "--rotation-deg" if (error.key or "").endswith("_deg") else "--baseline"
        raise InputError(error.problem, file=option) from error


def _check_estimated(options: Namespace) -> None:
    """Refuse options that belong to a motion that is given."""
    from harness.errors import InputError

    for option in ("rotation_deg", "views", "frame"):
        if getattr(options, option) is not None:
            problem = "belongs to --baseline or --pose, and neither is given"
            raise InputError(problem, file=f"--{option.replace('_', '-')}")
    check_length(options)


def _check_given(options: Namespace) -> None:
    """Refuse options that contradict a motion that is given, or choose from what is not."""
    from harness.errors import InputError

    used = "--baseline" if options.pose is None else "--pose"
    for option in ("baseline_length", "camera_height"):
        if getattr(options, option) is not None:
            problem = f"{used} says where view 2 is; leave one of them out"
            raise InputError(problem, file=f"--{option.replace('_', '-')}")
    if options.pose is not None and options.rotation_deg is not None:
        raise InputError("the rotation is in the file of --pose; leave one of them out", file="--rotation-deg")
    for option in ("views", "frame"):
        if getattr(options, option) is None:
            continue
        if options.pose is None:
            raise InputError("belongs to --pose, which is not given", file=f"--{option}")
        if len(options.pose) > 1:
            raise InputError("is for one file of several poses; here each --pose is one", file=f"--{option}")
