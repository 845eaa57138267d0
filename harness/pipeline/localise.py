"""Localisation by appearance in a trial: real images in pairs, more made of them by warping, and new images to place.

Of the same number of real images there are four ways to learn:

- `pairs`: the images of n/2 pairs;
- `synthesised`: these, and views warped from them with the matcher's ranges;
- `true ranges`: the same with the true ranges, which is the ceiling of any matcher;
- `singles`: n images at n places of their own, without a pair: the alternative use of the same number of real images.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.unwrap import unwrap
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import AT_REST, relative_motion
from harness.localisation.appearance import KINDS, local_descriptors, train_pca, train_vlad
from harness.localisation.places import learn
from harness.localisation.settings import Localisation
from harness.mapping.settings import OccupancyMap, Scan
from harness.pipeline.scan import profile_of
from harness.pipeline.sigma import sigma_m
from harness.pipeline.specification import Placement, Scoring, Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.stages import Work
from harness.pipeline.trial import NOISE, Outcome, run_trial
from harness.simulation.cast import cast
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator
from harness.simulation.scene_geometry import check_viewpoint, geometry_near
from harness.warping.settings import NovelViews
from harness.warping.surface import RangeSurface
from harness.warping.warp import Image, Source, warp

PAIRS, SYNTHESISED, TRUE_RANGES, SINGLES = "pairs", "synthesised", "true ranges", "singles"
WAYS = (PAIRS, SYNTHESISED, TRUE_RANGES, SINGLES)

_ROOM_M = 0.2
"""Nothing may be nearer to a viewpoint than this, metres, in its horizontal plane."""
_TRIES = 500
"""Places that are drawn before an area is taken to be full."""
_BEARINGS = 72
"""Bearings of the profile that shows where there is room for a synthesised view."""


@dataclass(frozen=True, repr=False, eq=False)
class _Learned(OneLine):
    """An image to learn from."""

    at_m: tuple[float, float]
    panorama: NDArray[np.float32]
    group: int
    real: bool


@dataclass(frozen=True, repr=False, eq=False)
class _PairImages(OneLine):
    """Both images of a pair, and images synthesised from them with estimated and with true ranges."""

    real: list[_Learned]
    made: dict[str, list[_Learned]]


def figures_of(outcome: Outcome) -> list[dict[str, Any]] | None:
    """The localisation errors of new images, JSON-able; None where the trial asks for no such test.

    Returns
    -------
    list of dict
        For each number of `images`, `way` and `appearance`: `mean_m` and `median_m` of the distances, and `nll`, the
        mean of -log p(true place | image), p per square metre. The way `singles` goes on to twice the largest number.
    """
    trial = outcome.trial
    settings = trial.localisation
    if not settings.images:
        return None
    grid = _grid(trial)
    rng = generator(trial.seed, "places", fingerprint(trial.scene))  # the same for every matcher
    pairs = [_pair(trial, grid, place, i) for i, place in enumerate(_places(trial, settings.most // 2, rng, True))]
    singles = [
        _Learned(place, _single(trial, grid, place, 0.0, f"single {i}"), i, real=True)
        for i, place in enumerate(_places(trial, 2 * settings.most, rng, False))
    ]
    at = np.array(_places(trial, settings.queries, rng, False))
    turns = rng.uniform(-180, 180, settings.queries)
    queries = [
        _single(trial, grid, (float(x), float(y)), float(turn), f"query {i}")
        for i, ((x, y), turn) in enumerate(zip(at, turns, strict=True))
    ]
    described = _Described()
    return [
        {"images": count, "way": way, "appearance": appearance}
        | _scores(appearance, learned, queries, at, settings, described, _words_rng(trial, way, count))
        for count, way, learned in _sets(settings, pairs, singles)
        for appearance in KINDS
    ]


def _words_rng(trial: Trial, way: str, count: int) -> np.random.Generator:
    return generator(trial.seed, "words", way, str(count))


def _sets(
    settings: Localisation, pairs: list[_PairImages], singles: list[_Learned]
) -> Iterator[tuple[int, str, list[_Learned]]]:
    """Sets of images to learn from: the number of real images, how the set is made, and the images."""
    for count in sorted(settings.images):
        chosen = pairs[: count // 2]
        real = [each for pair in chosen for each in pair.real]
        yield count, PAIRS, real
        if settings.synthesised:
            for way in (SYNTHESISED, TRUE_RANGES):
                yield count, way, real + [each for pair in chosen for each in pair.made[way]]
    for count in sorted({*settings.images, 2 * settings.most}):
        yield count, SINGLES, singles[:count]


class _Described:
    """A cache of the local descriptors of images."""

    def __init__(self) -> None:
        self._known: dict[int, Array] = {}

    def __call__(self, panoramas: list[NDArray[np.float32]]) -> list[Array]:
        for each in panoramas:
            if id(each) not in self._known:
                self._known[id(each)] = local_descriptors(each)
        return [self._known[id(each)] for each in panoramas]


def _scores(
    appearance: str,
    learned: list[_Learned],
    queries: list[NDArray[np.float32]],
    at_m: Array,
    settings: Localisation,
    described: _Described,
    rng: np.random.Generator,
) -> dict[str, float]:
    panoramas = [each.panorama for each in learned]
    if appearance == "pca":
        pca = train_pca(panoramas, settings.components)
        known, asked = pca.describe(panoramas), pca.describe(queries)
    else:
        real = [each.panorama for each in learned if each.real]
        vlad = train_vlad(described(real), settings.words, rng)
        known, asked = vlad.describe(described(panoramas)), vlad.describe(described(queries))
    (a, b), (c, d) = settings.area_m
    places = learn(
        np.array([each.at_m for each in learned]),
        known,
        np.array([each.group for each in learned]),
        np.array([each.real for each in learned]),
        abs((c - a) * (d - b)),
    )
    distance = np.linalg.norm(places.estimate(asked) - at_m, axis=1)
    likelihood = places.density(asked, at_m)
    return {
        "mean_m": float(distance.mean()),
        "median_m": float(np.median(distance)),
        "nll": float(-np.log(likelihood).mean()),
    }


def _pair(trial: Trial, grid: Grid, place: tuple[float, float], number: int) -> _PairImages:
    """The images of a pair at a place, and those made of it."""
    settings = trial.localisation
    outcome = run_trial(_at(trial, place, 0.0, f"pair {number}"), threads=1)
    first, second = outcome.trial.poses
    real = [
        _Learned(
            (float(pose.position_m[0]), float(pose.position_m[1])),
            _panorama(image, outcome.trial, view, grid),
            number,
            real=True,
        )
        for view, (pose, image) in enumerate(zip((first, second), outcome.images, strict=True))
    ]
    synthesised: dict[str, list[_Learned]] = {SYNTHESISED: [], TRUE_RANGES: []}
    if settings.synthesised and outcome.valid.any():
        offsets = _room_for(outcome, settings, generator(trial.seed, "made views", str(number)))
        exact = np.zeros(outcome.trial.panorama.shape)
        ranges = {SYNTHESISED: (outcome.range_m, sigma_m(outcome)), TRUE_RANGES: (outcome.truth.range_m, exact)}
        motion = outcome.pair.motion
        images = [
            Image(image, sensor, moved)
            for image, sensor, moved in zip(outcome.images, outcome.pair.sensors, (AT_REST, motion), strict=True)
        ]
        for way, (range_m, sigma) in ranges.items():
            source = Source(RangeSurface(outcome.trial.panorama, range_m, sigma), AT_REST)
            for offset in offsets:
                view = warp([source], images, first.R_world_from_view.T @ offset, directions(grid), fill=True)
                at = (float(first.position_m[0] + offset[0]), float(first.position_m[1] + offset[1]))
                synthesised[way].append(_Learned(at, view.grey, number, real=False))
    return _PairImages(real, synthesised)


def _room_for(outcome: Outcome, settings: Localisation, rng: np.random.Generator) -> list[Array]:
    """`[3]` each, in the world from viewpoint 1, metres: where views are made, by the pair's own ranges."""
    trial = outcome.trial
    first, second = (np.asarray(pose.position_m) for pose in trial.poses)
    profile = profile_of(outcome, Scan(bearings=_BEARINGS, support_px=2))
    middle = (second - first) / 2
    x_axis = trial.poses[0].R_world_from_view[:2, 0]
    yaw = np.arctan2(x_axis[1], x_axis[0])
    offsets: list[Array] = []
    for _ in range(_TRIES):
        radius, turn = settings.radius_m * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        offset = np.array([middle[0] + radius * np.cos(turn), middle[1] + radius * np.sin(turn), 0.0])
        bearing = np.arctan2(offset[1], offset[0]) - yaw
        reach = profile.range_m[int(np.floor((bearing + np.pi) / profile.increment)) % _BEARINGS]
        if np.isnan(reach) or np.hypot(*offset[:2]) + _ROOM_M < reach:
            offsets.append(offset)
        if len(offsets) == settings.synthesised:
            break
    return offsets


