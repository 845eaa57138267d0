"""The trials that a report shows in detail: the base trial by each method, pixel by pixel.

The matchers' results are stored in the run's file. A report is made from them, and runs no third-party code.
"""

import contextlib
import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from harness import interrupts
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.matching.interface import Matches, as_matches
from harness.matching.registry import method_of
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome
from harness.renamed import up_to_date
from harness.runs import worker
from harness.runs.cases import NAME, settings_of
from harness.runs.dotted import changed
from harness.runs.experiment import Experiment, Planned
from harness.runs.methods import MethodName
from harness.runs.recorded import RecordedExperiment
from harness.runs.store import Store
from harness.simulation.fingerprint import fingerprint
from harness.spec import as_given, as_table, parse

MOST_DETAILS = 6
"""The most methods shown in detail: their maps and profiles still fit a page."""

_FACT = "details"


@dataclass(frozen=True)
class LeftOut:
    """A method that should be shown in detail and is not."""

    matcher: str
    reason: str


@dataclass(frozen=True)
class Details:
    """The trials in detail."""

    trials: list[Trial]
    """All trials that should be shown."""
    keys: list[str]
    outcomes: list[Outcome]
    """The outcomes of the trials that are shown, and their keys."""
    left_out: list[LeftOut]
    comparison: dict[str, Any] | None
    """The methods' comparison for `summary.json`, as stored with the run; None if it is still to be computed."""


@dataclass(frozen=True)
class Made:
    """An outcome that is there before it is asked for."""

    outcome: Outcome
    packed: bytes
    """What `packed` makes of its matches."""


Beforehand = Mapping[str, Made]
"""Outcomes of the base trial by each method, by the trials' keys."""


def made_beforehand(experiment: Experiment, made: dict[str, Made]) -> Iterator[None]:
    """Run the base trial by each method, in steps: while workers run the other trials.

    Without methods that fail, and matchers that are not part of this program.
    """
    for trial in _by_each_method(experiment, experiment.trial):
        if not trial.matching.runs_third_party_code:
            try:
                outcome = worker.run_here(trial, threads=1)
                yield
                made[trial.key] = Made(outcome, packed(outcome.matches))
            except Exception:  # noqa: BLE001 - it is run again where its failure is told
                interrupts.check()
            yield


def _by_each_method(experiment: Experiment, base: Trial) -> list[Trial]:
    """A trial by each of the first methods of an experiment."""
    # A case that names a method is shown with all settings that it gives the matcher.
    matchings = {name: _matching_of_case(experiment, case) for name, case in experiment.method_labels.items()}
    return [
        base.model_copy(update={"matching": matchings[name]}) if name in matchings else with_method(base, trial)
        for name, trial in list(_methods(experiment).items())[:MOST_DETAILS]
    ]


def _methods(experiment: Experiment) -> dict[MethodName, Trial]:
    """The first trial of each method."""
    methods: dict[MethodName, Trial] = {}
    for each in experiment.planned:
        methods.setdefault(each.method, each.trial)
    return methods


def details_of(
    experiment: Experiment,
    done: list[Planned],
    store: Store | None = None,
    *,
    run_code: bool = True,
    beforehand: Beforehand = MappingProxyType({}),
) -> Details:
    """Run the trials to be shown; matching itself only where its result is not stored.

    A method that fails is left out. If every method fails on the base trial, the first finished trial replaces it.

    Parameters
    ----------
    done
        The trials that are done.
    store
        The run's file, which stores the results; None for a run in memory.
    run_code
        Whether matchers may be run that are not part of this program.
    beforehand
        Those of `made_beforehand`.
    """
    stored = _Stored(experiment, store)
    beyond = [
        LeftOut(
            experiment.method_labels.get(name, _label(name)),
            f"at most {MOST_DETAILS} methods are compared pixel by pixel; trials.csv has its figures",
        )
        for name in list(_methods(experiment))[MOST_DETAILS:]
    ]
    details = Details([], [], [], [], None)
    for base in dict.fromkeys((experiment.trial, done[0].trial)):
        trials = _by_each_method(experiment, base)
        attempts = [
            (trial.key, beforehand[trial.key].outcome)
            if beforehand and trial.key in beforehand
            else stored.outcome_of(trial, run_code=run_code)
            for trial in trials
        ]
        shown = [attempt for attempt in attempts if not isinstance(attempt, LeftOut)]
        missing = [*(attempt for attempt in attempts if isinstance(attempt, LeftOut)), *beyond]
        if shown or not details.trials:
            details = Details(trials, [key for key, _ in shown], [outcome for _, outcome in shown], missing, None)
        if shown:
            break
    if stored.comparison and (details.left_out or (store and store.other_code)):
        details = Details(details.trials, details.keys, details.outcomes, details.left_out, stored.comparison)
    return details


def _matching_of_case(experiment: Experiment, name: str) -> Any:
    """The matcher of the base trial with the settings of a case."""
    case = next(case for case in experiment.cases if case[NAME] == name)
    return parse(Trial, changed(as_given(experiment.trial), settings_of(case))).matching


