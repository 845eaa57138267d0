"""One trial: its stages, from the scene to the error, and their results."""

from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import in_use
from harness.display import OneLine
from harness.errors import InputError
from harness.evaluation.bound import cramer_rao
from harness.evaluation.metrics import Measures, measure
from harness.evaluation.pixel_errors import Errors, Reference, errors, reference
from harness.evaluation.regions import CellPixels, Layout, Region, layout
from harness.geometry.angles import Array
from harness.geometry.epipolar import Curves, sample_at
from harness.geometry.panorama import Panorama, directions
from harness.geometry.pose import Motion, Pose
from harness.matching.interface import Matches, Support
from harness.matching.pair import Bands, Pair
from harness.matching.ranges import ranges_of
from harness.pipeline.estimated_motion import MotionOfImages, motion_of_images
from harness.pipeline.sight import check_sight
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.stages import Observer, Setup, Stage, StageKeys, Work, setup_of
from harness.simulation.chip import captured, expected_grey, grey_variance
from harness.simulation.exposure import with_exposure
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator, with_noise, words_of
from harness.simulation.optics import with_optics
from harness.simulation.render import render
from harness.simulation.scene_geometry import check_viewpoint, geometry_near
from harness.simulation.truth import Surfaces, Truth, surfaces, truth

Image = NDArray[np.float32]
"""`[sensor height, sensor width]`, grey levels of 0 .. 255."""


