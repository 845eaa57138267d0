"""The images against the geometry: swapped views, wrong poses and calibrations, half-pixel shifts, wrong units.

If both images agree better at the points of a map under another geometry, that geometry reveals the fault. First come
other readings of the set's numbers; then small changes, fitted to all pairs together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.sensor import lens_from_sensor
from harness.datasets.checks.finding import Finding, StoredSet
from harness.datasets.checks.sight import Change, Pixels, Sight, across_px, correlation, fit, outline_profile, sight_of
from harness.datasets.layouts.helvipad import polar_of, range_of_disparity
from harness.display import counted
from harness.geometry.angles import Array
from harness.geometry.pose import Motion

_MOST_PAIRS = 10
_AGREE = 0.45
"""Correlation below which the images do not show the same points: right ones have 0.8 and more, noisy ones 0.6."""
_BETTER = 0.25
"""Share of a correlation's deficit from 1 that another reading has to remove."""
_LEAST_BETTER = 0.01
_GAIN = 0.06
"""Least decrease of the squared differences, as a share, for a small change to be believed."""
_LEAST_COSINE = 0.05
_ACROSS_PX = 0.3
_LEAST_PATCHES = 20
_MOST = 0.7
"""Share of the pairs that have to ask for about the same change."""
_LEAST_OUTLINES, _LEAST_OUTLINES_OF_A_PAIR = 150, 30
_DEVIATIONS = 4.0
_SHARE = 0.45
"""Least difference of the steps before and after outlines, as a share of the largest step's excess over its
surroundings."""


# --- Other readings --------------------------------------------------------------------------------------------------


def as_stated(sight: Sight, _numbers: Array) -> Pixels:
    """The pixels of the points by the geometry that the set states."""
    return sight.pixels()


def _moved(sight: Sight, motion: Motion) -> Pixels:
    return sight.pixels(motion=motion)


def _inverse(sight: Sight, _numbers: Array) -> Pixels:
    motion = sight.pair.motion
    R = motion.R_v2_from_v1
    return _moved(sight, Motion(R_v2_from_v1=R.T, t_v1=-R @ motion.t_v1))


def _other_way(sight: Sight, _numbers: Array) -> Pixels:
    motion = sight.pair.motion
    return _moved(sight, Motion(R_v2_from_v1=motion.R_v2_from_v1, t_v1=-motion.t_v1))


def _transposed(sight: Sight, _numbers: Array) -> Pixels:
    motion = sight.pair.motion
    return _moved(sight, Motion(R_v2_from_v1=motion.R_v2_from_v1.T, t_v1=motion.t_v1))


def _in_frame_2(sight: Sight, _numbers: Array) -> Pixels:
    """The place of view 2 if t was the translation of points."""
    motion = sight.pair.motion
    R = motion.R_v2_from_v1
    return _moved(sight, Motion(R_v2_from_v1=R, t_v1=-R.T @ motion.t_v1))


def _from_axis(sight: Sight, _numbers: Array) -> Pixels:
    first = sight.views[0]
    along = np.abs(sight.directions @ (lens_from_sensor(first.sensor)[2] @ first.R_view_from_map))
    return sight.pixels(np.where(along > _LEAST_COSINE, sight.range_m / np.maximum(along, _LEAST_COSINE), np.nan))


def _from_level(sight: Sight, _numbers: Array) -> Pixels:
    level = np.hypot(sight.directions[:, 0], sight.directions[:, 1])
    return sight.pixels(np.where(level > _LEAST_COSINE, sight.range_m / np.maximum(level, _LEAST_COSINE), np.nan))


def _scaled(factor: float) -> Change:
    return lambda sight, _numbers: sight.pixels(sight.range_m * factor)


def _inverted(sight: Sight, _numbers: Array) -> Pixels:
    return sight.pixels(1 / sight.range_m)


def _disparity(factor: float, *, cosine: float = 1.0) -> Change:
    """The map's numbers times a factor as disparities in degrees; NaN for maps of anything else."""

    def change(sight: Sight, _numbers: Array) -> Pixels:
        polar = polar_of(sight.directions)
        polar = polar if cosine > 0 else np.pi - polar
        range_m = range_of_disparity(sight.raw * factor, polar, sight.pair.motion.baseline_m)
        return sight.pixels(range_m if sight.pair.maps[0].quantity == "disparity" else np.full(range_m.shape, np.nan))

    return change


