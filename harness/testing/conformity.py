"""Checks that every matcher has to pass, on small scenes, with findings in plain words.

A check is passed, broken, or not reached because a check that it builds on is broken. `omnirange check` and the pytest
fixture `omnirange_check` run the checks.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.geometry.triangulation import alpha_2_at_range
from harness.matching.answers import Answer
from harness.matching.interface import Fault, MatcherSettings, Matches, as_matches, faults
from harness.matching.pair import Pair
from harness.testing.pairs import (
    GRID,
    OTHER_SENSOR,
    PAIRS,
    TURNED,
    Mask,
    Scenery,
    blank,
    fresh,
    lopsided,
    one_image,
    scenery,
)
from harness.testing.slips import FEWEST, slip_in

TOLERANCE_PX = 0.1
"""Tolerance of angles beyond a limit, in columns: rounding, and a sub-pixel step from the last candidate."""
NEAR_PX = 2.0
"""A disparity larger than this, in columns, is a thing that is not there, when both views are one image: matchers are
right to a fraction of a column where the texture is the same."""
ONE_IMAGE_SHARE = 0.25
"""Share of matches that may still have one: candidates of whole columns need not hold infinity itself."""
BLANK_SHARE = 0.1
"""Share of the pixels of images without texture that may have a match."""
SEAM_SHARE = 0.02
"""Share of pixels that may change when the rig is turned by a quarter: ties that rounding decides."""
DENSITY = 0.02
"""Share of the easy scene's pixels that must be matched, so that there is something to judge. Small images are hard on
matchers that want a wide border."""
BETTER = 0.8
"""The most that a matcher's error may be, as a share of the error of the best single range."""


@dataclass(frozen=True)
class Check:
    """A check that every matcher has to pass."""

    name: str
    title: str
    run: Callable[["Subject"], str]
    """Returns the observation in words; raises `Broken`, `NotReached` or the matcher's own `InputError`."""


@dataclass(frozen=True)
class Finding:
    """The result of a check."""

    check: Check
    passed: bool | None
    """Whether the check was passed; None if it was not reached."""
    text: str


class Broken(Exception):  # noqa: N818 - a verdict, not a failure of this program
    """The matcher does not pass the check."""


class NotReached(Exception):  # noqa: N818
    """A check that this one builds on is broken."""


def conformity(matcher: MatcherSettings) -> Iterator[Finding]:
    """All checks, one after the other."""
    subject = Subject(matcher)
    for check in CHECKS:
        yield examine(subject, check)


def examine(subject: "Subject", check: Check) -> Finding:
    """Carry out one check."""
    try:
        return Finding(check, passed=True, text=check.run(subject))
    except NotReached as reason:
        return Finding(check, passed=None, text=f"not tested: {reason}")
    except (Broken, InputError) as broken:
        return Finding(check, passed=False, text=str(broken))


@dataclass
class Subject:
    """A matcher under test; its results are kept."""

    matcher: MatcherSettings
    _answers: dict[str, Any] = field(default_factory=dict)

    def raw(self, name: str) -> Any:
        """The matcher's answer for one of the named pairs, unchecked."""
        if name not in self._answers:
            try:
                self._answers[name] = self.matcher.answer(fresh(PAIRS[name]()))
            except InputError as error:
                self._answers[name] = error
        if isinstance(self._answers[name], InputError):
            raise self._answers[name]
        return self._answers[name]

    def faults(self, name: str) -> list[Fault]:
        """The faults of the matcher's answer for one of the named pairs."""
        return list(faults(self.raw(name), PAIRS[name]().grid))

    def matches(self, name: str) -> Matches:
        """The matcher's answer for one of the named pairs, as `Matches`."""
        if name != "easy":
            self._sound("easy")
        return self._sound(name)

    def _sound(self, name: str) -> Matches:
        try:
            wrong = self.faults(name)
        except InputError as error:
            if name == "easy":
                raise NotReached("it returns no result") from error
            raise
        if wrong and name == "easy":
            raise NotReached("its result is invalid")
        if wrong:
            raise Broken(wrong[0].text)
        return as_given(self.raw(name), PAIRS[name]().grid)

    def now(self, pair: Pair, **limits: float) -> Matches:
        """The matcher's result for any pair, computed anew, with other limits."""
        self.matches("easy")
        matcher = self.matcher.model_copy(update=limits)
        answer = matcher.answer(pair)
        for fault in faults(answer, pair.grid):
            raise Broken(fault.text)
        return as_given(answer, pair.grid)


