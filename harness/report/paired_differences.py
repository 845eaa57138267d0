"""Comparison of runs: the settings that differ, and paired differences of their main figures."""

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.ticker import SymmetricalLogLocator

from harness.display import listed
from harness.errors import InputError
from harness.evaluation.metric_table import metric
from harness.evaluation.statistics import FEW_SEEDS, between, resampled
from harness.geometry.angles import Array
from harness.report import theme, written_runs
from harness.report.data import Cell, Data, Heading, Table, count, interval, number, words
from harness.report.markup import template
from harness.report.pairing import METHOD, Pairs, pairs_of
from harness.report.theme import WIDE, Picture
from harness.report.typography import figure
from harness.report.written_runs import NONE, Run, names_of_folders, read_run
from harness.runs.key_names import name_of

_FAR = 300
"""Shares in percent from which an axis is logarithmic beyond 100: one figure would crush all others."""
_STEP = "matching.subpixel"
_STEPS = {"none": "whole pixels", "parabola": "sub-pixel"}


@dataclass(frozen=True)
class Difference:
    """A figure of two runs over the trials that are pairs."""

    figure: str
    step: str
    """The sub-pixel step that both have; empty if it differs or is not there."""
    case: str
    """The case of the trials of both runs; empty where they are of none, or of cases of different names. The two
    methods, where every method of one run is paired with every method of the other."""
    pairs: int
    first: float
    second: float
    """Means over the pairs, in the units of `trials.csv`."""
    difference: float
    """Mean of second minus first."""
    between: tuple[float, float] | None
    """The 95 % interval of the difference by bootstrap over seeds; None from one seed."""

    @property
    def group(self) -> str:
        """The case and the sub-pixel step, in words; empty where it is of all pairs."""
        return ", ".join(filter(None, (self.case, _STEPS.get(self.step, self.step))))

    @property
    def verdict(self) -> str:
        """The verdict on the second run that the interval allows."""
        if self.difference == 0 and self.between in (None, (0.0, 0.0)):
            return "the same"
        if self.between is None:
            return "one seed"
        low, high = self.between
        if low <= 0 <= high:
            return "inconclusive"
        better = metric(self.figure).better
        if better == "near zero":
            return "larger" if low > 0 else "smaller"
        return "better" if (low > 0) == (better == "higher") else "worse"


_VERDICTS = {
    "better": "better",
    "worse": "worse",
    "larger": "larger",
    "smaller": "smaller",
    "the same": "the same",
    "inconclusive": "nothing certain",
    "one seed": "nothing to conclude from one seed",
}
"""The verdicts of `Difference` as a sentence has them, in its order."""


@dataclass(frozen=True)
class Pairing:
    """Two runs, pair by pair."""

    first: Run
    second: Run
    differing: dict[str, tuple[str, str]]
    """Settings that no trial of one run shares with any of the other; a value in words, or several. Cases of different
    names in the place of what they set."""
    pairs: int
    seeds: int
    differences: list[Difference]
    why_none: str
    """The reason in words, if nothing could be paired."""
    left_out: list[str]
    """The trials without a partner in the other run, in words; a phrase for each run."""

    @property
    def conclusion(self) -> str:
        """In which figures the second run is better, worse, and neither, in a sentence; empty without pairs."""
        by_verdict: dict[str, list[str]] = {}
        for figure_name in dict.fromkeys(each.figure for each in self.differences):
            mine = [each for each in self.differences if each.figure == figure_name]
            name = metric(figure_name).short
            if len({each.verdict for each in mine}) == 1:
                by_verdict.setdefault(mine[0].verdict, []).append(name)
            else:
                for each in mine:
                    by_verdict.setdefault(each.verdict, []).append(f"{name} ({each.group})")
        if not by_verdict:
            return ""
        alike = len(by_verdict) == 1
        said = [
            f"{words} in " + (f"all {len(names)} figures" if alike else listed(f"“{each}”" for each in names))
            for key, words in _VERDICTS.items()
            if (names := by_verdict.get(key))
        ]
        return f"{self.second.name} against {self.first.name}: {'; '.join(said)}."


