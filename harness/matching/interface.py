"""The interface of matchers: settings that can be run on a pair; matches, or reasons for missing ones."""

import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, field_validator, model_validator

from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, Sampling, epipolar_curves
from harness.geometry.panorama import Grid
from harness.matching.answers import Answer, converted, outside
from harness.spec import Positive, Spec, as_table, checked_plain

if TYPE_CHECKING:
    from harness.matching.pair import Pair


@dataclass(frozen=True)
class Support:
    """The pixels that a match is made from, for the bound on its accuracy."""

    window_px: int
    """Side of a square around the pixel, odd."""
    model: Literal["slanted", "frontal"]
    """The model that is fitted in the window: see `evaluation.bound`."""
    frame: Literal["panorama", "mirror"] = "panorama"
    """The image whose pixels make up the square."""


class MatcherSettings(Spec, ABC):
    """Base class of matchers: the settings of one, and its methods.

    A matcher is a subclass with a `kind` of its own and a `match`. Whatever else the program needs to know about it is
    a method or a property here, with a default that suits most.
    """

    briefs: ClassVar[Mapping[str, str]] = {}
    """The matcher's line in `omnirange list`, for each of its kinds."""

    kind: str = ""
    """The kind of matcher."""

    d_min_m: Positive = 1.0
    """Shortest range searched, metres from viewpoint 1. The floor is nearest at the bottom row, 1.22 m away under a
    sensor 1 m high."""
    d_max_m: Annotated[float, Field(gt=0)] = 10.0
    """Longest range searched, metres from viewpoint 1. 10 is more than twice the farthest point of the paper's box
    (4.5 m), so that the limit hides no error, yet finite, so that every matched pixel has a range."""

    @model_validator(mode="after")
    def _in_order(self) -> "MatcherSettings":
        if not self.d_min_m < self.d_max_m:
            raise ValueError(f"d_min_m = {self.d_min_m:g} must be below d_max_m = {self.d_max_m:g}")
        return self

    @abstractmethod
    def match(self, pair: "Pair") -> "Matches":
        """The matches of a pair.

        Raises
        ------
        InputError
            When a third-party matcher cannot be found, does not take its parameters, fails, or returns something
            invalid; or when settings and pair do not fit each other.
        """

    def answer(self, pair: "Pair") -> Any:
        """The matcher's own return value, unchecked; errors as in `match`."""
        return self.match(pair)

    def check(self) -> None:
        """Check what can be checked before a run: that the matcher exists, and takes its parameters.

        Raises
        ------
        InputError
            `error.key` is the key in the matcher's table.
        """

    def identity(self) -> str:
        """A hash of the files on which the results depend beside the settings; empty for a matcher of this program.

        Raises
        ------
        InputError
            When a file cannot be read, or there is no such module.
        """
        return ""

    @property
    def extra(self) -> str:
        """The extra of this package that the matcher needs; empty for none."""
        return ""

    @property
    def runs_third_party_code(self) -> bool:
        """Whether matching runs code that is not part of this program."""
        return False

    @property
    def step(self) -> str:
        """The sub-pixel step, by its name; `own` for a matcher that has no choice of them."""
        return "own"

    @property
    def command_words(self) -> tuple[str, ...]:
        """The command of a program, which distinguishes it from other programs; empty for any other matcher."""
        return ()

    @property
    def whole_samples(self) -> bool:
        """Whether matches are whole samples, so that rounding is part of their error."""
        return self.step == "none"

    @property
    def window(self) -> int:
        """Side of the square whose residuals give a match's uncertainty, panorama pixels; see `uncertainty`."""
        return 11

    def match_seconds(self, image_mp: float, curve_mp: float) -> float | None:  # noqa: ARG002 - for matchers whose time depends on the images
        """About how long a match takes on one thread, seconds, within a factor of two; None where that is not known.

        Parameters
        ----------
        image_mp
            Megapixels of one image.
        curve_mp
            Megapixels of the panorama, times the samples of a curve in units of half a degree.
        """
        return 0.6 * curve_mp

    @property
    def search(self) -> Spec:
        """The settings that the costly part of matching depends on: trials with equal ones can share it."""
        return self

    def sampled(self, t_v1: Array) -> tuple[Sampling, float]:
        """The sampling of the epipolar curves, and the distance of samples in columns.

        A matcher that has no samples is compared with whole columns, or with whole steps of alpha_2 where t is so
        steep that phi hardly follows the curves.
        """
        x, y, z = t_v1
        return "alpha" if abs(z) > np.hypot(x, y) else "phi", 1.0

    def curves(self, grid: Grid, t_v1: Array) -> Curves:
        """The epipolar curves between the range limits, sampled as `sampled` says."""
        sampling, pitch_px = self.sampled(t_v1)
        return epipolar_curves(
            grid, t_v1, d_min_m=self.d_min_m, d_max_m=self.d_max_m, sampling=sampling, pitch_px=pitch_px
        )

    def support(self, log_sigma_px: float) -> Support | None:  # noqa: ARG002 - for matchers of filtered panoramas
        """The pixels that a match is made from, given the filter before it; None without a fixed window."""
        return None


