"""The methods that a report compares: their names and their graphic styles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome
from harness.report import theme
from harness.runs.experiment import Planned
from harness.runs.methods import WINDOWS, MethodName, method_id, names_for_people, step_for_people
from harness.runs.run import by_method, methods_in, names_in


@dataclass(frozen=True)
class Named:
    """A method's name and colour."""

    key: str
    """Its key in `summary.json`."""
    label: str
    colour: str


@dataclass(frozen=True)
class Method(Named):
    """One method and its outcome."""

    outcome: Outcome


_COLOURS = {"none": theme.PIXEL, "parabola": theme.SUBPIXEL}
"""Colours of the paper's two steps; others have those that are left."""


class Look(NamedTuple):
    """A method's labels and colour."""

    label: str
    step_label: str
    """The step alone."""
    colour: str


def looks(pairs: list[tuple[str, str]], labels: Mapping[MethodName, str] | None = None) -> dict[tuple[str, str], Look]:
    """Labels and colour of each method, given as a matcher and its sub-pixel step.

    Steps of the window matchers have a colour each, and so has every other matcher with its own step.

    Parameters
    ----------
    labels
        The names that cases give to methods.
    """
    drawn_as = [step if matcher in WINDOWS else f"{matcher} {step}" for matcher, step in pairs]
    spare = iter(theme.SPARE * len(pairs))
    colours = {name: _COLOURS[name] if name in _COLOURS else next(spare) for name in dict.fromkeys(drawn_as)}
    names = names_for_people(pairs, labels or {})
    return {
        pair: Look(names[pair], step_for_people(pair, pairs), colours[name])
        for pair, name in zip(pairs, drawn_as, strict=True)
    }


def methods_of(
    outcomes: list[Outcome], planned: Sequence[Planned] = (), labels: Mapping[MethodName, str] | None = None
) -> list[Method]:
    """The methods of an experiment, in the order in which they were run."""
    named = by_method(outcomes, planned)
    names = names_of([outcome.trial for outcome in outcomes], planned, labels)
    return [Method(each.key, each.label, each.colour, named[each.key]) for each in names]


def names_of(
    trials: list[Trial], planned: Sequence[Planned] = (), labels: Mapping[MethodName, str] | None = None
) -> list[Named]:
    """The names of the methods of some trials, in their order."""
    names = names_in(trials, planned)
    named = {key: names[method_id(trials[i].matching)] for key, i in methods_in(trials, planned).items()}
    appearance = looks(list(named.values()), labels)
    return [Named(key, appearance[name].label, appearance[name].colour) for key, name in named.items()]


def common(methods: list[Method]) -> NDArray[np.bool_]:
    """`[height, width]`: pixels for which every method has an estimate."""
    return np.logical_and.reduce([method.outcome.valid for method in methods])
