"""A sweep as tables: its methods, its axes, and the figures of all its trials."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from harness.display import shortened_labels
from harness.report import theme
from harness.report.method_styles import looks
from harness.runs.analysis import law_condition, noise_condition
from harness.runs.cases import CASE
from harness.runs.key_names import name_and_unit, name_of
from harness.runs.methods import METHOD_KEYS, MethodName
from harness.runs.run import Result, Row
from harness.runs.values import Settings, identity_of, shown, text_of

NOT_AN_AXIS = ("seed", *METHOD_KEYS)
"""Keys that vary, but are averaged over or drawn as methods."""

_STROKES: tuple[tuple[Any, str], ...] = (
    ("solid", "o"),
    ((0, (4, 1.8)), "s"),
    ((0, (1, 1.3)), "^"),
    ((0, (5, 1.5, 1, 1.5)), "D"),
)


@dataclass(frozen=True)
class MethodStyle:
    """A method, which is a matcher with a sub-pixel step, and how it is drawn: colours tell steps of the window
    matchers and all other matchers apart, strokes tell matchers apart.
    """

    matcher: str
    subpixel: str
    label: str
    step_label: str
    """The step alone, for where the matcher is clear."""
    colour: str
    stroke: Any
    marker: str
    filled: bool

    def of(self, table: pd.DataFrame) -> pd.DataFrame:
        """The method's rows of a table with the columns `matcher` and `subpixel`."""
        return table[(table["matcher"] == self.matcher) & (table["subpixel"] == self.subpixel)]

    @property
    def face(self) -> str:
        """The colour inside its markers."""
        return self.colour if self.filled else theme.PAPER


@dataclass(frozen=True)
class Axis:
    """A setting that varies."""

    key: str
    values: list[Any]

    @property
    def name(self) -> str:
        """The axis's name for people."""
        return name_and_unit(self.key)[0]

    @property
    def unit(self) -> str:
        """The unit as shown; empty if there is none, or none that is known here."""
        return name_and_unit(self.key)[1]

    @property
    def label(self) -> str:
        """The name with its unit."""
        return name_of(self.key)

    @property
    def slug(self) -> str:
        """The name of its figure and data in links and files."""
        return f"sweep-{self.key.replace('.', '-').replace('_', '-')}"

    @cached_property
    def texts(self) -> list[str]:
        """The values in words, each different from all others."""
        return texts_of(self.values)

    @property
    def numeric(self) -> bool:
        """Whether its values lie on a line."""
        return all(map(_is_number, self.values)) and all(map(math.isfinite, self.values))

    @property
    def logarithmic(self) -> bool:
        """Whether its values spread over a factor of three or more, zero not among them."""
        return self.numeric and min(self.values) > 0 and max(self.values) / min(self.values) >= 3

    @property
    def positions(self) -> list[float]:
        """The abscissas at which its values are drawn."""
        return [float(value) for value in self.values] if self.numeric else [float(i) for i in range(len(self.values))]


@dataclass(frozen=True)
class Sweep:
    """The done trials of a run."""

    methods: list[MethodStyle]
    axes: list[Axis]
    """The axes without seeds and methods."""
    seeds: list[int]
    trials: pd.DataFrame
    """One row for each trial: `matcher`, `subpixel`, `seed`, all its figures, and for every axis a column with the
    index of the value."""
    payloads: list[dict[str, Any]]
    """The row of each of them, see `row.row_of`."""
    cells: pd.DataFrame
    conditions: dict[str, Settings] = field(default_factory=dict)
    """The coordinates that a `condition` of cells, or of the summary's `limit`, is made of."""

    @cached_property
    def several(self) -> bool:
        """Whether there are more trials than those that the report shows in detail."""
        return bool(self.axes) or len(self.seeds) > 1 or len({method.matcher for method in self.methods}) > 1

    def cells_of(self, method: MethodStyle, surface: str) -> pd.DataFrame:
        """The cells of a method on a surface; `condition` is a number, which is quicker to group by."""
        return self._parts.get((method.matcher, method.subpixel, surface), self.cells.iloc[:0])

    @cached_property
    def _parts(self) -> dict[tuple[str, str, str], pd.DataFrame]:
        if self.cells.empty:
            return {}
        numbered = self.cells.assign(condition=pd.factorize(self.cells["condition"])[0])
        return {key: part for key, part in numbered.groupby(["matcher", "subpixel", "surface"], sort=False)}  # noqa: C416

    @cached_property
    def surfaces(self) -> list[str]:
        """The surfaces that cells lie on: `wall`, `floor`."""
        return [] if self.cells.empty else [s for s in ("wall", "floor") if (self.cells["surface"] == s).any()]