class Parametrised(MatcherSettings):
    """Settings with parameters that only the matcher understands."""

    parameters: Annotated[dict[str, JsonValue], Field(default_factory=dict)]
    """A table that only the matcher itself understands, passed on unchanged."""

    @field_validator("parameters", mode="before")
    @classmethod
    def _plain(cls, parameters: Any) -> Any:
        return checked_plain(parameters) if isinstance(parameters, Mapping) else parameters

    def __eq__(self, other: object) -> bool:
        # By text, as NaN is not equal to itself, and 1 and 1.0 are two parameters.
        return type(self) is type(other) and self._text == other._text

    @property
    def runs_third_party_code(self) -> bool:
        """Always true: only third-party functions and programs take parameters."""
        return True

    def __hash__(self) -> int:
        return hash(self._text)

    @property
    def _text(self) -> str:
        return json.dumps(as_table(self), sort_keys=True)


class Reason(IntEnum):
    """The reason why a pixel has no match; 0 if it has one."""

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
    """The matcher found none, or rejected it as too uncertain."""
    INCONSISTENT = 7
    """The match from view 2 back to view 1 leads elsewhere."""
    OFF_CURVE = 8
    """In view 2 the point lies beside its epipolar curve, unlike its surroundings: most likely it has moved."""
    OCCLUDED = 9
    """There is no match, and view 2 seems to see a nearer surface in front of the point. Of the pixels said to be so, a
    tenth to six tenths are, depending on the scene: see `occlusion_precision`."""
    REPEATED = 10
    """The texture about it repeats, and another range explains both images as well; of photographs alone, see
    `harness.pipeline.repeated_texture`."""


@dataclass(frozen=True, repr=False)
class Matches(OneLine):
    """The matches of a pair, on view 1's panorama; every array `[height, width]`.

    Only `alpha_2` is required. The other arrays add to the report.
    """

    alpha_2: Array
    """Radians: the angle in the epipolar plane between t and the direction from viewpoint 2 to the point, in v1's
    orientation. NaN where there is no match."""
    confidence: Array | None = None
    """Higher is more confident; in any unit, as only the order counts. NaN where there is no match."""
    sigma_alpha_2: Array | None = None
    """Predicted standard deviation of `alpha_2`, radians. NaN where there is no match."""
    reason: NDArray[np.uint8] | None = None
    """A `Reason` for each pixel."""
    refined: NDArray[np.bool_] | None = None
    """Whether a sub-pixel step moved the match off the whole sample; None for a matcher without samples."""
    k: Array | None = None
    """Position on the curve in samples, NaN where there is no match; None for a matcher without samples."""
    remark: str = ""
    """A caveat for readers of the figures about how the matches were made: a sentence, stored with the trial."""

    @property
    def reasons(self) -> NDArray[np.uint8]:
        """`reason`; `Reason.NO_MATCH` for every NaN of a matcher that gives no reasons."""
        if self.reason is not None:
            return self.reason
        return np.where(np.isnan(self.alpha_2), np.uint8(Reason.NO_MATCH), np.uint8(Reason.MATCHED))