def _flipped(axis: int, view: int) -> Change:
    def change(sight: Sight, _numbers: Array) -> Pixels:
        pixels = [each.copy() for each in sight.pixels()]
        camera = sight.views[view].sensor.camera
        pixels[view][:, axis] = (camera.width_px, camera.height_px)[axis] - 1 - pixels[view][:, axis]
        return pixels[0], pixels[1]

    return change


_READINGS: dict[str, Change] = {
    "the pose of view 2 is its inverse": _inverse,
    "the baseline points the other way": _other_way,
    "the rotation is transposed": _transposed,
    "t is the translation of points (in p_2 = R p_1 + t), not the place of view 2": _in_frame_2,
    "the map has depths along the camera's axis, not ranges": _from_axis,
    "the map has distances from the vertical axis, not ranges": _from_level,
    "ranges are in millimetres": _scaled(1e-3),
    "ranges are in centimetres": _scaled(1e-2),
    "ranges are in kilometres": _scaled(1e3),
    "the map has inverse ranges": _inverted,
    "disparities are in radians": _disparity(180 / np.pi),
    "disparities are in tenths of a degree": _disparity(0.1),
    "disparities have the sign before the cosine the other way": _disparity(1.0, cosine=-1.0),
    "image 1 is a mirror image": _flipped(0, 0),
    "image 2 is a mirror image": _flipped(0, 1),
    "image 1 is upside down": _flipped(1, 0),
    "image 2 is upside down": _flipped(1, 1),
}
"""Alternative readings of a set's geometry."""


def _swapped(sights: Sequence[Sight]) -> list[Sight]:
    """The pairs with their images exchanged, where both have one size."""
    out = []
    for sight in sights:
        first, second = sight.images
        if first.values.shape == second.values.shape:
            other = Sight(sight.pair, sight.directions, sight.range_m, sight.raw, sight.cells, sight.range_map)
            other.__dict__["images"] = (second, first)
            out.append(other)
    return out


# --- Small changes ---------------------------------------------------------------------------------------------------


def _shift_2(sight: Sight, numbers: Array) -> Pixels:
    p_1, p_2 = sight.pixels()
    return p_1, p_2 + numbers


def _shift_both(sight: Sight, numbers: Array) -> Pixels:
    p_1, p_2 = sight.pixels()
    return p_1 + numbers, p_2 + numbers


def _focal(sight: Sight, numbers: Array) -> Pixels:
    pixels = []
    for each, view in zip(sight.pixels(), sight.views, strict=True):
        centre = np.array([view.sensor.camera.cx_px, view.sensor.camera.cy_px])
        pixels.append(centre + (1 + numbers[0] / 100) * (each - centre))
    return pixels[0], pixels[1]


def _rotation(sight: Sight, numbers: Array) -> Pixels:
    motion = sight.pair.motion
    turned = Rotation.from_rotvec(np.radians(numbers)).as_matrix() @ motion.R_v2_from_v1
    return sight.pixels(motion=Motion(R_v2_from_v1=turned, t_v1=motion.t_v1))


def _length(sight: Sight, numbers: Array) -> Pixels:
    return sight.pixels(sight.range_m * np.exp(numbers[0] / 100))


@dataclass(frozen=True)
class _Small:
    """A small change: how it is said, from what size on, and the steps of its derivatives."""

    said: str
    """The description, into which `str.format` puts the median numbers, and their size as `size`."""
    change: Change
    least: float
    steps: tuple[float, ...]
    alike: bool = True
    """Whether it has to be the same in all pairs; poses are wrong in any way."""


_SMALL = (
    _Small("image 2 is shifted against image 1 by ({0:+.2f}, {1:+.2f}) px", _shift_2, 0.25, (0.05, 0.05)),
    _Small(
        "both images are shifted against their calibrations by ({0:+.2f}, {1:+.2f}) px, as where pixels are counted "
        "from their corners",
        _shift_both,
        0.25,
        (0.05, 0.05),
    ),
    _Small("the focal length is off by {0:+.2f} %", _focal, 0.5, (0.05,)),
    _Small("view 2 is turned by {size:.2f} degrees against its pose", _rotation, 0.2, (0.02,) * 3, alike=False),
    _Small("ranges are {0:+.1f} % off, or the baseline as much the other way", _length, 3.0, (0.5,)),
)