def _places(trial: Trial, count: int, rng: np.random.Generator, with_pair: bool) -> list[tuple[float, float]]:
    """Random places of the area at which a view, or both of a pair, have room.

    Raises
    ------
    InputError
        When the area has hardly any free position.
    """
    (a, b), (c, d) = trial.localisation.area_m
    positions: list[tuple[float, float]] = []
    for _ in range(_TRIES + 20 * count):
        position = float(rng.uniform(min(a, c), max(a, c))), float(rng.uniform(min(b, d), max(b, d)))
        poses = _at(trial, position, 0.0, "").poses
        if all(_has_room(trial, np.asarray(pose.position_m)) for pose in (poses if with_pair else poses[:1])):
            positions.append(position)
        if len(positions) == count:
            return positions
    raise InputError("has hardly any free position for the views", file=trial.scene.name, key="localisation.area_m")


def _has_room(trial: Trial, position_m: Array) -> bool:
    geometry = geometry_near(trial.scene, position_m)
    origin = position_m - geometry.centre
    try:
        check_viewpoint(geometry, origin)
    except InputError:
        return False
    turn = np.arange(16) * 2 * np.pi / 16
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros(16)], axis=-1)
    return not (cast(geometry, origin, around, threads=1).range_m < _ROOM_M).any()