@dataclass(frozen=True, repr=False)
class Outcome(OneLine):
    """All results of a trial. Arrays are on view 1's panorama unless stated otherwise."""

    trial: Trial
    pair: Pair
    """The matcher's input."""
    clean: tuple[NDArray[np.float32], NDArray[np.float32]]
    """The light on the chip of both views: the mirror images before their noise."""
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
    estimated: MotionOfImages | None
    """The motion that the matcher was given, where it was estimated."""
    bound_px: Array | None
    """The Cramér-Rao bound of the matcher's own window, pixels of disparity, in units of `Trial.bound_noise_grey`; see
    `bound.cramer_rao`. None where it is not requested, or the matcher has no window of its own."""
    seconds: dict[str, float]
    """Wall time of each stage, in the order of the pipeline."""

    @property
    def images(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The mirror images of both views, with their noise."""
        return self.pair.images

    @property
    def panoramas(self) -> tuple[Panorama, Panorama]:
        """The panoramas of both views, in v1's orientation."""
        return self.pair.panoramas()

    @property
    def filtered(self) -> tuple[Panorama, Panorama]:
        """The panoramas after the Laplacian of Gaussian."""
        return self.pair.filtered()

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with an estimate of the range."""
        return np.isfinite(self.range_m)

    @property
    def k(self) -> Array:
        """The matches in samples of `curves`, with fractions; NaN where there is no match."""
        matches = self.matches
        return sample_at(self.curves, matches.alpha_2) if matches.k is None else matches.k

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


# --- The stages ---------------------------------------------------------------------------------------------------


def _render(work: Work, view: int) -> Image:
    trial, pose = work.trial, work.setup.poses[view]
    image = render(trial.scene, trial.sensors[view], pose, trial.render.samples, work.threads)
    _refuse_changed_scene(work)
    return image


def _refuse_changed_scene(work: Work) -> None:
    """Refuse a scene whose files changed: results are cached under the fingerprint from the trial's beginning."""
    if fingerprint(work.trial.scene) != work.setup.scene:
        raise InputError("a file of the scene changed while the trial ran; run it again", file=work.scene_name)


def _rendered_from(setup: Setup, view: int) -> Hashable:
    """The key of a render: all that the image depends on, including a camera model's code, as renders are stored."""
    sensor = setup.trial.sensors[view]
    made_from = (setup.scene, sensor, setup.poses[view], setup.trial.render)
    identity = sensor.model.identity()
    return (*made_from, identity) if identity else made_from


RENDER = Stage("render", _render, _rendered_from, per_view=True)
"""The mirror image of a view."""


def _expose(work: Work, view: int) -> Image:
    return _exposed(work, view, work(RENDER, view))


def _exposed(work: Work, view: int, image: Image) -> Image:
    trial = work.trial
    sensor, exposure = trial.sensors[view], trial.exposure_2
    image = with_optics(image, sensor, trial.lenses[view])
    exposed = with_exposure(image, sensor, exposure.gain, exposure.offset_grey) if view else image
    return _finite(exposed, work, "trial.exposure_2")


EXPOSURE = Stage(
    "exposure",
    _expose,
    lambda setup, view: (setup.trial.lenses[view], setup.trial.exposure_2 if view else None),
    after=(RENDER,),
    per_view=True,
)
"""The light on the chip: through the lens, and exposed."""


def _add_noise(work: Work, view: int) -> Image:
    return _noisy(work, view, work(EXPOSURE, view))


def _noisy(work: Work, view: int, light: Image, band: str = "") -> Image:
    """The image that the chip captured of the light; the noise of each `band` of colours is drawn by itself."""
    trial, setup = work.trial, work.setup
    sensor = trial.sensors[view]
    # Named by the aligned sensor: trials that differ in the misalignment alone have the same draws.
    white, shot = (
        generator(trial.seed, purpose, setup.scene, words_of(sensor.aligned), f"view {view + 1}{band}")
        for purpose in ("noise", "shot noise")
    )
    sigma_grey = trial.noise.sigma_grey
    if trial.chip.is_ideal:
        return _finite(with_noise(light, sensor, sigma_grey, white), work, "trial.noise")
    return _finite(captured(light, sensor, trial.chip, sigma_grey, shot, white), work, "trial.chip")


def _noise_settings(setup: Setup, view: int) -> Hashable:
    trial = setup.trial
    return trial.noise, trial.chip, (trial.seed, view) if trial.is_noisy else 0


NOISE = Stage("noise", _add_noise, _noise_settings, after=(EXPOSURE,), per_view=True)
"""The mirror image that the chip captured, with its noise."""


def _colour(work: Work, view: int) -> Bands:
    trial = work.trial
    sensor, pose = trial.sensors[view], work.setup.poses[view]
    image = render(trial.scene, sensor, pose, trial.render.samples, work.threads, colour=True)
    _refuse_changed_scene(work)
    red, green, blue = (
        _noisy(work, view, _exposed(work, view, np.ascontiguousarray(image[..., i])), f" {band}")
        for i, band in enumerate(("red", "green", "blue"))
    )
    return red, green, blue


def _colour_settings(setup: Setup, view: int) -> Hashable:
    trial = setup.trial
    light = _rendered_from(setup, view), trial.lenses[view], trial.exposure_2 if view else None
    return light, _noise_settings(setup, view)


COLOUR = Stage("colour", _colour, _colour_settings, per_view=True)
"""Red, green and blue of a view, rendered, exposed and with noise of their own; for matchers that ask for them."""


def _surfaces(work: Work, _view: int) -> Surfaces:
    trial = work.trial
    looking = directions(trial.panorama)
    inside = in_use(trial.assumed_sensors[0], looking)
    result = surfaces(trial.scene, work.setup.poses[0], looking, inside, threads=work.threads)
    _refuse_changed_scene(work)
    return result


SURFACES = Stage(
    "surfaces",
    _surfaces,
    lambda setup, _view: (setup.scene, setup.trial.assumed_sensors[0], setup.poses[0], setup.trial.panorama),
)
"""What view 1 sees along every direction of its panorama, the same wherever view 2 is."""


def _truth(work: Work, _view: int) -> Truth:
    trial, (pose_1, pose_2) = work.trial, work.setup.poses
    first, second = trial.assumed_sensors
    looking = directions(trial.panorama)
    result = truth(
        trial.scene, pose_1, looking, in_use(first, looking),
        pose_2=pose_2, sensor_2=second, threads=work.threads, seen=work(SURFACES),
    )  # fmt: skip
    _refuse_changed_scene(work)
    return result


TRUTH = Stage("truth", _truth, lambda setup, _view: (setup.trial.assumed_sensors[1], setup.poses[1]), after=(SURFACES,))
"""The ground truth along every direction of view 1's panorama: what the instrument should say, whatever a misaligned
sensor has seen there."""


def _estimate_motion(work: Work, _view: int) -> MotionOfImages | None:
    if work.trial.motion.source == "truth":
        return None
    images, sensors = work.both(NOISE), work.setup.assumed.sensors
    return motion_of_images(images, sensors, work.setup.motion.baseline_m, "trial.motion.source")


MOTION = Stage(
    "motion",
    _estimate_motion,
    lambda setup, _view: (setup.trial.motion, setup.assumed.sensors, setup.motion.baseline_m),
    after=(NOISE,),
)
"""The motion estimated from the images; None where the matcher is given the true one."""


def _given_motion(work: Work) -> Motion:
    """The motion that the matcher is given."""
    if work.trial.motion.source == "truth":  # the motion is known: the stage takes no time
        return work.setup.assumed.motion
    estimated = work(MOTION)
    assert estimated is not None
    return estimated.motion


def _pair(work: Work, _view: int) -> Pair:
    trial, assumed = work.trial, work.setup.assumed
    return Pair(
        images=work.both(NOISE),
        sensors=assumed.sensors,
        motion=_given_motion(work),
        grid=trial.panorama,
        interpolation=trial.unwrap.interpolation,
        log_sigma_px=trial.filter.log_sigma_px,
        threads=work.threads,
        keys=(work.keys.of(NOISE, 0), work.keys.of(NOISE, 1)),
        share=work.share,
        bands=partial(work, COLOUR),
    )


def _pair_settings(setup: Setup, _view: int) -> Hashable:
    assumed, trial = setup.assumed, setup.trial
    motion = assumed.motion.R_v2_from_v1.tobytes(), assumed.motion.t_v1.tobytes()
    return assumed.sensors, motion, trial.panorama, trial.unwrap, trial.filter


PAIR = Stage("pair", _pair, _pair_settings, after=(NOISE, MOTION), cached=False)
"""The matcher's input: the images, and the sensor and motion that it assumes. Its parts are cached one by one."""

MATCH = Stage(
    "match",
    lambda work, _view: work.trial.matching.match(work(PAIR)),
    lambda setup, _view: setup.trial.matching,
    after=(PAIR,),
    cached=False,
)
"""The matcher's answer. Matchers share their parts through the pair."""


def _range(work: Work, _view: int) -> tuple[Array, NDArray[np.uint8]]:
    matches, motion = work(MATCH), _given_motion(work)
    return ranges_of(matches, _curves(work.trial, motion).alpha_1, motion.baseline_m)


RANGE = Stage("range", _range, after=(MATCH,), cached=False)
"""Range and reasons, triangulated with the motion that the matcher assumes."""


def _reference(work: Work, _view: int) -> tuple[Reference, Layout]:
    trial, setup = work.trial, work.setup
    looking = directions(trial.panorama)
    expected = reference(work(TRUTH), looking, _curves(trial, setup.motion))
    world = looking @ setup.poses[0].R_world_from_view.T
    return expected, layout(expected, work(TRUTH), trial.panorama, world)


def _curves(trial: Trial, motion: Motion) -> Curves:
    return trial.matching.curves(trial.panorama, motion.t_v1)


REFERENCE = Stage(
    "reference", _reference, lambda setup, _view: setup.trial.matching.sampled(setup.motion.t_v1), after=(TRUTH,)
)
"""The truth in the matcher's terms, and the parts of the picture that errors are reported by."""


def _score(work: Work, _view: int) -> Errors:
    expected, _ = work(REFERENCE)
    range_m, _ = work(RANGE)
    return errors(work(MATCH).alpha_2, range_m, expected, work.trial.panorama.phi_pitch)


SCORE = Stage("score", _score, after=(RANGE, REFERENCE), cached=False)
"""Errors, pixel by pixel."""


def _bound(work: Work, _view: int) -> Array | None:
    trial, setup = work.trial, work.setup
    support = _support(trial)
    if support is None:
        return None
    light, sigma_grey = work.both(EXPOSURE), trial.noise.sigma_grey
    noise: float | tuple[Array, Array] = 1.0
    if not trial.chip.is_ideal:
        first, second = (np.sqrt(grey_variance(each, trial.chip, sigma_grey)) for each in light)
        noise = first, second
    return cramer_rao(
        (expected_grey(light[0], trial.chip), expected_grey(light[1], trial.chip)),
        trial.assumed_sensors,
        setup.motion,
        trial.panorama,
        work(TRUTH),
        R_world_from_v1=setup.poses[0].R_world_from_view,
        window_px=min(support.window_px, _odd_up_to(trial.panorama.height_px)),
        sigma_grey=noise,
        model=support.model,
        frame=support.frame,
    ).disparity_px


def _support(trial: Trial) -> Support | None:
    """The pixels that a match is made from, if the bound is requested."""
    is_requested = trial.scoring.sample_px or trial.scoring.bound
    return trial.matching.support(trial.filter.log_sigma_px) if is_requested else None


def _odd_up_to(number: int) -> int:
    """The largest odd number up to another one."""
    return number if number % 2 else number - 1


def _bound_settings(setup: Setup, _view: int) -> Hashable:
    trial = setup.trial
    return _support(trial), None if trial.chip.is_ideal else (trial.chip, trial.noise)


BOUND = Stage("bound", _bound, _bound_settings, after=(EXPOSURE, TRUTH))
"""The Cramér-Rao bound of the matcher's own window."""

STAGES: tuple[Stage[Any], ...] = (
    RENDER, EXPOSURE, NOISE, COLOUR, SURFACES, TRUTH, MOTION, PAIR, MATCH, RANGE, REFERENCE, SCORE, BOUND
)  # fmt: skip
"""All stages, in the order of the pipeline."""

_ORDERED_BY = (RENDER, TRUTH, NOISE, PAIR)
"""The stages by which trials are ordered; then by the matcher's search."""


def sharing_keys(trial: Trial) -> dict[str, Hashable]:
    """For each stage, in the pipeline's order, a key: trials with equal keys can share the stages up to it."""
    keys = StageKeys(setup_of(trial))
    shared: dict[str, Hashable] = {
        stage.name: tuple(keys.of(stage, view) for view in stage.views) for stage in _ORDERED_BY
    }
    return shared | {MATCH.name: (shared[PAIR.name], trial.matching.search)}


# --- All of them --------------------------------------------------------------------------------------------------


def run_trial(
    trial: Trial,
    cache: StageCache | None = None,
    observe: Observer = lambda _: None,
    *,
    threads: int | None = None,
    answer: Matches | None = None,
    scene_file: str = "",
) -> Outcome:
    """Run the whole pipeline with one set of settings.

    Parameters
    ----------
    cache
        Results of stages to share with other trials; the outcome does not depend on it.
    observe
        Called with the name of each stage as it begins.
    threads
        Threads of one trial; all available CPUs when None. No figure depends on it.
    answer
        The matcher's stored answer to these settings; it is not run then.
    scene_file
        Where the scene was read from, for messages.

    Raises
    ------
    InputError
        When the scene cannot be seen from where the views stand, or nothing can be matched.
    """
    work = Work(trial, cache or StageCache(), observe, threads, scene_file)
    with _naming_scene_file(work):
        return _outcome_of(work, answer)


def _outcome_of(work: Work, answer: Matches | None) -> Outcome:
    trial = work.trial
    for pose, key in zip(work.setup.poses, ("trial.view_1.position_m", "trial.view_2"), strict=True):
        _check_view(work, pose, key)
    check_sight(trial, work.setup.assumed.motion)
    if answer is not None:
        work.give(MATCH, answer)
    work.both(RENDER)
    pair, true_view, matches = work(PAIR), work(TRUTH), work(MATCH)
    range_m, reason = work(RANGE)
    scored = work(SCORE)
    expected, parts = work(REFERENCE)
    return Outcome(
        trial=trial,
        pair=pair,
        clean=work.both(EXPOSURE),
        truth=true_view,
        curves=_curves(trial, work.setup.motion),
        matches=matches,
        range_m=range_m,
        reason=reason,
        reference=expected,
        layout=parts,
        errors=scored,
        estimated=None if trial.motion.source == "truth" else work(MOTION),
        bound_px=None if _support(trial) is None else work(BOUND),
        seconds=work.clock.seconds,
    )


def _finite(image: Image, work: Work, key: str) -> Image:
    """The image, refused where a grey level is not a finite number: a matcher would take it for a surface."""
    if not np.isfinite(image).all():
        count = np.count_nonzero(~np.isfinite(image))
        raise InputError(f"{work.scene_name}: {count} pixels have a grey level that is not a finite number", key=key)
    return image


def _check_view(work: Work, pose: Pose, key: str) -> None:
    """Refuse a view from a position where there is nothing to see, and name it."""
    geometry = geometry_near(work.trial.scene, pose.position_m)
    try:
        check_viewpoint(geometry, pose.position_m - geometry.centre)
    except InputError as error:
        raise InputError(f"{work.scene_name}: {error.problem}", key=key) from error


@contextmanager
def _naming_scene_file(work: Work) -> Iterator[None]:
    """A context in which errors about the scene name the file that it was read from, and its key."""
    try:
        yield
    except InputError as error:
        if error.file != work.trial.scene.name:  # that of a mesh or an image
            raise
        raise InputError(f"{work.scene_name}: {error.problem}", key="trial.scene") from error
