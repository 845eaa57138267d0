"""The trade-off over the baseline, and the baseline that is best for a range."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from harness.camera.angles import Array
from harness.evaluation.law_images import baseline_curve
from harness.evaluation.regions import RANGE_RATIO
from harness.report import theme
from harness.report.data import Data, Heading, Table, number, words
from harness.report.law.part import Part, is_of
from harness.report.statistics import between
from harness.report.sweep import Sweep, Way
from harness.report.sweeps import SURFACES
from harness.report.theme import Picture

_RANGES = ("#440154", "#414487", "#2A788E", "#22A884", "#7AD151", "#C9B800")
"""Of ranges, from near to far."""


def best_baseline(sweep: Sweep, law: dict[str, Any]) -> Part:
    """Spread against the baseline, a curve for each range, and where each is lowest."""
    curves: list[list[Any]] = []
    pictures = _trade_off(sweep, curves)
    headings = ["matcher", "subpixel", "surface", "range_m", "baseline_m", "spread_m", "ci95_low", "ci95_high"]
    return Part(
        {"curves": pictures},
        {"baselines": _baseline_table(sweep, law)},
        {"curves": Data("law-best-baseline", headings, curves)},
    )


def _trade_off(sweep: Sweep, rows: list[list[Any]]) -> list[Picture]:
    """Error against the baseline, a curve for each range: a picture for each surface and matcher."""
    pictures = []
    for matcher in dict.fromkeys(way.matcher for way in sweep.ways):
        for surface in sweep.surfaces:
            ways = [way for way in sweep.ways if way.matcher == matcher][:3]
            curves = {way: list(_curves(way.of(sweep.cells[sweep.cells["surface"] == surface]))) for way in ways}
            if any(curves.values()):
                pictures.append(
                    _trade_off_picture(ways, surface, curves, rows, len({way.matcher for way in sweep.ways}) > 1)
                )
    return pictures


def _curves(cells: pd.DataFrame) -> Iterator[tuple[int, Array, Array, Array, Array]]:
    """Range bin, baselines, spread, and its interval."""
    for range_bin, part in cells.groupby("range_bin", sort=True):
        curve = baseline_curve(part)
        if curve is not None:
            baselines, errors, draws = curve
            low, high = between(draws, part["seed"].nunique())
            yield int(range_bin), baselines, np.exp(errors), np.exp(low), np.exp(high)


def _trade_off_picture(
    ways: list[Way], surface: str, curves: dict[Way, list[Any]], rows: list[list[Any]], named: bool
) -> Picture:
    fig, panels = theme.pair(len(ways), height=330, top=46)
    every = [curve for found in curves.values() for curve in found]
    bins = sorted({curve[0] for curve in every})
    spread = 1000 * np.concatenate([np.concatenate(curve[2:3]) for curve in every])
    lengths = np.concatenate([curve[1] for curve in every])
    told = []
    for ax, way in zip(panels, ways, strict=True):
        step = way.label.split(", ")[-1]
        ax.set_title(step, pad=20)
        for range_bin, baselines, error, low, high in curves[way]:
            colour = _RANGES[bins.index(range_bin) % len(_RANGES)]
            if np.isfinite(low).all():
                ax.fill_between(baselines, 1000 * low, 1000 * high, color=colour, alpha=0.15, linewidth=0)
            ax.plot(
                baselines, 1000 * error, color=colour, linewidth=1.2, label=f"{RANGE_RATIO ** (range_bin + 0.5):.1f} m"
            )
            flat = error <= 1.1 * error.min()
            ax.plot(
                np.where(flat, baselines, np.nan),
                np.where(flat, 1000 * error, np.nan),
                color=colour,
                linewidth=4,
                alpha=0.45,
            )
            best = int(np.argmin(error))
            ax.plot(baselines[best], 1000 * error[best], "o", color=colour, markersize=6, markeredgecolor=theme.PAPER)
            distance = RANGE_RATIO ** (range_bin + 0.5)
            told.append(f"{step} at {distance:.1f} m best with {baselines[best]:g} m")
            rows += [
                [way.matcher, way.subpixel, surface, distance, *each]
                for each in zip(baselines, error, low, high, strict=True)
            ]
        theme.logarithmic(ax, "x", float(lengths.min()) / 1.12, float(lengths.max()) * 1.12, most=4)
        theme.logarithmic(ax, "y", float(spread.min()) / 1.3, float(spread.max()) * 1.3)
        ax.set_xlabel("baseline |t| (m)")
    panels[0].set_ylabel("spread of the range (mm)")
    handles: dict[str, Any] = {}
    for ax in panels:
        found, labels = ax.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
    ordered = sorted(handles, key=lambda text: float(text.split()[0]))
    panels[0].legend(
        [handles[text] for text in ordered],
        ordered,
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.995),
        ncol=len(ordered),
        columnspacing=0.9,
        handlelength=1.0,
        handletextpad=0.35,
        borderaxespad=0.2,
    )
    name = f"{ways[0].matcher}, {SURFACES[surface]}" if named else SURFACES[surface]
    return theme.picture(
        fig, f"Spread of the range against the baseline for several ranges, {name}: {'; '.join(told)}.", name
    )


def _baseline_table(sweep: Sweep, law: dict[str, Any]) -> Table:
    headings = [
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("Range", "m"),
        Heading("Best baseline", "m"),
        Heading("95 % low", "m"),
        Heading("95 % high", "m"),
        Heading("Within 10 %, from", "m"),
        Heading("to", "m"),
        Heading("d²/|t| advises", "m"),
        Heading("Error there over the best", ""),
    ]
    rows = []
    for surface in sweep.surfaces:
        for way in sweep.ways:
            costs = {
                range_bin: float(error[-1] / error.min())
                for range_bin, _, error, _, _ in _curves(way.of(sweep.cells[sweep.cells["surface"] == surface]))
            }
            for each in law["best_baseline"]:
                if not is_of(each, way, surface):
                    continue
                range_bin = round(math.log(each["range_m"]) / math.log(RANGE_RATIO) - 0.5)
                low, high = each["baseline_m_ci95"]
                rows.append(
                    [
                        words(SURFACES[surface]),
                        words(way.label, way.colour),
                        number(each["range_m"], ".2f"),
                        number(each["baseline_m"], ".3g"),
                        number(low, ".3g"),
                        number(high, ".3g"),
                        number(each["flat_from_m"], ".3g"),
                        number(each["flat_to_m"], ".3g"),
                        number(each["naive_baseline_m"], ".3g"),
                        number(costs.get(range_bin), ".2f"),
                    ]
                )
    return Table(headings, rows)
