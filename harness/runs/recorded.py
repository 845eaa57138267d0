"""An experiment as a run's file holds it, so that a run can be reported on without being planned again.

To plan an experiment is to look at its scenes' files and to load its matchers. Whoever reads somebody else's run
must do neither: the keys, coordinates and settings of all trials are written down when the run begins.
"""

import json
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr

from harness.errors import InputError
from harness.pipeline.specification import Trial
from harness.renamed import DottedKeys, dotted_up_to_date, up_to_date
from harness.runs.experiment import Experiment, Planned, with_case_keys
from harness.runs.store import Store
from harness.spec import Spec, as_given, as_table, parse

_EXPERIMENT, _PLAN = "experiment", "plan"


class RecordedExperiment(Experiment):
    """An experiment whose trials are those recorded in a run's file."""

    _planned: tuple[Planned, ...] = PrivateAttr(default=())
    _scenes: frozenset[str] = PrivateAttr(default=frozenset())

    @cached_property
    def planned(self) -> tuple[Planned, ...]:
        """The trials as they were planned when the run began; no file is read again."""
        return self._planned

    @cached_property
    def scene_fingerprints(self) -> frozenset[str]:
        """The scenes' fingerprints at the time of the run."""
        return self._scenes

    def with_plan(self, planned: tuple[Planned, ...], scenes: frozenset[str]) -> Self:
        """The same experiment with these trials."""
        copy = self.model_copy()
        copy._planned, copy._scenes = planned, scenes  # noqa: SLF001 - of its own class
        return copy


def record(experiment: Experiment, store: Store) -> None:
    """Write an experiment and its plan into a run's file; parts of trials that are alike once."""
    base = experiment.trial
    parts: dict[str, int] = {}
    trials = []
    for each in experiment.planned:
        changed = {}
        for name in type(base).model_fields:
            part = getattr(each.trial, name)
            if part is not getattr(base, name) and part != getattr(base, name):
                text = json.dumps(as_table(part) if isinstance(part, Spec) else part)
                changed[name] = parts.setdefault(text, len(parts))
        trials.append([each.key, each.coordinates, each.method, changed])
    store.set_fact(_EXPERIMENT, as_given(experiment))
    store.set_fact(
        _PLAN,
        {
            "parts": [json.loads(text) for text in parts],
            "trials": trials,
            "scenes": sorted(experiment.scene_fingerprints),
        },
    )


def recorded(store: Store, file: Path) -> RecordedExperiment:
    """The experiment of a run's file. No file of a scene is read, and no matcher loaded.

    If none of its trials was made by the program as it is now, the store reads those of the version that made them.

    Raises
    ------
    InputError
        When the file does not hold a whole one.
    """
    plan = store.fact(_PLAN)
    if plan is None:
        raise InputError("holds no plan of a run, or that of an early version; run the experiment again", file=file)
    # No notice of former names here: the file is the program's own.
    # A run of a version that had no key `law` tested it wherever it could, and its report still says what it said.
    written = {"law": True} | store.fact(_EXPERIMENT)
    experiment = parse(RecordedExperiment, up_to_date(RecordedExperiment, written)[0], file=file)
    known: dict[tuple[str, int], Any] = {}
    planned = []
    try:
        for key, coordinates, (matcher, step), changed in plan["trials"]:
            table = {name: getattr(experiment.trial, name) for name in Trial.model_fields}
            table |= {name: known.get((name, index), plan["parts"][index]) for name, index in changed.items()}
            trial = parse(Trial, up_to_date(Trial, table)[0], file=file)
            known |= {(name, index): getattr(trial, name) for name, index in changed.items()}
            settings, _ = dotted_up_to_date(DottedKeys(Trial), coordinates)
            planned.append(Planned(str(key), settings, trial, (str(matcher), str(step))))
        scenes = frozenset(map(str, plan["scenes"]))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"its plan cannot be read ({type(error).__name__}: {error})", file=file) from error
    if not planned:
        raise InputError("its plan has no trial", file=file)
    store.read_earlier(each.key for each in planned)
    return experiment.with_plan(with_case_keys(tuple(planned), experiment.cases, experiment.axes), scenes)
