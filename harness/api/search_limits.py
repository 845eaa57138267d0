"""The limits of the search, estimated from the images where they are not given."""

import numpy as np
from numpy.typing import NDArray

from harness.api.motion import MotionEstimate
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.pose import Motion
from harness.matching.interface import MatcherSettings
from harness.motion.estimate import scene_points
from harness.motion.search_limits import LEAST_PAIRS, LEAST_SHARE, limits_of, points_along

Image = NDArray[np.float32]


def are_given(settings: MatcherSettings) -> bool:
    """Whether both limits were given."""
    return {"d_min_m", "d_max_m"} <= settings.model_fields_set


def in_baselines(settings: MatcherSettings, motion: MotionEstimate, sensor: Sensor) -> tuple[MatcherSettings, str]:
    """Settings whose limits of the search are those of the scene, in baselines, where they were not given: the defaults
    are metres; and a line that says so, empty where both were given.

    Raises
    ------
    InputError
        When one limit was given, and the other one does not fit.
    """
    w = scene_points(motion, sensor)[1]
    changed = _with(settings, *limits_of(w))
    if not changed.d_min_m < changed.d_max_m:
        raise InputError(
            f"d_min_m = {changed.d_min_m:g} and d_max_m = {changed.d_max_m:g} are in units of the baseline, which is "
            "not known; give both, or its length",
            key="matcher",
        )
    if are_given(settings):
        return changed, ""
    return (
        changed,
        f"search: {changed.d_min_m:.3g} to {changed.d_max_m:.3g} baselines, from {len(w)} points of the scene",
    )


def in_metres(
    settings: MatcherSettings,
    images: tuple[Image, Image],
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    estimated: MotionEstimate | None,
) -> tuple[MatcherSettings, str]:
    """Settings whose limits of the search are those of the scene, where they were not given, and a line that says so.

    Parameters
    ----------
    motion
        From view 1 to view 2, metres.
    estimated
        The motion as estimated from the images, with the points of the scene; None if it was given.
    """
    if are_given(settings):
        return settings, ""
    if estimated is not None:
        w = scene_points(estimated, sensors[0])[1]
        count = len(w)
    else:
        try:
            w, count = points_along(images, sensors, motion)
        except InputError:
            return settings, _default(settings, "the scene's own need pip install 'omnirange[motion]'")
    if len(w) < max(LEAST_PAIRS, LEAST_SHARE * count):
        return settings, _default(settings, f"{len(w)} of {count} matched keypoints agree with the motion, too few")
    near, far = (limit * motion.baseline_m for limit in limits_of(w, wide=True))
    changed = _with(settings, near, far)
    if not changed.d_min_m < changed.d_max_m:
        return settings, _default(settings, f"the scene's own, {near:.3g} to {far:.3g} m, do not fit the one given")
    return changed, f"search: {changed.d_min_m:.3g} to {changed.d_max_m:.3g} m, from {len(w)} points of the scene"


def _with(settings: MatcherSettings, near: float, far: float) -> MatcherSettings:
    limits = {"d_min_m": near, "d_max_m": far}
    given = settings.model_fields_set
    return settings.model_copy(update={name: value for name, value in limits.items() if name not in given})


def _default(settings: MatcherSettings, why: str) -> str:
    return f"search: {settings.d_min_m:g} to {settings.d_max_m:g} m, the default; {why}"