def check_images(data: StoredSet) -> Iterator[Finding]:
    """Whether the images show what ranges, poses and calibrations say."""
    sights = [sight for pair in data.some(_MOST_PAIRS) if (sight := sight_of(pair)) is not None]
    if not sights:
        return
    where = counted(len(sights), "pair")
    stated = correlation(sights, as_stated)
    better = {said: correlation(sights, change) for said, change in _READINGS.items()}
    better["the images of a pair are swapped"] = correlation(_swapped(sights), as_stated)
    best = max(better, key=lambda said: better[said])
    if better[best] > max(stated + max(_BETTER * (1 - stated), _LEAST_BETTER), _AGREE):
        text = f"{best}: so read the images correlate by {better[best]:.2f}, as stated by {stated:.2f}"
        yield Finding("images", where, text)
        return
    likely = [both for small in _SMALL if (both := _fitted(sights, small)) is not None]
    if likely:
        said, gain = max(likely, key=lambda both: both[1])
        yield Finding("images", where, f"{said}: with this change the images differ by {gain:.0%} less")
        return
    yield from _unexplained(sights, stated, where)


def _fitted(sights: Sequence[Sight], small: _Small) -> tuple[str, float] | None:
    """The description of a small change and its gain, if most pairs fit it alike; None otherwise.

    Each pair is fitted by itself: surfaces that repeat themselves, or that are coarser in the image than on the wall,
    ask for something, but in no two pairs for the same.
    """
    fits = [fit([sight], small.change, np.array(small.steps)) for sight in sights]
    gain = float(np.median([each.gain for each in fits]))
    numbers = np.array([each.numbers for each in fits])
    sizes = np.linalg.norm(numbers, axis=1)
    if small.alike:
        middle = np.median(numbers, axis=0)
        apart = np.linalg.norm(numbers - middle, axis=1)
        if np.mean(apart < 0.5 * max(float(np.linalg.norm(middle)), small.least)) < _MOST:
            return None
        size = float(np.linalg.norm(middle))
    else:
        middle, size = np.median(np.abs(numbers), axis=0), float(np.median(sizes))
    # A single pair has no other to agree with.
    if gain < (_GAIN if len(sights) > 1 else 3 * _GAIN) or size < small.least:
        return None
    return small.said.format(*middle, size=size), gain


def _unexplained(sights: Sequence[Sight], stated: float, where: str) -> Iterator[Finding]:
    """Faults that no change explains: patches off their epipolar curves, or images of other scenes."""
    off = np.concatenate([across_px(sight) for sight in sights])
    if stated < _AGREE:
        yield Finding("images", where, f"the images do not show the map's points: they correlate by {stated:.2f}")
    elif off.size >= _LEAST_PATCHES and (size := float(np.median(np.abs(off)))) > _ACROSS_PX:
        text = (
            f"patches lie {size:.2f} px off their epipolar curves (median of {off.size}): a pose or calibration is off"
        )
        yield Finding("images", where, text)


def check_outlines(data: StoredSet) -> Iterator[Finding]:
    """Whether the map's outlines are where image 1 has them: maps that are half a pixel off.

    Of a map that is half a pixel off, the steps of grey at its outlines and on one side of them are equal. Pixels along
    one outline are no independent measurements: so the pairs have to agree, too.
    """
    profiles = [outline_profile(sight) for pair in data.some(_MOST_PAIRS) if (sight := sight_of(pair)) is not None]
    for axis, name in ((0, "u"), (1, "v")):
        of_pairs = [each[axis] for each in profiles if len(each[axis]) >= _LEAST_OUTLINES_OF_A_PAIR]
        if sum(map(len, of_pairs)) < _LEAST_OUTLINES:
            continue
        steps = np.concatenate(of_pairs)
        middle = steps.shape[1] // 2
        before, at, after = (float(steps[:, middle + i].mean()) for i in (-1, 0, 1))
        around = float(np.median(steps.mean(axis=0)))
        difference = steps[:, middle + 1] - steps[:, middle - 1]
        deviations = difference.mean() / max(difference.std() / np.sqrt(len(steps)), 1e-12)
        share = (after - before) / max(max(at, after, before) - around, 1e-9)
        one_way = [np.sign(np.mean(each[:, middle + 1] - each[:, middle - 1])) == np.sign(share) for each in of_pairs]
        if abs(deviations) > _DEVIATIONS and abs(share) > _SHARE and np.mean(one_way) >= _MOST:
            text = (
                f"the map is shifted against image 1 along {name}: across {len(steps)} outlines image 1 changes by "
                f"{before:.2f}, {at:.2f}, {after:.2f} a pixel before, at and after them ({deviations:+.1f} sigma)"
            )
            yield Finding("outlines", counted(len(profiles), "pair"), text)