def sweep_of(result: Result) -> Sweep:
    """The tables of a run."""
    done = [row for row in result.rows if row.state == "done"]
    payloads = [row.payload for row in done]
    labels = result.experiment.method_labels
    not_axes = (*NOT_AN_AXIS, *([CASE] if labels else []))
    varying = {key: values for key, values in values_of(result.rows).items() if key not in not_axes}
    axes = [Axis(key, _ordered(values)) for key, values in varying.items() if len(values) > 1]
    index = {axis.key: {identity_of(axis.key, value): i for i, value in enumerate(axis.values)} for axis in axes}
    records = []
    for row, payload in zip(done, payloads, strict=True):
        trial = row.planned.trial
        matcher, subpixel = row.planned.method
        records.append(
            {
                "matcher": matcher,
                "subpixel": subpixel,
                "seed": trial.seed,
                **{key: of_value[identity_of(key, row.coordinates[key])] for key, of_value in index.items()},
                **{name: math.nan if value is None else value for name, value in payload["figures"].items()},
            }
        )
    trials = pd.DataFrame(records)
    return Sweep(
        methods=_method_styles(trials, labels),
        axes=axes,
        seeds=sorted(int(seed) for seed in trials["seed"].unique()),
        trials=trials,
        payloads=payloads,
        cells=result.cells,
        conditions={
            shown(each): each for row in done for each in (law_condition(row.planned), noise_condition(row.planned))
        },
    )


def values_of(rows: Iterable[Row]) -> dict[str, list[Any]]:
    """The keys that vary between trials, and the values that each takes, in the order in which they come."""
    values: dict[str, dict[str, Any]] = {}
    for row in rows:
        for key, value in row.coordinates.items():
            values.setdefault(key, {}).setdefault(identity_of(key, value), value)
    return {key: list(of_key.values()) for key, of_key in values.items()}


def texts_of(values: Sequence[Any]) -> list[str]:
    """Different values in words, each different from all others."""
    texts = [value_text(value) for value in values]
    if len(set(texts)) < len(texts):  # numbers that look alike when rounded are given exactly
        texts = [text_of(value) if texts.count(text) > 1 else text for value, text in zip(values, texts, strict=True)]
    return shortened_labels(texts)


def value_text(value: Any) -> str:
    """A value on an axis in words: lengths of a box as `4 × 4 × 6`."""
    if isinstance(value, list) and all(isinstance(each, int | float) for each in value):
        return " × ".join(f"{each:g}" for each in value)
    if isinstance(value, float):
        return f"{value:g}"
    return text_of(value) or "none"


def in_words(coordinates: Settings) -> str:
    """Coordinates on the axes, with the names that people use."""
    return shown({name_of(key): value for key, value in coordinates.items()})


def _ordered(values: list[Any]) -> list[Any]:
    return sorted(values) if all(map(_is_number, values)) else values


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)


def _method_styles(trials: pd.DataFrame, labels: Mapping[MethodName, str]) -> list[MethodStyle]:
    pairs = list(dict.fromkeys(zip(trials["matcher"], trials["subpixel"], strict=True)))
    matchers, steps = (list(dict.fromkeys(each)) for each in zip(*pairs, strict=True))
    methods = []
    for (matcher, step), look in looks(pairs, labels).items():
        index = matchers.index(matcher)
        stroke, marker = _STROKES[index % len(_STROKES)]
        methods.append(MethodStyle(matcher, step, *look, stroke, marker, filled=index % 2 == 0))
    return sorted(methods, key=lambda method: (matchers.index(method.matcher), steps.index(method.subpixel)))


def log_edges(values: "pd.Series[float]", count: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Edges of bins of equal width in the logarithm over all values."""
    return np.geomspace(float(values.min()) * (1 - 1e-9), float(values.max()) * (1 + 1e-9), count + 1)