def _single(trial: Trial, grid: Grid, place: tuple[float, float], yaw_deg: float, name: str) -> NDArray[np.float32]:
    """The panorama of one image at a place, with its noise."""
    moved = _at(trial, place, yaw_deg, name)
    return _panorama(Work(moved, StageCache(), threads=1)(NOISE, 0), moved, 0, grid)


def _panorama(image: NDArray[np.float32], trial: Trial, view: int, grid: Grid) -> NDArray[np.float32]:
    """An image on the grid, in the orientation of view 1; unknown pixels have the mean of the known ones."""
    turn = relative_motion(*trial.poses).R_v2_from_v1 if view else None
    unwrapped = unwrap(image, trial.assumed_sensors[view], grid, R_sensor_from_panorama=turn)
    known = unwrapped.valid & np.isfinite(unwrapped.values)
    mean = float(unwrapped.values[known].mean()) if known.any() else 0.0
    return np.where(known, unwrapped.values, np.float32(mean))


def _at(trial: Trial, place: tuple[float, float], yaw_deg: float, name: str) -> Trial:
    """The trial with its rig at another position and other noise, without further scores."""
    view_1 = trial.view_1
    at = (*place, trial.poses[0].position_m[2])
    seed = int(generator(trial.seed, "image", fingerprint(trial.scene), name).integers(2**62)) if name else 0
    return trial.model_copy(
        update={
            "view_1": view_1.model_copy(update={"position_m": at, "yaw_deg": view_1.yaw_deg + yaw_deg}),
            "placement": Placement(),
            "novel_views": NovelViews(),
            "scan": Scan(),
            "map": OccupancyMap(),
            "localisation": Localisation(),
            "scoring": Scoring(),
            "seed": seed,
        }
    )


def _grid(trial: Trial) -> Grid:
    """The panorama that images are described on: the trial's rows, in nearly square pixels."""
    whole, width = trial.panorama, trial.localisation.width_px
    height = max(24, round(whole.height_px * width / whole.width_px))
    return Grid(width_px=width, height_px=height, z_min=whole.z_min, z_max=whole.z_max)
