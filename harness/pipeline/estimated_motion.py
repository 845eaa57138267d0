"""The motion that a matcher is given where it is estimated from the trial's own images, with the true baseline."""

from dataclasses import dataclass

import numpy as np

from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.motion_error import MotionError
from harness.geometry.pose import Motion
from harness.motion.estimate import Image, estimate


@dataclass(frozen=True, repr=False)
class MotionOfImages(OneLine):
    """A motion from two images."""

    motion: Motion
    """The motion, with the true |t|, which images do not determine."""
    error: MotionError
    """The estimate's own uncertainty."""
    status: str
    reasons: tuple[str, ...]
    """The reasons why its status is not `ok`, in words."""


def motion_of_images(
    images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], baseline_m: float, key: str
) -> MotionOfImages:
    """Estimate a trial's motion.

    Parameters
    ----------
    key
        The setting that asks for it, for messages.

    Raises
    ------
    InputError
        When the images do not tell it, or the extra `motion` is not installed.
    """
    try:
        result = estimate(images, sensors)
    except InputError as error:
        raise InputError(error.problem, key=key) from error
    if result.R_v2_from_v1 is None or result.direction_v1 is None or result.covariance is None:
        raise InputError(
            f"the images do not determine the motion ({result.status}): {'; '.join(result.reasons)}", key=key
        )
    return MotionOfImages(
        Motion(result.R_v2_from_v1, baseline_m * result.direction_v1),
        MotionError(result.covariance, np.zeros(6)),
        str(result.status),
        result.reasons,
    )