def as_given(raw: Any, grid: Grid) -> Matches:
    """A sound answer as `Matches`."""
    if isinstance(raw, Answer):
        return as_matches(raw, grid, "")
    if isinstance(raw, Matches):
        return raw
    return Matches(*raw) if isinstance(raw, tuple) else Matches(raw)


# --- The checks ---------------------------------------------------------------------------------------------------


def _runs(subject: Subject) -> str:
    for fault in subject.faults("easy"):
        if fault.rule == "form":
            raise Broken(fault.text)
    raw = subject.raw("easy")
    if isinstance(raw, Answer):
        where = "the panorama" if raw.projection is None else raw.projection.words
        return f"{', '.join(raw.arrays)} on {where}"
    matches = as_given(raw, GRID)
    more = [name for name in ("confidence", "sigma_alpha_2", "reason") if getattr(matches, name) is not None]
    return f"alpha_2{''.join(f', {name}' for name in more)}"


def _keeps(rule: str, good: str) -> Callable[[Subject], str]:
    """A check that an answer has no fault of one kind."""

    def check(subject: Subject) -> str:
        try:
            faults = subject.faults("easy")
        except InputError as error:
            raise NotReached("it returns no result") from error
        for fault in faults:
            if fault.rule == rule:
                raise Broken(fault.text)
        before = ("form",) if rule in {"shape", "dtype"} else ("form", "shape", "dtype")
        if any(fault.rule in before for fault in faults):
            raise NotReached("its result is not an array of the right shape and type")
        return good

    return check


def _not_mixed_up(subject: Subject) -> str:
    scene = lopsided()
    try:
        raw = subject.raw("lopsided")
        wrong = [fault for fault in faults(raw, scene.pair.grid) if fault.rule in {"form", "shape", "dtype"}]
    except InputError as error:
        raise NotReached("it returns no result") from error
    if wrong:
        raise NotReached("its result is not an array of the right shape and type")
    answer = raw if isinstance(raw, Answer) else scene.pair.answer(alpha_2=as_given(raw, GRID).alpha_2)
    if slip := slip_in(answer, scene):
        raise Broken(f"{answer.quantity} looks like {slip}")
    if np.isfinite(answer.values).sum() < FEWEST:
        return "too few matches to tell"
    return f"{answer.quantity} looks like nothing else"


def _repeats(subject: Subject) -> str:
    before = subject.matches("easy")
    _same(before, subject.now(fresh(scenery().pair)), "called again, it")
    return "two calls agree to the last bit"


def _remembers_nothing(subject: Subject) -> str:
    before = subject.matches("easy")
    subject.now(fresh(PAIRS["turned"]()))
    _same(before, subject.now(fresh(scenery().pair)), "after another pair, it")
    return "the same to the last bit"


def _threads(subject: Subject) -> str:
    one, two = (subject.now(fresh(scenery().pair, threads=count)) for count in (1, 2))
    _same(one, two, "with 2 threads instead of 1, it")
    return "the same to the last bit"


def _same(one: Matches, other: Matches, what: str) -> None:
    for name in ("alpha_2", "confidence", "sigma_alpha_2", "reason"):
        a, b = getattr(one, name), getattr(other, name)
        if (a is None) != (b is None):
            raise Broken(f"{what} returns {name} in one call, and not in the other")
        if a is not None and not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            differ = np.count_nonzero((a != b) & ~(np.isnan(a) & np.isnan(b)))
            raise Broken(f"{what} returns a different {name} at {differ} of {a.size} pixels")


def _leaves_inputs(subject: Subject) -> str:
    subject.matches("easy")
    pair = fresh(scenery().pair)
    before = {name: array.tobytes() for name, array in _inputs(pair)}
    subject.now(pair)
    for name, array in _inputs(pair):
        if array.tobytes() != before[name]:
            raise Broken(f"it has changed {name}, which other matchers get too; change a copy")
    return "images, panoramas and motion are as they were"


def _inputs(pair: Pair) -> Iterator[tuple[str, NDArray[Any]]]:
    for view in (0, 1):
        yield f"image {view + 1}", pair.images[view]
        yield f"panorama {view + 1}", pair.panoramas()[view].values
        yield f"the mask of panorama {view + 1}", pair.panoramas()[view].valid
        yield f"filtered panorama {view + 1}", pair.filtered()[view].values
    yield "the rotation", pair.motion.R_v2_from_v1
    yield "the translation", pair.t_v1
    yield "the directions", pair.directions


