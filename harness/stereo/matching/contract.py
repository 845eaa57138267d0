"""What every matcher takes and gives: its limits, and the matches or the reasons why there are none."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from harness.camera.angles import Array
from harness.errors import InputError
from harness.spec import Positive, Spec
from harness.stereo.panorama import Grid


class Limits(Spec):
    """What is common to the settings of all matchers: the ranges from viewpoint 1 that are searched.

    - `d_min_m` 1: the floor is nearest at the bottom row, 1.22 m away under a sensor 1 m high.
    - `d_max_m` 10: more than twice the farthest point of the paper's box (4.5 m), so that the limit hides no error,
      yet finite, so that every matched pixel has a range.
    """

    d_min_m: Positive = 1.0
    d_max_m: Annotated[float, Field(gt=0)] = 10.0

    @model_validator(mode="after")
    def _in_order(self) -> "Limits":
        if not self.d_min_m < self.d_max_m:
            raise ValueError(f"d_min_m = {self.d_min_m:g} must be below d_max_m = {self.d_max_m:g}")
        return self


class Reason(IntEnum):
    """Why a pixel has no match (0: it has one)."""

    MATCHED = 0
    CURVE_LEAVES_IMAGE = 1
    """A sample of the curve, or its extremum, has no whole window in the second panorama."""
    WINDOW_LEAVES_IMAGE = 2
    """The pixel's own window is not whole in the first panorama."""
    NO_EPIPOLAR_PLANE = 3
    """The pixel looks along t, or n_z vanishes and phi cannot follow the curve."""
    NO_SAMPLE = 4
    """The search interval falls between two samples of the curve."""
    BEYOND_INFINITY = 5
    """There is a match, but its rays are parallel or diverge: no range."""
    NO_MATCH = 6
    """The matcher found none, or was not sure of it."""
    INCONSISTENT = 7
    """The match from view 2 back to view 1 leads elsewhere: most likely a point that view 2 does not see."""


@dataclass(frozen=True)
class Matches:
    """What a matcher found, on view 1's panorama; every array `[height, width]`.

    Only `alpha_2` is asked for. What else a matcher knows makes more of the report.
    """

    alpha_2: Array
    """Radians: the angle in the epipolar plane between t and the direction from viewpoint 2 to the point, in v1's
    orientation. NaN where there is no match."""
    confidence: Array | None = None
    """The larger, the surer; in any unit, as only the order counts. NaN where there is no match."""
    sigma_alpha_2: Array | None = None
    """Predicted standard deviation of `alpha_2`, radians. NaN where there is no match."""
    reason: NDArray[np.uint8] | None = None
    """`Reason`: why there is no match."""
    refined: NDArray[np.bool_] | None = None
    """Moved off the whole sample by a sub-pixel step; None for a matcher that has no samples."""
    k: Array | None = None
    """Position on the curve in samples, NaN where there is no match; None for a matcher that has no samples."""

    @property
    def reasons(self) -> NDArray[np.uint8]:
        """`reason`; `Reason.NO_MATCH` for every NaN of a matcher that gives no reasons."""
        if self.reason is not None:
            return self.reason
        return np.where(np.isnan(self.alpha_2), np.uint8(Reason.NO_MATCH), np.uint8(Reason.MATCHED))


def as_matches(answer: Any, grid: Grid, name: str) -> Matches:
    """What somebody's matcher returned, checked.

    Parameters
    ----------
    answer
        `Matches`, an array `alpha_2`, or a pair of arrays `(alpha_2, confidence)`.
    name
        What to call the matcher in a message.

    Raises
    ------
    InputError
        When it is none of these, an array has another shape than the panorama or is not of real numbers, an angle is
        infinite or outside 0 .. pi, a standard deviation is not positive, or there is a confidence without a match.
    """
    if isinstance(answer, tuple) and len(answer) == 2:
        answer = Matches(*answer)
    elif isinstance(answer, np.ndarray):
        answer = Matches(answer)
    if not isinstance(answer, Matches):
        raise InputError(
            "must return alpha_2 as an array, a pair (alpha_2, confidence) or Matches; "
            f"it returned {type(answer).__name__}",
            file=name,
        )
    checked = {
        field: None if value is None else _real(value, grid, f"{name}: {field}")
        for field, value in (
            ("alpha_2", answer.alpha_2),
            ("confidence", answer.confidence),
            ("sigma_alpha_2", answer.sigma_alpha_2),
            ("k", answer.k),
        )
    }
    alpha_2 = checked["alpha_2"]
    if alpha_2 is None:
        raise InputError("alpha_2 is missing", file=name)
    matched = ~np.isnan(alpha_2)
    outside = matched & ~((alpha_2 >= 0) & (alpha_2 <= np.pi))
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise InputError(
            f"alpha_2 must lie within 0 .. pi radians, or be NaN for no match; it is {alpha_2[row, column]:g} at "
            f"[{row}, {column}] and outside at {int(outside.sum())} pixels",
            file=name,
        )
    confidence, sigma = checked["confidence"], checked["sigma_alpha_2"]
    if confidence is not None:
        unsaid = matched & np.isnan(confidence)
        if unsaid.any():
            row, column = np.argwhere(unsaid)[0]
            raise InputError(f"confidence is NaN at [{row}, {column}], where there is a match", file=name)
        confidence = np.where(matched, confidence, np.nan)
    if sigma is not None:
        wrong = matched & ~(sigma > 0)
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise InputError(
                f"sigma_alpha_2 must be above zero where there is a match; it is {sigma[row, column]:g} at "
                f"[{row}, {column}]",
                file=name,
            )
        sigma = np.where(matched, sigma, np.nan)
    reason = _reasons(answer.reason, matched, grid, name)
    refined = None if answer.refined is None else np.asarray(answer.refined, dtype=bool) & matched
    return Matches(alpha_2, confidence, sigma, reason, refined, checked["k"])


def _real(value: Any, grid: Grid, name: str) -> Array:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise InputError(f"must be an array of real numbers; its dtype is {array.dtype}", file=name)
    if array.shape != grid.shape:
        raise InputError(f"must have the panorama's shape {grid.shape}; it has {array.shape}", file=name)
    return np.asarray(array, dtype=np.float64)


def _reasons(given: Any, matched: NDArray[np.bool_], grid: Grid, name: str) -> NDArray[np.uint8]:
    if given is None:
        return np.where(matched, np.uint8(Reason.MATCHED), np.uint8(Reason.NO_MATCH))
    reason = np.asarray(given)
    if reason.shape != grid.shape or not np.isin(reason, [each.value for each in Reason]).all():
        raise InputError(f"reason must be an array {grid.shape} of Reason's numbers, 0 .. {max(Reason)}", file=name)
    if not np.array_equal(reason == Reason.MATCHED, matched):
        raise InputError("reason must be 0 (matched) exactly where alpha_2 is not NaN", file=name)
    return reason.astype(np.uint8)
