"""The map of a trial: from its pair's range profiles along a path, and from the true profiles."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.errors import InputError
from harness.evaluation.map_scores import MapScore, score_map, true_states
from harness.geometry.angles import Array
from harness.mapping.occupancy import GridFrame, Place, frame_around, map_of_profiles
from harness.mapping.packed import packed
from harness.mapping.range_profile import RangeProfile
from harness.mapping.settings import OccupancyMap
from harness.pipeline.floor_plan import floor_plan
from harness.pipeline.scan import profile_of, true_scan
from harness.pipeline.specification import Placement, Scoring, Trial
from harness.pipeline.trial import Outcome, run_trial
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator
from harness.warping.settings import NovelViews

DEFAULT_BEARINGS = 360
"""Bearings of a map's profiles where `scan.bearings` is 0."""
_EXACT_M = 1e-4
"""Standard deviation of a true distance."""

States = NDArray[np.uint8]


@dataclass(frozen=True, repr=False, eq=False)
class PathMap(OneLine):
    """A map, the true map, and the ceiling: the map of the true profiles at the same positions."""

    frame: GridFrame
    state: States
    ceiling: States
    true: States
    """`Cell`, `[rows, columns]` each; unknown in `true` where nothing is scored."""
    score: MapScore
    ceiling_score: MapScore
    stations_m: Array
    """`[pairs, 2]`: x and y of the first viewpoints."""


def path_map_of(outcome: Outcome) -> PathMap | None:
    """The map that `trial.map` asks for; None where it asks for none."""
    trial = outcome.trial
    if not trial.map.path_m:
        return None
    estimated: list[tuple[RangeProfile, Place]] = []
    exact: list[tuple[RangeProfile, Place]] = []
    for each in trials_along(trial):
        pose = each.poses[0]
        x_axis = pose.R_world_from_view[:2, 0]
        place = Place(*pose.position_m[:2], float(np.arctan2(x_axis[1], x_axis[0])))
        try:
            estimated.append((profile_of(run_trial(each, threads=1), each.scan), place))
        except InputError as error:  # a view at a position that is not valid
            raise InputError(error.problem, file=error.file, key="trial.map.path_m") from error
        exact.append((true_scan(each.scene, pose, each.scan).profile(_EXACT_M), place))
    stations = np.array([[place.x_m, place.y_m] for _, place in estimated])
    settings, scan = trial.map, trials_along(trial)[0].scan
    plan = floor_plan(trial.scene, trial.poses[0].position_m, scan)
    bounds = stations.min(axis=0) - scan.range_max_m, stations.max(axis=0) + scan.range_max_m
    ends = np.clip(np.concatenate([plan.reshape(-1, 2), stations]), *bounds)
    frame = frame_around(ends.min(axis=0), ends.max(axis=0), settings.cell_m)
    true = true_states(plan, stations, frame)
    state, ceiling = (
        map_of_profiles(profiles, frame, prior=settings.prior, false_share=settings.false_share).state
        for profiles in (estimated, exact)
    )
    scores = [score_map(each, true, plan, frame) for each in (state, ceiling)]
    return PathMap(frame, state, ceiling, true, scores[0], scores[1], stations)


def figures_of(outcome: Outcome) -> dict[str, Any] | None:
    """The map and its scores, JSON-able; None if the trial asks for no map.

    Returns
    -------
    dict
        `score` and `ceiling`: see `map_scores.MapScore`; `origin_m`, `cell_m` and `shape` of the cells; `state`,
        `ceiling_state` and `true`: see `packed.packed`; `stations_m`.
    """
    path_map = path_map_of(outcome)
    if path_map is None:
        return None
    return {
        "score": asdict(path_map.score),
        "ceiling": asdict(path_map.ceiling_score),
        "origin_m": list(path_map.frame.origin_m),
        "cell_m": path_map.frame.cell_m,
        "shape": list(path_map.frame.shape),
        "state": packed(path_map.state),
        "ceiling_state": packed(path_map.ceiling),
        "true": packed(path_map.true),
        "stations_m": path_map.stations_m.tolist(),
    }


def columns_of(made: dict[str, Any]) -> dict[str, float | None]:
    """The map's scores, and those of the true profiles' map, by the names of `trials.csv`."""
    own = {f"map_{name}": made["score"][name] for name in made["score"]}
    return own | {f"map_ceiling_{name}": made["ceiling"][name] for name in ("iou_free", "iou_occupied")}


def trials_along(trial: Trial) -> list[Trial]:
    """The trial at each station of its map's path: each with noise of its own, moved as the placement has moved it."""
    first = trial.poses[0]
    offset = np.subtract(first.position_m, trial.view_1.position_m)
    placed_yaw_deg = first.yaw_deg - trial.view_1.yaw_deg
    scan = trial.scan if trial.scan.bearings else trial.scan.model_copy(update={"bearings": DEFAULT_BEARINGS})
    shared = {
        "placement": Placement(),
        "scan": scan,
        "map": OccupancyMap(),
        "novel_views": NovelViews(),
        "scoring": Scoring(),
    }
    trials = []
    for i, (x, y, heading) in enumerate(trial.map.stations()):
        turn = math.degrees(heading)
        at = (x + offset[0], y + offset[1], first.position_m[2])
        view_1 = first.model_copy(update={"position_m": at, "yaw_deg": first.yaw_deg + turn})
        second = trial.view_2
        turned = {"azimuth_deg": second.azimuth_deg + turn, "yaw_deg": second.yaw_deg + placed_yaw_deg + turn}
        view_2 = second.model_copy(update=turned)
        seed = int(generator(trial.seed, "path", fingerprint(trial.scene), f"station {i}").integers(2**62))
        trials.append(trial.model_copy(update={**shared, "view_1": view_1, "view_2": view_2, "seed": seed}))
    return trials
