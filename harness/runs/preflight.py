"""Checks before anything is rendered: viewpoints from which nothing is visible, and missing extras."""

import importlib.util
import warnings
from collections.abc import Sequence
from pathlib import Path

from harness.errors import InputError, Notice
from harness.pipeline.specification import Trial
from harness.pipeline.stages import scene_in_words
from harness.runs.experiment import Planned
from harness.simulation.fingerprint import fingerprint
from harness.simulation.scene_geometry import check_position, geometry_near

MODULES = {"peers": ("cv2",), "motion": ("cv2", "poselib")}
"""The modules that each extra of this package installs."""
_MOST_POSITIONS = 500
"""Most viewpoints that are checked here; the others are checked when they are rendered."""

_Position = tuple[str, tuple[float, float, float]]


def preflight(planned: Sequence[Planned], total: int, given: str | Path) -> None:
    """Refuse errors that every trial would fail with, and give notice of those that only some will.

    Parameters
    ----------
    planned
        The trials that are still to be run.
    total
        Number of all trials.
    given
        The experiment as the user gave it, for messages.

    Raises
    ------
    InputError
        When all trials would fail: the first one's message.
    """
    known: dict[_Position, InputError | None] = {}
    problems = [problem for each in planned if (problem := missing_extra(each.trial) or _unreachable(each, known))]
    if not problems:
        return
    if len(problems) == total:
        raise InputError(problems[0].problem, file=given, key=problems[0].key)
    text = f"{len(problems)} of {total} trials will fail; the first: {problems[0]}"
    warnings.warn(text, Notice, stacklevel=2)


def missing_extra(trial: Trial) -> InputError | None:
    """The error that an extra is missing which the matcher, or the estimate of the motion, needs; else None."""
    for extra, key in (
        (trial.matching.extra, "trial.matching.kind"),
        ("motion" if trial.motion.source == "estimated" else "", "trial.motion.source"),
    ):
        if not all(map(_is_installed, MODULES.get(extra, ()))):
            return InputError(f"needs the extra: pip install 'omnirange[{extra}]'", key=key)
    return None


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # raised by a parent package that is imported to find the module
        return False


def _unreachable(planned: Planned, known: dict[_Position, InputError | None]) -> InputError | None:
    """The error that a viewpoint is outside the scene, or inside an object of it; None if it is neither."""
    trial, scene = planned.trial, planned.trial.scene
    name = fingerprint(scene)
    viewpoints = [*zip(trial.poses, ("trial.view_1.position_m", "trial.view_2"), strict=True)]
    new = trial.novel_views.poses(trial.poses[0])
    viewpoints += [(pose, f"trial.novel_views.distances_m[{number}]") for number, pose in enumerate(new)]
    for pose, key in viewpoints:
        where = (name, pose.position_m)
        if where not in known and len(known) < _MOST_POSITIONS:
            of_scene = scene_in_words(scene, planned.scene_file)
            known[where] = None
            at = "trial.scene"
            try:
                geometry = geometry_near(scene, pose.position_m)
                at = key
                check_position(geometry, pose.position_m - geometry.centre)
            except InputError as error:
                known[where] = InputError(f"{of_scene}: {error.problem}", key=at)
        if problem := known.get(where):
            return problem
    return None