@dataclass(frozen=True)
class Fault:
    """A violated rule of the interface in a matcher's answer."""

    rule: Literal["form", "shape", "dtype", "angles", "missing"]
    """The rule that it breaks: the form of the return value, its shape or type, angles in range, or NaN exactly where
    there is no match."""
    text: str
    """A description for people, with the first pixel concerned."""


def as_matches(answer: Any, grid: Grid, name: str) -> Matches:
    """A third-party matcher's return value as `Matches`, checked; arrays are copied and read-only.

    Parameters
    ----------
    answer
        `Matches`, an array `alpha_2`, a pair of arrays `(alpha_2, confidence)`, or an `Answer` on pixels of its own.
    name
        The matcher's name in messages.

    Raises
    ------
    InputError
        When `faults` finds any: the first.
    """
    for fault in faults(answer, grid):
        raise InputError(fault.text, file=name)
    if isinstance(answer, Answer):
        on_panorama = converted(answer, grid)
        answer = Matches(on_panorama.alpha_2, on_panorama.confidence, on_panorama.sigma_alpha_2)
    arrays = _arrays_of(answer)
    matched = ~np.isnan(np.asarray(arrays["alpha_2"]))
    reason = np.where(matched, np.uint8(Reason.MATCHED), np.uint8(Reason.NO_MATCH))
    if arrays["reason"] is not None:
        reason = np.array(arrays["reason"], dtype=np.uint8)
    reason.flags.writeable = False
    return Matches(
        alpha_2=_copied(arrays["alpha_2"]),
        confidence=None if arrays["confidence"] is None else _copied(arrays["confidence"]),
        sigma_alpha_2=None if arrays["sigma_alpha_2"] is None else _copied(arrays["sigma_alpha_2"]),
        reason=reason,
        refined=None if arrays["refined"] is None else np.array(arrays["refined"], dtype=bool),
        k=None if arrays["k"] is None else _copied(arrays["k"]),
        remark=str(answer.remark) if isinstance(answer, Matches) else "",
    )


def faults(answer: Any, grid: Grid) -> Iterator[Fault]:
    """All faults of a matcher's result, the gravest first: after a wrong form, shape or type nothing else is checked.

    Required is what `as_matches` takes, where every array has the panorama's shape and holds real numbers; `alpha_2`
    within 0 .. pi radians, or NaN where there is no match; `confidence`, `sigma_alpha_2` and `k` finite where there is
    a match and NaN elsewhere, `sigma_alpha_2` above zero; `reason` 0 exactly where there is a match;
    `refined` true only there. Of an `Answer` the same is asked on its own pixels, and values that its quantity can
    have.
    """
    if isinstance(answer, Answer):
        yield from _answer_faults(answer, grid)
        return
    arrays = _arrays_of(answer)
    if not arrays:
        yield Fault(
            "form",
            "must return alpha_2 as an array, a pair (alpha_2, confidence), Matches, or views.answer(...); "
            f"it returned {type(answer).__name__}",
        )
        return
    if arrays["alpha_2"] is None:
        yield Fault("form", "alpha_2 is missing")
        return
    broken = [
        fault
        for name, value in arrays.items()
        if value is not None
        for fault in _array_faults(name, value, grid.shape, "the panorama's")
    ]
    yield from broken
    if broken:
        return
    alpha_2 = np.asarray(arrays["alpha_2"], dtype=np.float64)
    matched = ~np.isnan(alpha_2)
    yield from _fault_where(
        "angles",
        "alpha_2 must lie within 0 .. pi radians, or be NaN for no match",
        alpha_2,
        matched & ~((alpha_2 >= 0) & (alpha_2 <= np.pi)),
    )
    yield from _faults_beside({name: arrays[name] for name in ("confidence", "sigma_alpha_2", "k")}, matched)
    if arrays["reason"] is not None:
        reason = np.asarray(arrays["reason"])
        yield from _fault_where(
            "missing",
            f"reason must be one of 0 .. {max(Reason)}",
            reason,
            ~np.isin(reason, [each.value for each in Reason]),
        )
        yield from _fault_where(
            "missing",
            "reason must be 0 (matched) exactly where alpha_2 is not NaN",
            reason,
            (reason == Reason.MATCHED) != matched,
        )
    if arrays["refined"] is not None:
        refined = np.asarray(arrays["refined"])
        yield from _fault_where("missing", "refined must be false where there is no match", refined, refined & ~matched)


