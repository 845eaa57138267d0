"""Stages: the dependencies and the work of each step of a trial, declared once.

A stage's key is made of the settings that it reads itself and of the keys of the stages before it. From the
declarations follow what trials can share (results with equal keys), the order in which trials are best run, and what
is timed; none of them is written down a second time.
"""

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

from harness.camera.sensor import Sensor
from harness.evaluation.propagation import Rig
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.pipeline.believed import believed_rig, calibrated
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.simulation.fingerprint import fingerprint
from harness.simulation.scene import Scene

Observer = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Assumed:
    """The calibration and motion that the matcher assumes. Images come from the true ones, which may differ."""

    sensors: tuple[Sensor, Sensor]
    """The sensor of each view."""
    motion: Motion
    """The motion from view 1 to view 2."""


@dataclass(frozen=True)
class Setup:
    """A trial's settings, and what follows from them before anything is rendered."""

    trial: Trial
    scene: str
    """The scene's `fingerprint`, which represents its contents in a key."""
    poses: tuple[Pose, Pose]
    """The true poses of both views."""
    motion: Motion
    """The true motion from view 1 to view 2."""
    assumed: Assumed


def setup_of(trial: Trial) -> Setup:
    """The setup of a trial. The matcher assumes the true rig except for a misalignment and `trial.believed`."""
    poses = trial.poses
    motion = relative_motion(*poses)
    central = calibrated(Rig(trial.sensors, motion), trial.believed)
    believed = believed_rig(central, trial.believed, trial.belief_draws)
    return Setup(trial, fingerprint(trial.scene), poses, motion, Assumed(believed.sensors, believed.motion))


def _none(_setup: Setup, _view: int) -> Hashable:
    return None


@dataclass(frozen=True, eq=False)
class Stage(Generic[T]):
    """One step of a trial.

    Parameters
    ----------
    name
        Its time is counted under this name, too.
    run
        `run(work, view)`: the result, made of the results of the stages before it.
    settings
        `settings(setup, view)`: all that `run` reads of the trial itself, as a hashable value.
    after
        The stages whose results `run` reads.
    per_view
        There is one result for each view; `view` is 0 or 1. Otherwise there is one for the pair, and `view` is 0.
    cached
        Whether results are kept for other trials. What costs nothing to make, or is kept by parts, is not.
    """

    name: str
    run: "Callable[[Work, int], T]"
    settings: Callable[[Setup, int], Hashable] = _none
    after: "tuple[Stage[Any], ...]" = ()
    per_view: bool = False
    cached: bool = True

    @property
    def views(self) -> tuple[int, ...]:
        """The views that have a result of their own."""
        return (0, 1) if self.per_view else (0,)


class StageKeys:
    """The keys of a trial's stages, each made once."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._keys: dict[tuple[Stage[Any], int], Hashable] = {}

    def of(self, stage: Stage[Any], view: int = 0) -> Hashable:
        """The key of a stage's result, from all that it depends on: two trials with equal keys have equal results."""
        if (stage, view) not in self._keys:
            before = (
                self.of(each, which)
                for each in stage.after
                for which in ((view,) if stage.per_view and each.per_view else each.views)
            )
            self._keys[stage, view] = (stage.name, stage.settings(self.setup, view), *before)
        return self._keys[stage, view]


def scene_in_words(scene: Scene, file: str) -> str:
    """The scene with the file that it was read from, if there is one, for messages."""
    return f"scene {scene.name}" + (f" ({file})" if file else "")


class Work:
    """A trial as it runs: it asks for results of stages, which are made when they are first needed.

    Parameters
    ----------
    cache
        Results to share with other trials; no result depends on it.
    observe
        Called with the name of each stage as it begins.
    threads
        Most threads to use; all available CPUs when None. No result depends on it.
    scene_file
        Where the scene was read from, for messages.
    """

    def __init__(
        self,
        trial: Trial,
        cache: StageCache,
        observe: Observer = lambda _: None,
        threads: int | None = None,
        scene_file: str = "",
    ) -> None:
        self.trial = trial
        self.scene_name = scene_in_words(trial.scene, scene_file)
        self.setup = setup_of(trial)
        self.keys = StageKeys(self.setup)
        self.threads = threads
        self.clock = Clock(observe)
        self._cache = cache
        self._results: dict[tuple[Stage[Any], int], Any] = {}

    def __call__(self, stage: Stage[T], view: int = 0) -> T:
        """The result of a stage."""
        if (stage, view) not in self._results:
            with self.clock(stage.name):
                if stage.cached:
                    result = self._cache.get(stage.name, self.keys.of(stage, view), lambda: stage.run(self, view))
                else:
                    result = stage.run(self, view)
            self._results[stage, view] = result
        return cast("T", self._results[stage, view])

    def give(self, stage: Stage[T], result: T) -> None:
        """Set a result that is already known; the stage is not run."""
        self._results[stage, 0] = result

    def both(self, stage: Stage[T]) -> tuple[T, T]:
        """The results of a stage for both views."""
        return self(stage, 0), self(stage, 1)

    def share(self, name: str, key: Hashable, make: Callable[[], Any]) -> Any:
        """A part of a stage that other trials may share, timed by itself; see `pair.Share`."""
        return self._cache.get(name, key, lambda: self.clock.timed(name, make))


class Clock:
    """Seconds of each stage, without those of the stages inside it."""

    def __init__(self, observe: Observer) -> None:
        self._observe = observe
        self._inside = [0.0]
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """A context whose time counts for this stage."""
        self._observe(stage)
        self._inside.append(0.0)
        begin = time.perf_counter()
        yield
        took = time.perf_counter() - begin
        self.seconds[stage] = self.seconds.get(stage, 0.0) + took - self._inside.pop()
        self._inside[-1] += took

    def timed(self, stage: str, make: Callable[[], T]) -> T:
        """The result of `make`, its time counted for this stage."""
        with self(stage):
            return make()