def _label(method: MethodName) -> str:
    """A method's matcher, and its sub-pixel step if it has one."""
    return " ".join(each for each in method if each not in {"own", "none"})


def keep(
    details: Details,
    comparison: dict[str, Any],
    experiment: Experiment,
    store: Store,
    beforehand: Beforehand = MappingProxyType({}),
) -> None:
    """Store the results of the trials shown in a run's file, with their comparison."""
    if details.left_out and isinstance(experiment, RecordedExperiment):
        return  # the stored results are more complete than these
    trials = [
        {"key": key, "scene": fingerprint(outcome.trial.scene), "trial": as_table(outcome.trial)}
        for key, outcome in zip(details.keys, details.outcomes, strict=True)
    ]
    fact = {"plan": _plan_hash(experiment), "trials": trials, "comparison": comparison}
    if store.fact(_FACT) != fact:
        pairs = zip(details.keys, details.outcomes, strict=True)
        store.set_answers(
            {key: beforehand[key].packed if key in beforehand else packed(outcome.matches) for key, outcome in pairs}
        )
        store.set_fact(_FACT, fact)


class _Stored:
    """The trials shown in detail, as stored in a run's file."""

    def __init__(self, experiment: Experiment, store: Store | None) -> None:
        self._store = store
        self._recorded = isinstance(experiment, RecordedExperiment)
        self._scenes = experiment.scene_fingerprints
        fact = store.fact(_FACT) if store else None
        self.comparison: dict[str, Any] | None = None
        self._keys_of_trials: list[tuple[Trial, str, str]] = []
        with contextlib.suppress(KeyError, TypeError, InputError):  # a file that was edited by hand: ignore its details
            # The experiment may have been planned again since, with other files of a matcher.
            if fact and (not self._recorded or fact["plan"] == _plan_hash(experiment)):
                tables = [up_to_date(Trial, each["trial"])[0] for each in fact["trials"]]
                self._keys_of_trials = [
                    (parse(Trial, table), each["key"], each["scene"])
                    for table, each in zip(tables, fact["trials"], strict=True)
                ]
                self.comparison = fact["comparison"] if self._recorded else None

    def outcome_of(self, trial: Trial, *, run_code: bool) -> tuple[str, Outcome] | LeftOut:
        """A trial's key and outcome, or the reason why there is no outcome."""
        name = _label(method_of(trial.matching))
        earlier = next(((key, scene) for each, key, scene in self._keys_of_trials if each == trial), None)
        try:
            scene = fingerprint(trial.scene)
            if self._recorded and (scene != earlier[1] if earlier else scene not in self._scenes):
                return LeftOut(name, "the files of its scene have changed since the run was made")
            key = earlier[0] if earlier and self._recorded else trial.key
            answer = self._answer(key, trial.panorama) if earlier and earlier[0] == key else None
            if answer is None and trial.matching.runs_third_party_code and not run_code:
                why = "its matcher is not part of omnirange and its result is not stored; --run-code allows it to run"
                return LeftOut(name, why)
            return key, worker.run_here(trial, answer=answer)
        except Exception as error:  # noqa: BLE001 - its rows say why; the others are shown all the same
            interrupts.check()  # Ctrl-C may come wrapped as another error
            reason = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            return LeftOut(name, " ".join(reason.split())[:500])

    def _answer(self, key: str, grid: Grid) -> Matches | None:
        data = self._store.answer(key) if self._store else None
        return None if data is None else unpacked(data, grid)


def with_method(base: Trial, other: Trial) -> Trial:
    """The base trial with the matcher of another one; it keeps its own settings where both matchers have them."""
    matching = other.matching
    if type(matching) is type(base.matching) and isinstance(matching, WindowMatcher):
        mixed = base.matching.model_dump() | {"kind": matching.kind, "subpixel": matching.subpixel}
        with contextlib.suppress(ValueError):  # this kind rejects the settings: keep its own
            matching = WindowMatcher.model_validate(mixed)
    return base.model_copy(update={"matching": matching})


def _plan_hash(experiment: Experiment) -> str:
    keys = json.dumps([each.key for each in experiment.planned])
    return hashlib.sha256(keys.encode()).hexdigest()


# --- Answers as bytes ---------------------------------------------------------------------------------------------

_ARRAYS = ("alpha_2", "confidence", "sigma_alpha_2", "reason", "refined", "k")


def packed(matches: Matches) -> bytes:
    """A matcher's result as a compressed NPZ archive of its arrays."""
    arrays = {name: array for name in _ARRAYS if (array := getattr(matches, name)) is not None}
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def unpacked(data: bytes, grid: Grid) -> Matches | None:
    """The result that was packed; None where the bytes are not one on this panorama.

    Nothing in an archive is taken on trust: no pickle, no array larger than the panorama asks for.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if any(each.file_size > 8 * grid.shape[0] * grid.shape[1] + 4096 for each in archive.infolist()):
                return None
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            known = {name: arrays[name] for name in _ARRAYS if name in arrays.files}
        return as_matches(Matches(**known), grid, "the answer")
    except (zipfile.BadZipFile, OSError, ValueError, TypeError, EOFError, MemoryError, InputError, KeyError):
        return None
