"""Likely mix-ups in a matcher's answer: another unit, another sign, another image, a shift by half a pixel.

The answer to a pair without symmetries is compared, on its own pixels, with the truth in all forms that might be
mistaken for it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from harness.geometry.angles import Array, angle_between
from harness.geometry.panorama import directions
from harness.matching.answers import Answer, disparity_of
from harness.matching.projections import Perspective
from harness.testing.pairs import Mask, Scenery

FITS = 0.25
"""An answer looks like something if its distance from that is below this share of that one's own spread."""
BETTER = 0.5
"""The answer's distance from a mix-up must also be below this share of its distance from the truth."""
HALF_PX = (0.35, 0.65)
"""A shift between these is called half a pixel; matchers that lean with a slant reach 0.25."""
LOOSELY_HALF_PX = (0.25, 0.75)
"""The limits for either half of the picture: a true shift is the same everywhere, a chance one is not."""
MOST = 0.75
"""Share of pixels by which pictures are told apart, as a floor looks alike in all directions."""
PICTURE_FITS = 0.5
"""`FITS` for these: among three quarters of the pixels are bad ones."""
FEWEST = 200
"""Pixels, at least, to tell anything from."""

_EDGE_PX = 3
"""Pixels nearer than this to an edge say nothing of a shift: windows reach across."""


@dataclass(frozen=True)
class Facts:
    """The truth on an answer's own pixels, `[height, width]`."""

    looking: Array
    range_m: Array
    range_2_m: Array
    """From viewpoint 2 along the same directions: the answer of a matcher that takes view 2 for view 1."""
    alpha_1: Array
    t_v1: Array
    step: float
    domain: Mask
    """Pixels that both views see, away from the epipoles."""
    smooth: Mask
    """Pixels of the domain that are away from edges."""

    @property
    def point(self) -> Array:
        """`[height, width, 3]`, metres, in v1's frame."""
        return self.looking * self.range_m[..., None]

    @property
    def alpha_2(self) -> Array:
        """Radians."""
        return angle_between(self.point - self.t_v1, self.t_v1)

    @property
    def disparity(self) -> Array:
        """Radians."""
        return self.alpha_2 - self.alpha_1


def facts_for(answer: Answer, there: Scenery) -> Facts:
    """The truth of a pair on an answer's own pixels."""
    grid = there.pair.grid
    looking = directions(grid) if answer.projection is None else answer.projection.directions
    ground_truth, range_2_m = there.truth(looking)
    a_1 = angle_between(looking, answer.t_v1)
    domain = ground_truth.visible & (np.sin(a_1) >= 0.5)
    if answer.seen is not None:
        domain &= answer.seen
    else:
        domain &= there.pair.panoramas()[0].valid
    near_edges = ndimage.binary_dilation(ground_truth.discontinuity | ~ground_truth.visible, iterations=_EDGE_PX)
    return Facts(
        looking=looking,
        range_m=ground_truth.range_m,
        range_2_m=range_2_m,
        alpha_1=a_1,
        t_v1=answer.t_v1,
        step=grid.phi_pitch if answer.projection is None else answer.projection.step,
        domain=domain,
        smooth=domain & ~near_edges & ~_bent(ground_truth.normal),
    )


def _bent(normal: Array) -> Mask:
    """Pixels near which the surface turns, as in a corner of a room: inverse range has a fold there."""
    at_fold = np.zeros(normal.shape[:2], dtype=bool)
    with np.errstate(invalid="ignore"):
        for axis in (0, 1):
            at_fold |= np.sum(normal * np.roll(normal, 1, axis=axis), axis=-1) < 0.99
    return np.asarray(ndimage.binary_dilation(at_fold, iterations=_EDGE_PX))


