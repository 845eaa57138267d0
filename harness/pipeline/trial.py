"""One trial: the pipeline on one screen, from the scene to the error.

What trials share is computed once: the results of the stages are kept by the settings that they depend on.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import in_field
from harness.display import OneLine
from harness.errors import InputError
from harness.evaluation.bound import cramer_rao
from harness.evaluation.errors import Errors, Reference, errors, reference
from harness.evaluation.metrics import Measures, measure
from harness.evaluation.regions import CellPixels, Layout, Region, layout
from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, sample_at
from harness.geometry.panorama import Grid, Panorama, directions
from harness.geometry.pose import Pose
from harness.geometry.triangulation import range_from_angles
from harness.matching.interface import Matches, Reason
from harness.matching.pair import Pair
from harness.matching.registry import match_pair
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import Kept
from harness.simulation.exposure import with_exposure
from harness.simulation.fingerprint import fingerprint
from harness.simulation.geometry import check_viewpoint, geometry_of
from harness.simulation.noise import generator, with_noise
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import Truth, truth

Observer = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True, repr=False)
class Outcome(OneLine):
    """All that a trial made. Arrays are on view 1's panorama unless they are said to be images."""

    trial: Trial
    pair: Pair
    """What the matcher was given."""
    clean: tuple[NDArray[np.float32], NDArray[np.float32]]
    """The mirror images of both views before their noise."""
    truth: Truth
    curves: Curves
    """The epipolar curves that whole samples are counted on."""
    matches: Matches
    range_m: Array
    """Estimated range from view 1; NaN where `reason` is not `Reason.MATCHED`."""
    reason: NDArray[np.uint8]
    """`Reason`: why there is no range."""
    reference: Reference
    layout: Layout
    errors: Errors
    bound_px: Array | None
    """The Cramér-Rao bound of the matcher's own window at a noise of one grey level, pixels of disparity; see
    `bound.cramer_rao`. None where nobody asks for it, or the matcher has no window of its own."""
    seconds: dict[str, float]
    """Wall time of each stage, in the order of the pipeline."""

    @property
    def images(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The mirror images of both views, with their noise."""
        return self.pair.images

    @property
    def panoramas(self) -> tuple[Panorama, Panorama]:
        """Both in v1's orientation."""
        return self.pair.panoramas()

    @property
    def filtered(self) -> tuple[Panorama, Panorama]:
        """The same after the Laplacian of Gaussian."""
        return self.pair.filtered()

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with an estimate of the range."""
        return np.isfinite(self.range_m)

    @property
    def k(self) -> Array:
        """The matches in samples of `curves`, with fractions; NaN where there is no match."""
        found = self.matches
        return sample_at(self.curves, found.alpha_2) if found.k is None else found.k

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
    exposed = [(pictured[0], None), (pictured[1], trial.exposure_2)]
    taken = [(key, trial.noise, trial.noise.sigma_grey and (trial.seed, view)) for view, key in enumerate(exposed)]

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
        second = trial.exposure_2
        clean = (pictures[0], with_exposure(pictures[1], trial.sensor, second.gain, second.offset_grey))
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
            for view, (key, picture) in enumerate(zip(taken, clean, strict=True))
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
    with clock("match"):
        pair = Pair(
            images=(images[0], images[1]),
            sensor=trial.sensor,
            motion=motion,
            grid=grid,
            interpolation=trial.unwrap.interpolation,
            log_sigma_px=trial.filter.log_sigma_px,
            threads=threads,
            keys=(taken[0], taken[1]),
            share=lambda stage, key, make: kept.get(stage, key, lambda: clock.timed(stage, make)),
        )
        matches = match_pair(pair, trial.matching)
    with clock("range"):
        curves = trial.matching.curves(grid, motion.t_v1)
        range_m = range_from_angles(curves.alpha_1, matches.alpha_2, motion.baseline_m)
        lost = np.isnan(range_m) & (matches.reasons == Reason.MATCHED)
        reason = np.where(lost, np.uint8(Reason.BEYOND_INFINITY), matches.reasons)
    with clock("score"):
        expected, parts = kept.get(
            "reference",
            (scene, trial.sensor, poses, grid, trial.matching.sampled(motion.t_v1)),
            lambda: _expected(seen, looking, poses[0], grid, curves),
        )
        found = errors(matches.alpha_2, range_m, expected, grid.phi_pitch)
    bound_px = None
    support = trial.matching.support(trial.filter.log_sigma_px)
    if (trial.scoring.sample_px or trial.scoring.bound) and support is not None:
        with clock("bound"):
            bound_px = kept.get(
                "bound",
                (tuple(exposed), grid, support),
                lambda: (
                    cramer_rao(
                        clean,
                        trial.sensor,
                        motion,
                        grid,
                        seen,
                        R_world_from_v1=poses[0].R_world_from_view,
                        window_px=min(support.window_px, grid.height_px - 1 | 1),
                        sigma_grey=1.0,
                        model=support.model,
                        frame=support.frame,
                    ).disparity_px
                ),
            )
    return Outcome(
        trial=trial,
        pair=pair,
        clean=clean,
        truth=seen,
        curves=curves,
        matches=matches,
        range_m=range_m,
        reason=reason,
        reference=expected,
        layout=parts,
        errors=found,
        bound_px=bound_px,
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
    """Seconds of each stage, without those of the stages inside it."""

    def __init__(self, observe: Observer) -> None:
        self._observe = observe
        self._inside = [0.0]
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        self._observe(stage)
        self._inside.append(0.0)
        begin = time.perf_counter()
        yield
        took = time.perf_counter() - begin
        self.seconds[stage] = self.seconds.get(stage, 0.0) + took - self._inside.pop()
        self._inside[-1] += took

    def timed(self, stage: str, make: Callable[[], T]) -> T:
        """What `make` returns, its time counted for this stage."""
        with self(stage):
            return make()