def _grids(subject: Subject) -> str:
    for name in ("grid 1", "grid 2"):
        grid = PAIRS[name]().grid
        try:
            subject.matches(name)
        except (Broken, InputError) as error:
            raise Broken(f"on a panorama of {grid.height_px} rows and {grid.width_px} columns: {error}") from error
    return "three grids, three shapes"


def _baselines(subject: Subject) -> str:
    for name, words in (("up", "straight up"), ("slanted", "to the side and up")):
        try:
            subject.matches(name)
        except (Broken, InputError) as error:
            raise Broken(f"with the second view {words}: {error}") from error
    return "also straight up"


def _limits(subject: Subject) -> str:
    pair = scenery().pair
    for near, far in ((subject.matcher.d_min_m, subject.matcher.d_max_m), (2.0, 3.0)):
        matches = subject.now(fresh(pair), d_min_m=near, d_max_m=far)
        least, most = (_alpha_2_at(pair, d) for d in (far, near))
        slack = TOLERANCE_PX * pair.grid.phi_pitch
        outside = (matches.alpha_2 < least - slack) | (matches.alpha_2 > most + slack)
        if outside.any():
            row, column = np.argwhere(outside)[0]
            side = "beyond d_max_m" if matches.alpha_2[row, column] < least[row, column] else "nearer than d_min_m"
            raise Broken(
                f"asked for {near:g} to {far:g} m, {np.count_nonzero(outside)} of its ranges lie outside: "
                f"at [{row}, {column}] it is {side}"
            )
    return "no range outside, also within 2 to 3 m"


def _alpha_2_at(pair: Pair, range_m: float) -> Array:
    """alpha_2 of a surface that is equally far away everywhere."""
    return alpha_2_at_range(pair.directions, range_m, pair.t_v1)


