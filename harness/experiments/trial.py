"""One trial: the pipeline on one screen, from the scene to the error.

What trials share is computed once: the results of the stages are kept by the settings that they depend on.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.camera.pose import Pose
from harness.camera.sensor import in_field
from harness.errors import InputError
from harness.evaluation.errors import Errors, Reference, errors, reference
from harness.evaluation.metrics import Measures, measure
from harness.evaluation.regions import CellPixels, Layout, Region, layout
from harness.experiments.kept import Kept
from harness.experiments.spec import Trial
from harness.simulation.fingerprint import fingerprint
from harness.simulation.geometry import check_viewpoint, geometry_of
from harness.simulation.noise import generator, with_noise
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import Truth, truth
from harness.stereo.epipolar import Curves
from harness.stereo.filter import laplacian_of_gaussian
from harness.stereo.matching.window import Matches, Reason, WholePixelMatches, match, match_whole_pixels
from harness.stereo.panorama import Grid, Panorama, directions, unwrap
from harness.stereo.ranging import triangulate

Observer = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """All that a trial made. Arrays are on view 1's panorama unless they are said to be images."""

    trial: Trial
    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    """The mirror images of both views, with their noise."""
    panoramas: tuple[Panorama, Panorama]
    """Both in v1's orientation."""
    filtered: tuple[Panorama, Panorama]
    truth: Truth
    whole: WholePixelMatches
    matches: Matches
    range_m: Array
    """Estimated range from view 1; NaN where `reason` is not `Reason.MATCHED`."""
    reason: NDArray[np.uint8]
    """`Reason`: why there is no range."""
    reference: Reference
    layout: Layout
    errors: Errors
    seconds: dict[str, float]
    """Wall time of each stage, in the order of the pipeline."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with an estimate of the range."""
        return np.isfinite(self.range_m)

    @property
    def regions(self) -> tuple[Region, ...]:
        """The parts of the picture that errors are reported by."""
        return self.layout.regions

    @property
    def cells(self) -> tuple[CellPixels, ...]:
        """The cells of surface, direction and range."""
        return self.layout.cells

    def measures(self, domain: NDArray[np.bool_]) -> Measures:
        """The figures of this trial over some pixels."""
        return measure(domain, self.valid, self.errors)


def run_trial(
    trial: Trial,
    kept: Kept | None = None,
    observe: Observer = lambda _: None,
    *,
    threads: int | None = None,
) -> Outcome:
    """Run the whole pipeline with one set of settings.

    Parameters
    ----------
    kept
        Results of stages to share with other trials; the outcome does not depend on it.
    observe
        Called with the name of each stage as it begins.
    threads
        Of one trial; all available CPUs when None. No figure depends on it.

    Raises
    ------
    InputError
        When the scene cannot be seen from where the views stand.
    """
    kept = kept or Kept()
    clock = _Clock(observe)
    motion, grid, poses = trial.motion, trial.panorama, trial.poses
    # A stage's key: the settings that its result depends on, which are those of the stages before it and its own.
    scene = fingerprint(trial.scene)
    pictured = [(scene, trial.sensor, pose, trial.render) for pose in poses]
    taken = [(key, trial.noise, trial.noise.sigma_grey and (trial.seed, view)) for view, key in enumerate(pictured)]
    unwrapped = [(key, grid, trial.unwrap, turned) for key, turned in zip(taken, ((), poses), strict=True)]
    filtered = [(key, trial.filter) for key in unwrapped]
    searched = (*filtered, poses, trial.matching.model_copy(update={"subpixel": "none"}))

    for pose, key in zip(poses, ("trial.view_1.position_m", "trial.view_2"), strict=True):
        _check_view(trial.scene, pose, key)
    with clock("render"):
        pictures = [
            kept.get(
                "render",
                key,
                lambda pose=pose: render(trial.scene, trial.sensor, pose, trial.render.samples, threads),
            )
            for key, pose in zip(pictured, poses, strict=True)
        ]
    with clock("noise"):
        images = [
            kept.get(
                "noise",
                key,
                lambda picture=picture, view=view: with_noise(
                    picture,
                    trial.sensor,
                    trial.noise.sigma_grey,
                    generator(trial.seed, "noise", scene, trial.sensor.model_dump_json(), f"view {view + 1}"),
                ),
            )
            for view, (key, picture) in enumerate(zip(taken, pictures, strict=True))
        ]
    with clock("truth"):
        looking = directions(grid)
        seen = kept.get(
            "truth",
            (scene, trial.sensor, poses, grid),
            lambda: truth(
                trial.scene,
                poses[0],
                looking,
                in_field(trial.sensor, looking),
                pose_2=poses[1],
                sensor_2=trial.sensor,
                threads=threads,
            ),
        )
    with clock("unwrap"):
        rotations = (np.eye(3), motion.R_v2_from_v1)
        panoramas = [
            kept.get(
                "unwrap",
                key,
                lambda image=image, R=R: unwrap(
                    image, trial.sensor, grid, R_sensor_from_panorama=R, interpolation=trial.unwrap.interpolation
                ),
            )
            for key, image, R in zip(unwrapped, images, rotations, strict=True)
        ]
    with clock("filter"):
        answers = [
            kept.get("filter", key, lambda image=image: laplacian_of_gaussian(image, trial.filter.log_sigma_px))
            for key, image in zip(filtered, panoramas, strict=True)
        ]
    with clock("match"):
        whole = kept.get(
            "match",
            searched,
            lambda: match_whole_pixels(answers[0], answers[1], motion.t_v1, trial.matching, threads=threads),
        )
    with clock("sub-pixel"):
        matches = match(whole, trial.matching)
    with clock("range"):
        range_m, _ = triangulate(whole.curves.alpha_1, matches.alpha_2, motion.baseline_m)
        lost = np.isnan(range_m) & (matches.reason == Reason.MATCHED)
        reason = np.where(lost, np.uint8(Reason.BEYOND_INFINITY), matches.reason)
    with clock("score"):
        expected, parts = kept.get(
            "reference",
            (scene, trial.sensor, poses, grid, trial.matching.sampling, trial.matching.pitch_px),
            lambda: _expected(seen, looking, poses[0], grid, whole.curves),
        )
        found = errors(matches.alpha_2, range_m, expected, grid.phi_pitch)
    return Outcome(
        trial=trial,
        images=(images[0], images[1]),
        panoramas=(panoramas[0], panoramas[1]),
        filtered=(answers[0], answers[1]),
        truth=seen,
        whole=whole,
        matches=matches,
        range_m=range_m,
        reason=reason,
        reference=expected,
        layout=parts,
        errors=found,
        seconds=clock.seconds,
    )


def _check_view(scene: Scene, pose: Pose, key: str) -> None:
    """Say which view it is that stands where there is nothing to see."""
    geometry = geometry_of(scene)
    try:
        check_viewpoint(geometry, pose.position_m)
    except InputError as error:
        raise InputError(f"scene {scene.name}: {error.problem}", key=key) from error


def _expected(seen: Truth, looking: Array, pose: Pose, grid: Grid, curves: Curves) -> tuple[Reference, Layout]:
    """All that scoring needs of the truth."""
    expected = reference(seen, looking, curves)
    return expected, layout(expected, seen, grid, looking @ pose.R_world_from_view.T)


class _Clock:
    def __init__(self, observe: Observer) -> None:
        self._observe = observe
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        self._observe(stage)
        begin = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - begin