def slip_in(answer: Answer, there: Scenery) -> str:
    """The mix-up that an answer looks like, as a question; empty if no mix-up is evident.

    Returns
    -------
    str
        Without a full stop, to follow "alpha_2 looks like".
    """
    facts = facts_for(answer, there)
    values = np.asarray(answer.values, dtype=np.float64)
    scored = facts.domain & np.isfinite(values)
    if scored.sum() < FEWEST:
        return ""
    quantity = answer.quantity
    truth = _units(facts, answer)[_UNIT_OF[quantity]][0]
    for others, share, fits in (
        (_other_units(quantity, facts, answer), 0.5, FITS),
        (_other_pictures(quantity, truth, facts), MOST, PICTURE_FITS),
    ):
        should = _distance(values, truth, scored, share)
        distances = [(_distance(values, other, scored, share), text) for other, text in others]
        least, text = min(distances, key=lambda each: each[0])  # the first of equal ones
        if least < fits and least < BETTER * should:
            return text
    is_right = _distance(values, truth, scored, 0.5) < FITS
    return _half_pixel(disparity_of(answer, there.pair.grid), facts) if is_right else ""


def _distance(values: Array, other: Array, scored: Mask, share: float) -> float:
    """The distance that this share of the pixels keep, in units of the other's own spread."""
    mine, theirs = values[scored], other[scored]
    known = np.isfinite(theirs)
    if known.sum() < FEWEST:
        return np.inf
    spread = np.median(np.abs(theirs[known] - np.median(theirs[known])))
    return float(np.quantile(np.abs(mine[known] - theirs[known]), share) / max(spread, 1e-12))


# --- Units and signs ----------------------------------------------------------------------------------------------

_UNIT_OF = {"range_m": "range", "alpha_2": "alpha_2", "disparity_deg": "degrees", "disparity_px": "pixels"}
"""The unit of each quantity, as in `_units`."""

_METRES = "are these metres?"


def _units(facts: Facts, answer: Answer) -> dict[str, tuple[Array, str, bool]]:
    """The truth in every unit that a number may have, its name, and whether it is a length."""
    d, a_2, disparity = facts.range_m, facts.alpha_2, facts.disparity
    baseline = float(np.linalg.norm(facts.t_v1))
    pixels = disparity / facts.step
    level = np.hypot(facts.looking[..., 0], facts.looking[..., 1])
    units = {
        "range": (d, "ranges in metres", True),
        "millimetres": (1000 * d, "ranges in millimetres", True),
        "baselines": (d / baseline, "ranges in units of the baseline", True),
        "range 2": (np.linalg.norm(facts.point - facts.t_v1, axis=-1), "ranges from viewpoint 2", True),
        "level": (d * level, "distances along the ground, not along the ray", True),
        "inverse": (1 / d, "inverse ranges, 1/metres", False),
        "alpha_2": (a_2, "alpha_2 in radians", False),
        "alpha_2 degrees": (np.degrees(a_2), "alpha_2 in degrees", False),
        "from -t": (np.pi - a_2, "the angle to -t, pi - alpha_2", False),
        "alpha_1": (facts.alpha_1, "alpha_1, which means infinity everywhere", False),
        "radians": (disparity, "the disparity alpha_2 - alpha_1 in radians", False),
        "degrees": (np.degrees(disparity), "the disparity alpha_2 - alpha_1 in degrees", False),
        "pixels": (pixels, "the disparity in pixels", False),
        "half": (pixels / 2, "the disparity in pixels of an image of half the size", False),
        "twice": (2 * pixels, "the disparity in pixels of an image of twice the size", False),
        "negative degrees": (-np.degrees(disparity), "the disparity in degrees with its sign turned over", False),
        "negative pixels": (-pixels, "the disparity in pixels with its sign turned over", False),
        "negative radians": (-disparity, "the disparity in radians with its sign turned over", False),
    }
    if isinstance(answer.projection, Perspective):
        depth = facts.point @ answer.projection.axes[2]
        units["depth"] = depth, "depths along the optical axis, not ranges along the ray", True
    return units


def _other_units(said: str, facts: Facts, answer: Answer) -> Iterator[tuple[Array, str]]:
    """The truth in other units, or of the other sign, each with the question to ask if the answer looks like it."""
    is_length = said == "range_m"
    units = _units(facts, answer)
    for name in sorted(units, key=lambda each: _UNIT_OF[said] not in each):  # its own unit first: others may be equal
        other, words, length = units[name]
        if name == _UNIT_OF[said]:
            continue
        question = _METRES if length or is_length else "is this the unit, and the sign, that it is said to be?"
        yield other, f"{words}: {question}{_way_out(said, name)}"


