"""Trials with hardly any estimates: how many there are, and which keys are likely to help."""

from collections import Counter
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

from harness.matching.interface import Reason
from harness.pipeline.sight import LITTLE
from harness.pipeline.specification import Trial

_BY_ALPHA = '("alpha", with kind = "window")'

_CAUSES = (
    (
        (Reason.WINDOW_LEAVES_IMAGE, Reason.CURVE_LEAVES_IMAGE),
        "windows leave the visible part of the panorama",
        {
            "matching.window_px": "(smaller)",
            "panorama.z_min": "",
            "panorama.z_max": "(within the sensor's field)",
            "panorama.height_px": "(more rows)",
        },
    ),
    (
        (Reason.NO_EPIPOLAR_PLANE,),
        "phi cannot follow the epipolar curves, as along a nearly vertical baseline",
        {"matching.sampling": _BY_ALPHA, "view_2.elevation_deg": ""},
    ),
    (
        (Reason.NO_SAMPLE, Reason.BEYOND_INFINITY),
        "the ranges searched hold no sample of the curve, or matches lie beyond infinity",
        {
            "matching.sampling": _BY_ALPHA,
            "matching.pitch_px": "(smaller)",
            "matching.d_min_m": "",
            "matching.d_max_m": "(a wider interval)",
            "view_2.baseline_m": "(longer)",
        },
    ),
    (
        (Reason.NO_MATCH, Reason.INCONSISTENT, Reason.OCCLUDED, Reason.MATCHED),
        "the matcher rejected its matches as uncertain",
        {"matching.d_min_m": "", "matching.d_max_m": "(the scene's ranges)", "noise.sigma_grey": "", "exposure_2": ""},
    ),
)
"""Reasons of one cause, the cause, and the keys of a trial that help, each with how."""


def too_sparse(trials: Iterable[tuple[Trial, Mapping[str, Any]]]) -> str:
    """One line on the trials with a density below 5 %, and the keys most likely to help; empty without such trials.

    Parameters
    ----------
    trials
        Each with what `pipeline.row.row_of` made of it. Keys that the first sparse one's matcher lacks are not named.
    """
    total, sparse = 0, []
    reasons: Counter[str] = Counter()
    for trial, payload in trials:
        total += 1
        density = payload["figures"]["density"]
        if density is None or density < LITTLE:
            sparse.append(trial)
            reasons.update(payload["reasons"])
    if not sparse:
        return ""
    have = "has" if len(sparse) == 1 else "have"
    sentence = (
        f"{len(sparse)} of {total} trials {have} a range for less than {LITTLE:.0%} of the pixels that both views see"
    )
    if not reasons.total():
        return f"{sentence}: there are hardly any such pixels; see trial.view_1, trial.view_2 and trial.sensor.field"
    _, cause, keys = max(_CAUSES, key=lambda each: sum(reasons[reason.name] for reason in each[0]))
    named = [f"trial.{key} {how}".rstrip() for key, how in keys.items() if _can_help(sparse[0], key)]
    return f"{sentence}, mostly because {cause}; see {', '.join(named)}"


def _can_help(trial: Trial, key: str) -> bool:
    """Whether a trial has the key, and not yet the value that is proposed."""
    try:
        return attrgetter(key)(trial) != "alpha"
    except AttributeError:
        return False