@dataclass(frozen=True)
class Comparison:
    """All runs against the first."""

    runs: list[Run]
    pairings: list[Pairing]
    html: str

    def lines(self) -> Iterator[tuple[str, ...]]:
        """Cells of a table: run, figure with unit, case and step, first, second, difference with interval, verdict."""
        for pairing in self.pairings:
            for each in pairing.differences:
                shown = metric(each.figure)
                form, scale = shown.form, shown.scale
                span = "" if each.between is None else f" {interval(each.between, _signed(form), scale)}"
                yield (
                    pairing.second.name,
                    f"{shown.short}, {shown.unit}".replace("\u00a0", " "),
                    each.group,
                    figure(scale * each.first, form),
                    figure(scale * each.second, form),
                    f"{figure(scale * each.difference, _signed(form))}{span}".replace("\u00a0", " "),
                    each.verdict,
                )


def build_comparison(*folders: Path) -> Comparison:
    """Compare runs with the first of them.

    Parameters
    ----------
    folders
        Output folders of runs, of any code and version; two or more.

    Raises
    ------
    InputError
        When a folder holds no run, or its files cannot be read or are damaged.
    """
    if len(folders) < 2:
        raise InputError("give at least two folders to compare")
    names = names_of_folders(folders)
    runs = [read_run(folder, name) for folder, name in zip(folders, names, strict=True)]
    pairings = [_pair(runs[0], other) for other in runs[1:]]
    with theme.style():
        pictures = [_picture(each) if any(one.first for one in each.differences) else None for each in pairings]
    html = template("compare.html.j2").render(
        runs=runs,
        pairings=[
            {
                "pairing": pairing,
                "picture": picture,
                "table": _table(pairing),
                "few_seeds": pairing.seeds < FEW_SEEDS,
                "differing": [(name_of(key), *values) for key, values in pairing.differing.items()],
            }
            for pairing, picture in zip(pairings, pictures, strict=True)
        ],
        facts=_fact_table(runs),
        mark=" ".join(each.mark for each in runs),
    )
    return Comparison(runs, pairings, html)


# --- Pairing ------------------------------------------------------------------------------------------------------


def _pair(first: Run, second: Run) -> Pairing:
    pairs = pairs_of(first, second)
    seeds = {first.settings[a].get("seed", "") for a, _ in pairs.table}
    differences = list(_differences(first, second, pairs))
    return Pairing(
        first, second, pairs.differing, len(pairs.table), len(seeds), differences, pairs.why_none, pairs.left_out
    )


def _differences(first: Run, second: Run, made: Pairs) -> Iterator[Difference]:
    methods = made.methods or [""] * len(made.table)
    frame = pd.DataFrame(
        [
            {
                "seed": first.settings[a].get("seed", ""),
                "step": "" if method else _common_step(first.settings[a], second.settings[b]),
                "case": method or (first.cases[a] if first.cases[a] == second.cases[b] else ""),
                **{f"first_{key}": value for key, value in first.figures[a].items()},
                **{f"second_{key}": value for key, value in second.figures[b].items()},
            }
            for (a, b), method in zip(made.table, methods, strict=True)
        ]
    )
    if frame.empty:
        return
    for name in written_runs.COMPARED:
        for (case, step), part in frame.groupby(["case", "step"], sort=False):
            known = part.dropna(subset=[f"first_{name}", f"second_{name}"])
            if known.empty:
                continue
            before, after = known[f"first_{name}"], known[f"second_{name}"]
            mean, span = _mean((after - before).to_numpy(), known["seed"])
            yield Difference(
                name, str(step), str(case), len(known), float(before.mean()), float(after.mean()), mean, span
            )


def _common_step(first: dict[str, str], second: dict[str, str]) -> str:
    step = first.get(_STEP, NONE)
    return "" if step == NONE or second.get(_STEP, NONE) != step else str(json.loads(step))


def _mean(values: Array, seeds: "pd.Series[str]") -> tuple[float, tuple[float, float] | None]:
    """Mean, and its interval by bootstrap over seeds."""
    by_seed = pd.Series(values).groupby(seeds.to_numpy())
    sums, counts = by_seed.sum().to_numpy(), by_seed.size().to_numpy(dtype=np.float64)
    weights = resampled(len(counts))
    means = (weights @ sums) / (weights @ counts)
    low, high = between(means[1:, None], len(counts))
    return float(means[0]), (float(low[0]), float(high[0])) if np.isfinite(low[0]) else None


# --- Showing ------------------------------------------------------------------------------------------------------


def _signed(form: str) -> str:
    return f"+{form}"


