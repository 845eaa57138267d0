"""Views from other viewpoints, warped from a trial's pair with its ranges, and the views they are compared with.

The *ceiling* is the same warp with the true ranges, and the *floor* the nearest of the two images untouched, turned to
the new view's orientation: a warp is worth its while between the two.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.fill import nearest_known
from harness.camera.sensor import Sensor, in_use
from harness.camera.unwrap import sample
from harness.display import OneLine
from harness.evaluation.view_scores import ViewScore, score_view
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import AT_REST, Motion, Pose, relative_motion
from harness.pipeline.sigma import sigma_m
from harness.pipeline.trial import Outcome
from harness.simulation.fingerprint import fingerprint
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import truth
from harness.warping.surface import RangeSurface
from harness.warping.warp import Image, Source, WarpedView, untouched, warp

Grey = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, repr=False, eq=False)
class NovelView(OneLine):
    """A new view on view 1's panorama, and the views that it is compared with."""

    distance_m: float
    """Distance from the first viewpoint, metres."""
    expected: Grey
    """The rendered view, without noise; NaN where the sensor does not see."""
    compared: Mask
    """The pixels that are scored: those that the sensor sees from the new viewpoint."""
    disoccluded: Mask
    """The pixels that view 1 does not see, by the truth."""
    warped: WarpedView
    """The view warped with the matcher's ranges; holes are filled."""
    ceiling: WarpedView
    """The view warped with the true ranges; holes are filled."""
    floor: Grey
    """The nearest image untouched."""

    def scores(self, grid: Grid) -> dict[str, ViewScore]:
        """The scores of `warped`, `ceiling` and `floor`, by these names."""
        nothing = np.zeros(grid.shape, dtype=bool)
        views = {
            "warped": (self.warped.grey, self.warped.holes),
            "ceiling": (self.ceiling.grey, self.ceiling.holes),
            "floor": (self.floor, nothing),
        }
        return {
            name: score_view(grid, grey, self.expected, self.compared, holes, self.disoccluded)
            for name, (grey, holes) in views.items()
        }


def novel_views(outcome: Outcome, distances_m: Sequence[float] | None = None) -> list[NovelView]:
    """The views that `trial.novel_views` asks for, or those at some distances; none without a range to warp with."""
    trial, pair = outcome.trial, outcome.pair
    line = trial.novel_views
    if distances_m is not None:
        line = line.model_copy(update={"distances_m": tuple(distances_m)})
    poses = line.poses(trial.poses[0])
    if not poses or not outcome.valid.any():
        return []
    viewpoints = [relative_motion(trial.poses[0], pose).t_v1 for pose in poses]
    source = Source(RangeSurface(trial.panorama, outcome.range_m, sigma_m(outcome)), AT_REST)
    images, looking = _images(outcome, pair.motion), directions(trial.panorama)
    # Views that do not depend on the matcher are made once for all matchers.
    bounds = pair.shared("ceiling and floor", line, lambda: _ceilings_and_floors(outcome, viewpoints))
    return [
        NovelView(distance, *_expected_of(outcome, pose), warp([source], images, at, looking, fill=True), *bound)
        for distance, pose, at, bound in zip(line.distances_m, poses, viewpoints, bounds, strict=True)
    ]


def _images(outcome: Outcome, motion: Motion) -> list[Image]:
    """Both images of a pair, with view 2 at the position that a motion gives."""
    (first, second), (sensor_1, sensor_2) = outcome.pair.images, outcome.pair.sensors
    return [Image(first, sensor_1, AT_REST), Image(second, sensor_2, motion)]


def _ceilings_and_floors(outcome: Outcome, viewpoints: list[Array]) -> list[tuple[WarpedView, Grey]]:
    """For each viewpoint the view that is warped with the true ranges, and the nearest image with its gaps filled."""
    grid, images = outcome.trial.panorama, _images(outcome, outcome.trial.true_motion)
    exact = Source(RangeSurface(grid, outcome.truth.range_m, np.zeros(grid.shape)), AT_REST)
    made = []
    for viewpoint in viewpoints:
        floor = untouched(images, viewpoint, directions(grid))
        ceiling = warp([exact], images, viewpoint, directions(grid), fill=True)
        made.append((ceiling, np.asarray(floor[nearest_known(np.isfinite(floor))])))
    return made


def figures_of(outcome: Outcome) -> list[dict[str, Any]]:
    """The scores of all new views, JSON-able: `distance_m`, and a table for each of `NovelView.scores`."""
    grid = outcome.trial.panorama
    return [
        {"distance_m": view.distance_m} | {name: asdict(score) for name, score in view.scores(grid).items()}
        for view in novel_views(outcome)
    ]


def columns_of(views: list[dict[str, Any]]) -> dict[str, float | None]:
    """Means over the distances of the scores from `figures_of`, by the names of `trials.csv`."""
    kinds = {"view": "warped", "view_ceiling": "ceiling", "view_floor": "floor"}
    figures: dict[str, float | None] = {
        f"{name}_psnr_db": float(np.mean([view[kind]["psnr_db"] for view in views])) for name, kind in kinds.items()
    }
    own = ("ws_psnr_db", "ssim", "holes")
    return figures | {f"view_{name}": float(np.mean([view["warped"][name] for view in views])) for name in own}


def _expected_of(outcome: Outcome, pose: Pose) -> tuple[Grey, Mask, Mask]:
    trial = outcome.trial
    sensor, first = trial.assumed_sensors[0], trial.poses[0]
    return _expected(trial.scene, fingerprint(trial.scene), sensor, first, pose, trial.panorama, trial.render.samples)


@lru_cache(maxsize=32)
def _expected(
    scene: Scene,
    _contents: str,  # of the scene's files
    sensor: Sensor,
    pose_1: Pose,
    pose: Pose,
    grid: Grid,
    samples: int,
) -> tuple[Grey, Mask, Mask]:
    """The rendered view on the panorama, the pixels that count, and those that view 1 does not see."""
    looking = directions(grid)
    grey, valid = sample(render(scene, sensor, pose, samples), sensor, looking)
    ground_truth = truth(scene, pose, looking, in_use(sensor, looking), pose_2=pose_1, sensor_2=sensor)
    return np.where(valid, grey, np.float32(np.nan)), valid, valid & ~ground_truth.visible
