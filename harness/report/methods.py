"""The methods that a report compares: what they are called and how they are drawn."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.experiments.run import by_method
from harness.experiments.trial import Outcome
from harness.report import theme


@dataclass(frozen=True)
class Method:
    """One method and its outcome."""

    key: str
    """As in `summary.json`."""
    label: str
    colour: str
    outcome: Outcome


_KNOWN = {"pixel": ("pixel level", theme.PIXEL), "subpixel": ("sub-pixel", theme.SUBPIXEL)}


def methods_of(outcomes: list[Outcome]) -> list[Method]:
    """The methods of an experiment, in the order in which they were run."""
    spare = iter(theme.SPARE * len(outcomes))
    named = by_method(outcomes).items()
    return [Method(key, *(_KNOWN.get(key) or (key, next(spare))), outcome) for key, outcome in named]


def common(methods: list[Method]) -> NDArray[np.bool_]:
    """`[height, width]`: pixels for which every method has an estimate."""
    return np.logical_and.reduce([method.outcome.valid for method in methods])