def _seam(subject: Subject) -> str:
    pair = scenery().pair
    before, after = subject.matches("easy").alpha_2, subject.matches("quarter").alpha_2
    after = np.roll(after, -pair.grid.width_px // 4, axis=1)
    changed = np.abs(after - before) > TOLERANCE_PX * pair.grid.phi_pitch
    changed |= np.isnan(after) != np.isnan(before)
    share = float(changed.mean())
    if share > SEAM_SHARE:
        columns = changed.mean(axis=0)
        worst = np.degrees(pair.grid.phi[int(np.argmax(columns))])
        raise Broken(
            f"with the whole rig turned by 90 deg, {share:.1%} of pixels get another result (at most "
            f"{SEAM_SHARE:.0%} may), most of them around phi = {worst:.0f} deg; the first and the last column of a "
            "panorama are neighbours"
        )
    return f"the rig turned by 90 deg: {1 - share:.1%} of pixels get the same result"


def _one_image_twice(subject: Subject) -> str:
    pair = one_image()
    matches = subject.now(pair, d_max_m=1000.0)
    sure = _judged(pair) & ~np.isnan(matches.alpha_2)
    if matches.confidence is not None and sure.any():
        sure &= matches.confidence >= np.median(matches.confidence[sure])
    if not sure.any():
        return "no matches"
    near = np.abs(matches.alpha_2 - pair.alpha_1)[sure] > NEAR_PX * pair.grid.phi_pitch
    text = (
        f"of {'the more confident half of ' if matches.confidence is not None else ''}its matches, {near.mean():.1%} "
        f"have a disparity above {NEAR_PX:g} columns where there is none"
    )
    if near.mean() > ONE_IMAGE_SHARE:
        raise Broken(f"{text} (at most {ONE_IMAGE_SHARE:.0%} may, with d_max_m = 1000)")
    return text


def _blank_images(subject: Subject) -> str:
    pair = blank()
    matches, easy = subject.matches("blank"), subject.matches("easy")
    judged = _judged(pair)
    matched = judged & ~np.isnan(matches.alpha_2)
    harmless = matches.alpha_2 <= _alpha_2_at(pair, subject.matcher.d_max_m) + NEAR_PX * pair.grid.phi_pitch
    if matches.confidence is not None and easy.confidence is not None and np.isfinite(easy.confidence).any():
        harmless |= matches.confidence <= np.nanquantile(easy.confidence, BLANK_SHARE)
    share = float((matched & ~harmless).sum() / judged.sum())
    text = f"on {share:.1%} of pixels it reports something nearer than d_max_m"
    if share > BLANK_SHARE:
        unsure = (
            f"and is more confident there than for the least confident {BLANK_SHARE:.0%} of an easy scene"
            if matches.confidence is not None
            else "and gives no confidence that would mark them"
        )
        raise Broken(
            f"on images of one grey, {text} (at most {BLANK_SHARE:.0%} may), {unsure}; "
            "return NaN, a low confidence, or the farthest range"
        )
    return text


def _judged(pair: Pair) -> Mask:
    """Pixels that are valid in both filtered panoramas, away from the epipoles."""
    return pair.filtered()[0].valid & pair.filtered()[1].valid & (np.sin(pair.alpha_1) >= 0.5)


def _easy_scene(subject: Subject) -> str:
    return _better_than_a_guess(subject, "easy", scenery())


def _turned_view(subject: Subject) -> str:
    return _better_than_a_guess(subject, "turned", scenery(TURNED))


def _two_sensors(subject: Subject) -> str:
    return _better_than_a_guess(subject, "sensors", scenery(TURNED, sensor_2=OTHER_SENSOR))


def _better_than_a_guess(subject: Subject, name: str, there: Scenery) -> str:
    pair, alpha_2 = there.pair, subject.matches(name).alpha_2
    scored = there.domain & ~np.isnan(alpha_2)
    density = scored.sum() / there.domain.sum()
    if density < DENSITY:
        raise Broken(f"it matches {density:.1%} of the pixels; at least {DENSITY:.0%} are required")
    guess = min(
        float(np.median(np.abs(_alpha_2_at(pair, d) - there.alpha_2)[there.domain])) for d in np.geomspace(0.5, 20, 40)
    )
    error = float(np.median(np.abs(alpha_2 - there.alpha_2)[scored]))
    in_px = f"median error {error / pair.grid.phi_pitch:.2f} columns; the best single range for all pixels has "
    in_px += f"{guess / pair.grid.phi_pitch:.2f}; {density:.0%} of pixels matched"
    if error > BETTER * guess:
        raise Broken(in_px + _likely_slip(alpha_2, there, scored, guess / 2))
    return in_px


def _likely_slip(alpha_2: Array, there: Scenery, scored: Mask, small: float) -> str:
    """The quantity that the result looks like, in words, if it is not alpha_2."""
    truth, alpha_1 = there.alpha_2, there.pair.alpha_1
    slips = (
        ("the disparity alpha_2 - alpha_1", truth - alpha_1),
        ("the angle to -t, pi - alpha_2", np.pi - truth),
        ("alpha_1, which means infinity everywhere", alpha_1),
    )
    for words, other in slips:
        if float(np.median(np.abs(alpha_2 - other)[scored])) < small:
            return f"; it looks like {words}"
    return ""


CHECKS: tuple[Check, ...] = (
    Check("answers", "returns a result", _runs),
    Check("shape", "one value for each pixel of view 1's panorama", _keeps("shape", f"{GRID.shape}")),
    Check("dtype", "real numbers", _keeps("dtype", "every array")),
    Check("angles", "angles within 0 .. pi, standard deviations above zero", _keeps("angles", "everywhere")),
    Check("mixed-up", "units, signs and half pixels as they are said to be", _not_mixed_up),
    Check("missing", "NaN where there is no match, and only there", _keeps("missing", "everywhere")),
    Check("repeats", "the same result when called again", _repeats),
    Check("memory", "the same result after another pair", _remembers_nothing),
    Check("threads", "the same result with any number of threads", _threads),
    Check("inputs", "does not change its inputs", _leaves_inputs),
    Check("grids", "follows the panorama's grid", _grids),
    Check("baselines", "works for any baseline", _baselines),
    Check("limits", "stays within d_min_m and d_max_m", _limits),
    Check("seam", "is periodic in azimuth", _seam),
    Check("one-image", "one image as both views: nothing is near", _one_image_twice),
    Check("blank", "images without texture: nothing is reported", _blank_images),
    Check("easy", "an easy scene: better than one range for all pixels", _easy_scene),
    Check("turned", "the second view turned: still better", _turned_view),
    Check("sensors", "taken by another sensor than the first: still better", _two_sensors),
)
"""The checks in the order in which they are carried out."""
