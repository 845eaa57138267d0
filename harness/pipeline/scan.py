"""The range profile of a trial, and the true one that it is scored against.

The true profile is cut from the scene itself: horizontal rays from the viewpoint's vertical, at many heights of the
band. So it also has what the view cannot see, such as a low object behind a high edge.
"""

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.errors import InputError
from harness.evaluation.scan_scores import Obstacle, ScanScore, obstacles_of, score_scan
from harness.geometry.angles import Array
from harness.geometry.panorama import directions
from harness.geometry.pose import Pose
from harness.mapping.range_profile import RangeProfile, bearings, level_frame, range_profile
from harness.mapping.settings import Scan
from harness.pipeline.sigma import sigma_m
from harness.pipeline.trial import Outcome
from harness.simulation.cast import cast
from harness.simulation.fingerprint import fingerprint
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import geometry_near

_COLUMNS = ("density", "bias_m", "rms_m", "median_abs_m", "within_1_sigma", "missed", "false")
_FINE_DEG = 0.05
"""Bearings of the true profile are as fine as this, degrees: a pole of 5 mm is met up to 5.7 m away."""
_LAYER_M = 0.02
_MOST_LAYERS = 48
"""Heights at which the scene is cut: one every so many metres, up to so many."""


@dataclass(frozen=True, repr=False, eq=False)
class TrueScan(OneLine):
    """The true profile of a view, in the frame of `range_profile.RangeProfile`."""

    fine: int
    """Fine bearings that make one of the profile's; odd."""
    fine_m: Array
    """`[fine bearings]`: horizontal distance of the nearest surface in the band, metres; NaN without one."""
    which: NDArray[np.intp]
    """`[fine bearings]`: the object it belongs to; -1 for none."""
    obstacles: tuple[Obstacle, ...]

    @property
    def range_m(self) -> Array:
        """`[bearings]`: the true distance at the middle of each bearing, metres; NaN without one."""
        return self.fine_m[self.fine // 2 :: self.fine]

    def profile(self, sigma_m: float = 0.0) -> RangeProfile:
        """The true profile as a range profile, all its distances with this standard deviation, metres."""
        range_m = self.range_m
        return RangeProfile(bearings(range_m.size), range_m, np.where(np.isfinite(range_m), sigma_m, np.nan))


@dataclass(frozen=True, repr=False, eq=False)
class ScoredScan(OneLine):
    """A profile beside the true one."""

    profile: RangeProfile
    true: TrueScan
    score: ScanScore
    obstacles: tuple[Obstacle, ...]
    """The obstacles of the true profile, and whether they were found."""


def scan_of(outcome: Outcome) -> ScoredScan | None:
    """The profile that `trial.scan` asks for, scored; None where it asks for none."""
    trial = outcome.trial
    if not trial.scan.bearings:
        return None
    profile = profile_of(outcome, trial.scan)
    true = true_scan(trial.scene, trial.poses[0], trial.scan)
    score, obstacles = score_scan(profile, true.range_m, list(true.obstacles), trial.scan, true.fine)
    return ScoredScan(profile, true, score, tuple(obstacles))


def profile_of(outcome: Outcome, scan: Scan) -> RangeProfile:
    """The profile of a trial's ranges."""
    pose = outcome.trial.poses[0]
    rays = directions(outcome.trial.panorama)
    return range_profile(
        rays, outcome.range_m, sigma_m(outcome), pose.R_world_from_view, float(pose.position_m[2]), scan
    )


def figures_of(outcome: Outcome) -> dict[str, Any] | None:
    """The score, JSON-able, with the names of the `obstacles` that were and were not found; None without a profile."""
    scored = scan_of(outcome)
    if scored is None:
        return None
    return asdict(scored.score) | {"which": [asdict(each) for each in scored.obstacles]}


def columns_of(score: dict[str, Any]) -> dict[str, float | None]:
    """The figures of what `figures_of` made, and the share of thin obstacles found, by the names of `trials.csv`."""
    thin = score["thin_found"] / score["thin"] if score["thin"] else None
    return {f"scan_{name}": score[name] for name in _COLUMNS} | {"scan_thin_found": thin}


def true_scan(scene: Scene, pose: Pose, scan: Scan) -> TrueScan:
    """The true profile of a view.

    Raises
    ------
    InputError
        When the band of heights lies outside of a closed scene.
    """
    return _true_scan(scene, fingerprint(scene), pose, scan)


@lru_cache(maxsize=64)
def _true_scan(scene: Scene, _contents: str, pose: Pose, scan: Scan) -> TrueScan:
    geometry = geometry_near(scene, pose.position_m)
    fine = 2 * math.ceil(180 / (scan.bearings * _FINE_DEG)) + 1
    azimuth = bearings(scan.bearings * fine)
    level = level_frame(pose.R_world_from_view) @ pose.R_world_from_view.T  # from the world
    along = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(azimuth.size)], axis=-1) @ level
    origin = np.asarray(pose.position_m) - geometry.centre
    nearest, which = np.full(azimuth.size, np.inf), np.full(azimuth.size, -1)
    for height in layers(scan, geometry.bounds[:, 2] + geometry.centre[2] if geometry.closed else None, scene.name):
        origin[2] = height - geometry.centre[2]
        hits = cast(geometry, origin, along, threads=1)
        distance = np.where(np.isfinite(hits.range_m), hits.range_m, np.inf)
        closer = distance < nearest
        nearest[closer] = distance[closer]
        which[closer] = geometry.object_of_face[geometry.face_of_triangle[hits.triangle[closer]]]
    beyond = nearest > scan.range_max_m
    range_m = np.where(beyond, np.nan, nearest)
    which[beyond] = -1
    return TrueScan(fine, range_m, which, tuple(obstacles_of(range_m, which, geometry.object_names)))


def layers(scan: Scan, bounds: Array | None, scene_name: str) -> Array:
    """Heights in the world at which a scene is cut, metres: evenly through the band, inside a closed scene's bounds.

    Raises
    ------
    InputError
        When nothing of the band is inside.
    """
    low, high = scan.low_m, scan.high_m
    if bounds is not None:
        low, high = max(low, float(bounds[0])), min(high, float(bounds[1]))
    if low >= high:
        raise InputError(
            f"the band from {scan.low_m:g} to {scan.high_m:g} m lies outside of the scene", file=scene_name, key="scan"
        )
    count = min(max(round((high - low) / _LAYER_M), 1), _MOST_LAYERS)
    return np.asarray(low + (np.arange(count) + 0.5) * (high - low) / count)