def _faults_beside(arrays: Mapping[str, Any], matched: NDArray[np.bool_]) -> Iterator[Fault]:
    """Faults of arrays that are finite where there is a match and NaN elsewhere; a standard deviation is above zero."""
    for name, array in arrays.items():
        if array is None:
            continue
        value = np.asarray(array, dtype=np.float64)
        yield from _fault_where(
            "missing", f"{name} must be finite where there is a match", value, matched & ~np.isfinite(value)
        )
        yield from _fault_where(
            "missing", f"{name} must be NaN where there is no match", value, ~matched & ~np.isnan(value)
        )
        if name.startswith("sigma"):
            yield from _fault_where("angles", f"{name} must be above zero", value, matched & (value <= 0))


def _answer_faults(answer: Answer, grid: Grid) -> Iterator[Fault]:
    """Faults of an answer on pixels of its own."""
    whose = "the panorama's" if answer.projection is None else "its views'"
    broken = [
        fault
        for name, value in answer.arrays.items()
        for fault in _array_faults(name, value, answer.shape(grid), whose)
    ]
    yield from broken
    if broken:
        return
    values = np.asarray(answer.values, dtype=np.float64)
    wrong, text = outside(answer)
    yield from _fault_where("angles", text, values, wrong)
    yield from _faults_beside({"confidence": answer.confidence, "sigma": answer.sigma}, ~np.isnan(values))


def _arrays_of(answer: Any) -> dict[str, Any]:
    """The arrays of a result by name; none if its form is not known."""
    if isinstance(answer, np.ndarray):
        answer = Matches(answer)
    elif isinstance(answer, tuple) and len(answer) == 2:
        answer = Matches(*answer)
    names = [field.name for field in fields(Matches) if field.name != "remark"]
    return {name: getattr(answer, name) for name in names} if isinstance(answer, Matches) else {}


def _array_faults(name: str, value: Any, shape: tuple[int, int], whose: str) -> Iterator[Fault]:
    """Faults of a value that should be an array of this shape."""
    kinds, expected = ("b", "booleans") if name == "refined" else ("iu", "whole numbers")
    if name not in {"refined", "reason"}:
        kinds, expected = "fiu", "real numbers"
    if not isinstance(value, np.ndarray):
        yield Fault("form", f"{name} must be a NumPy array; it is {type(value).__name__}")
    elif isinstance(value, np.ma.MaskedArray):
        yield Fault("form", f"{name} must be a plain array with NaN where there is no match; its mask would be lost")
    else:
        if value.shape != shape:
            yield Fault("shape", f"{name} must have {whose} shape {shape}; it has {value.shape}")
        if value.dtype.kind not in kinds:
            yield Fault("dtype", f"{name} must be an array of {expected}; its dtype is {value.dtype}")


def _fault_where(rule: Any, text: str, value: NDArray[Any], wrong: NDArray[np.bool_]) -> Iterator[Fault]:
    """A fault of some pixels."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        more = f", and wrong at {int(wrong.sum())} pixels in all" if wrong.sum() > 1 else ""
        shown = value[row, column].item()
        yield Fault(
            rule, f"{text}; it is {f'{shown:g}' if isinstance(shown, float) else shown} at [{row}, {column}]{more}"
        )


def _copied(value: Any) -> Array:
    """A read-only copy, since a matcher may reuse its arrays."""
    array = np.array(value, dtype=np.float64)
    array.flags.writeable = False
    return array
