"""What trials share: the results of the stages, kept by the settings that each depends on."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Protocol, TypeVar, cast

from harness.pipeline.specification import Trial
from harness.simulation.fingerprint import fingerprint
from harness.spec import Spec

T = TypeVar("T")

LIMITS = {"render": 4, "noise": 4, "unwrap": 4, "filter": 4}
"""How many results of a stage are kept, two views a trial; of any other stage `OTHERS`, as they may be large."""
OTHERS = 2


class Source(Protocol):
    """A slower place in which the results of a stage may lie, such as a disk."""

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result with this key, made if it is not there."""


class Kept:
    """The latest results of the stages; the one not used for longest goes first.

    Parameters
    ----------
    limits
        How many results are kept of the stages named; `OTHERS` of all others.
    beneath
        Where the results of a stage are looked for before they are made.
    """

    def __init__(self, limits: Mapping[str, int] = LIMITS, beneath: Mapping[str, Source] | None = None) -> None:
        self._limits = limits
        self._beneath = beneath or {}
        self._results: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, stage: str, key: Hashable, make: Callable[..., T]) -> T:
        """The result of a stage with these settings, made if it is not there."""
        results = self._results.setdefault(stage, OrderedDict())
        if key not in results:
            if len(results) >= self._limits.get(stage, OTHERS):
                results.popitem(last=False)  # before the new one is made: two cost volumes need not fit
            source = self._beneath.get(stage)
            results[key] = make() if source is None else source.get(key, make)
        results.move_to_end(key)
        return cast("T", results[key])


def geometry_key(trial: Trial) -> tuple[Hashable, ...]:
    """What the renders of both views depend on, and with the panorama's grid the truth."""
    return fingerprint(trial.scene), trial.sensor, trial.poses, trial.render, trial.panorama


def sharing_keys(trial: Trial) -> dict[str, Hashable]:
    """Which trials can share the stages up to each of these: those with equal keys. In the order of the pipeline."""
    geometry = geometry_key(trial)
    noise = (geometry, trial.exposure_2, trial.noise, trial.seed if trial.noise.sigma_grey else None)
    filtered = (noise, trial.unwrap, trial.filter)
    matching: Spec = trial.matching
    if "subpixel" in type(matching).model_fields:
        matching = matching.model_copy(update={"subpixel": "none"})
    return {"render": geometry, "noise": noise, "filter": filtered, "match": (filtered, matching)}