def _table(pairing: Pairing) -> Table:
    head = [
        Heading("Figure", text=True),
        Heading(
            "Methods"
            if METHOD in pairing.differing
            else "Case, step"
            if any(each.case for each in pairing.differences)
            else "Step",
            text=True,
        ),
        Heading("Pairs"),
        Heading(pairing.first.name),
        Heading(pairing.second.name),
        Heading("Difference"),
        Heading("", text=True),
    ]
    head[-1] = Heading(f"{pairing.second.name} is", text=True)
    rows = []
    for each in pairing.differences:
        shown = metric(each.figure)
        form, scale = shown.form, shown.scale
        rows.append(
            [
                words(f"{shown.heading} ({shown.unit})"),
                words(each.group or "–"),
                count(each.pairs),
                number(each.first, form, scale),
                number(each.second, form, scale),
                number(each.difference, _signed(form), scale, each.between),
                words(each.verdict),
            ]
        )
    data = Data(
        "paired-differences",
        ["figure", "case", "subpixel", "pairs", "first_mean", "second_mean", "difference", "ci95_low", "ci95_high"],
        [
            [
                each.figure,
                each.case,
                each.step,
                each.pairs,
                each.first,
                each.second,
                each.difference,
                *(each.between or (None, None)),
            ]
            for each in pairing.differences
        ],
    )
    return Table(head, rows, data)


@theme.panel
def _picture(pairing: Pairing) -> Picture:
    """Differences as shares of the first run's figure, so that all fit on one axis; logarithmic beyond 100 %."""
    shown = [each for each in pairing.differences if each.first]
    groups = list(dict.fromkeys(each.group for each in shown))
    names = list(dict.fromkeys(each.figure for each in shown))
    colours = {_STEPS["none"]: theme.PIXEL, _STEPS["parabola"]: theme.SUBPIXEL}
    row, above = max(24, 9 * len(groups) + 6), 12 + 20 * math.ceil(len(groups) / 4)
    fig = theme.figure(WIDE, row * len(names) + above + 66)
    ax = theme.axes(fig, 250, above, WIDE - 290, row * len(names) + 10)
    ax.axvline(0, color=theme.TRUTH, linewidth=0.9)
    described = []
    # Two dozen distinct styles: with more groups, only the table distinguishes them.
    spare = itertools.cycle([(colour, mark) for mark in "os^Dv" for colour in theme.SPARE])
    for index, group in enumerate(groups):
        mine = [each for each in shown if each.group == group]
        spacing = min(0.22, 0.8 / len(groups))
        y = np.array([names.index(each.figure) for each in mine]) + spacing * (index - (len(groups) - 1) / 2)
        share = np.array([100 * each.difference / abs(each.first) for each in mine])
        spans = np.array(
            [
                [100 * end / abs(each.first) for end in each.between] if each.between else (np.nan, np.nan)
                for each in mine
            ]
        )
        colour, mark = (colours[group], "o") if group in colours else next(spare)
        label = group or "all pairs"
        ax.hlines(y, spans[:, 0], spans[:, 1], color=colour, linewidth=1.6)
        ax.plot(share, y, mark, color=colour, markersize=5, label=theme.plain(label))
        described += [
            f"{metric(each.figure).heading}, {label} {figure(value, '+.0f')} %"
            for each, value in zip(mine, share, strict=True)
        ]
    ax.set_yticks(range(len(names)), [metric(name).heading.replace("\u00a0", " ") for name in names])
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="x", color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    low, high = ax.dataLim.intervalx
    if max(-low, high) > _FAR:
        ax.set_xscale("symlog", linthresh=100, linscale=1)
        ax.set_xlim(min(1.5 * low, -120), max(1.5 * high, 120))
        ax.xaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=100))
    ax.set_xlabel(theme.plain(f"{pairing.second.name} against {pairing.first.name} (% of the latter’s mean)"))
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:+,.0f}".replace("-", "−") if value else "0")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=min(len(groups), 4), borderaxespad=0.3)
    return theme.picture(fig, f"Paired differences as shares of the first run’s mean: {'; '.join(described)}.")


def _fact_table(runs: list[Run]) -> Table:
    """Versions and the like that differ between runs."""
    keys = dict.fromkeys(key for run in runs for key in run.facts)
    head = [Heading("", text=True), *(Heading(run.name, text=True) for run in runs)]
    head[0] = Heading("Fact", text=True)
    rows = [
        [words(key.replace("_", " ")), *(Cell(run.facts.get(key, "unknown")[:60]) for run in runs)]
        for key in keys
        if len({run.facts.get(key) for run in runs}) > 1
    ]
    return Table(head, rows)