def _other_pictures(said: str, truth: Array, facts: Facts) -> Iterator[tuple[Array, str]]:
    """The truth as other pictures, each with the question to ask if the answer looks like it."""
    yield from (
        (
            truth[:, ::-1],
            "a picture that is mirrored left to right: is its first column the left one?",
        ),
        (truth[::-1], "a picture that is upside down: is its first row the upper one?"),
        (truth[::-1, ::-1], "a picture that is turned by 180 degrees: is its first row the upper one?"),
        (
            np.roll(truth, truth.shape[1] // 2, axis=1),
            "a picture that is turned by half a circle: where is its first column looking?",
        ),
        (_of_view_2(said, facts), "the answer on view 2's pixels: are the views swapped?"),
    )


def _way_out(said: str, name: str) -> str:
    """A hint at the keyword of `answer` for the quantity that was meant."""
    keyword = {unit: quantity for quantity, unit in _UNIT_OF.items()}.get(name)
    return f" Then answer({keyword}=...) says so" if keyword and keyword != said else ""


def _of_view_2(said: str, facts: Facts) -> Array:
    """The answer of a matcher that takes view 2 for view 1."""
    point = facts.looking * facts.range_2_m[..., None]
    disparity = angle_between(point, point + facts.t_v1)
    return {
        "range_m": facts.range_2_m,
        "alpha_2": facts.alpha_1 + disparity,
        "disparity_deg": np.degrees(disparity),
        "disparity_px": disparity / facts.step,
    }[said]


# --- Half pixels --------------------------------------------------------------------------------------------------


SHIFTS = ("disparity", "rows", "columns")
"""The kinds of shift: of the disparity, everywhere alike, or of the picture."""


def shift_of(disparity: Array, facts: Facts, part: slice = slice(None)) -> Array | None:
    """The shift of an answer against the truth, in its own pixels, as in `SHIFTS`; None with too few pixels.

    Errors are `b - s_row ∂/∂row - s_column ∂/∂column` of the true disparity, fitted by least squares with weights 1/|r|
    beyond the median of the residuals, so that mismatches do not count.

    Parameters
    ----------
    disparity
        `[height, width]`, radians.
    part
        The columns that count.
    """
    true = facts.disparity / facts.step
    error = disparity / facts.step - true
    slopes = np.gradient(true)
    used = np.zeros(true.shape, dtype=bool)
    used[:, part] = facts.smooth[:, part]
    used &= np.isfinite(error) & (np.abs(error) < 3) & np.isfinite(slopes[0]) & np.isfinite(slopes[1])
    if used.sum() < FEWEST:
        return None
    design = np.stack([np.ones(used.sum()), -slopes[0][used], -slopes[1][used]], axis=-1)
    e, weights, fit = error[used], np.ones(used.sum()), np.zeros(3)
    for _ in range(10):
        fit = np.linalg.lstsq(design * weights[:, None], e * weights, rcond=1e-3)[0]
        residual = np.abs(e - design @ fit)
        weights = np.sqrt(np.minimum(1, np.median(residual) / np.maximum(residual, 1e-12)))
    return np.asarray(fit)


def _half_pixel(disparity: Array, facts: Facts) -> str:
    middle = disparity.shape[1] // 2
    parts = (shift_of(disparity, facts, part) for part in (slice(None), slice(middle), slice(middle, None)))
    shifts = [each for each in parts if each is not None]
    if len(shifts) < 3:
        return ""
    for name, (whole, *halves) in zip(SHIFTS, np.transpose(shifts), strict=True):
        if not HALF_PX[0] < abs(whole) < HALF_PX[1]:
            continue
        if any(not LOOSELY_HALF_PX[0] < each * np.sign(whole) < LOOSELY_HALF_PX[1] for each in halves):
            continue
        if name == "disparity":
            return f"disparities that are all off by {whole:+.2f} px: are both images sampled at pixel centres?"
        return f"a picture that is displaced by {whole:+.2f} {name}: are its pixel centres where the views' are?"
    return ""
