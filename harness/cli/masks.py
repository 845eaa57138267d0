"""Masks in the options of a command on images."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.errors import InputError

if TYPE_CHECKING:
    from harness.api.motion import MotionEstimate
    from harness.camera.sensor import Sensor
    from harness.geometry.pose import Motion
    from harness.runs.photograph_settings import OwnSettings


def without_body(
    options: Namespace,
    sensors: "tuple[Sensor, Sensor]",
    motion: "Motion | MotionEstimate",
    settings: "OwnSettings",
) -> "Sensor":
    """The sensor with a mask of what moves with it, which is written into the folder."""
    from harness.api.masks import find_mask, write_mask
    from harness.files import make_folder
    from harness.geometry.pose import Motion

    if sensors[0] != sensors[1]:
        raise InputError(
            "takes one sensor for both images; give a mask of each with --mask and --mask-2", file="--mask"
        )
    limits = {"d_min_m": settings.matching.d_min_m, "d_max_m": settings.matching.d_max_m}
    if not isinstance(motion, Motion):
        if motion.baseline_m is None:
            limits = {"d_min_m": 1.0, "d_max_m": 20.0}  # baselines
        motion = motion.motion
    mask = find_mask(options.left, options.right, sensors[0], motion, bits=options.bits, **limits)
    make_folder(options.out)
    write_mask(mask, options.out / "mask.png")
    print(f"{1 - mask.mean():.1%} of the image is masked; {options.out / 'mask.png'}")
    return sensors[0].with_mask(options.out / "mask.png")


def masked(sensor: "Sensor", mask: Path | None, option: str) -> "Sensor":
    """The sensor with the mask of an option, or unchanged."""
    if mask is None:
        return sensor
    try:
        return sensor.with_mask(mask)
    except InputError as error:
        raise InputError(error.problem, file=option) from error
