"""Errors by part of the picture, per pixel and per solid angle."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.evaluation.metric_table import METRICS
from harness.evaluation.regions import NEAR_BASELINE, OCCLUDED
from harness.evaluation.statistics import mean_over_seeds, weighted_median
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.method_styles import Method
from harness.report.section import About, Block, Context, Figure, TableBlock, section_of
from harness.report.sweep import MethodStyle, Sweep
from harness.report.theme import WIDE, Picture

SPLITS = {
    "visibility": "Visibility",
    "surface": "Surface",
    "kind": "Kind of surface",
    "alpha_1": "Angle to the baseline α₁",
    "elevation": "Elevation",
    "range": "True range",
    "left out": "Left out of all figures",
}
_MEASURES = tuple(METRICS[name] for name in ("disparity_median_abs_px", "bad_1px", "range_median_abs_m"))
_KEYS = ("density", *(each.name for each in _MEASURES))


_ERRORS = """
Median absolute errors of disparity and range by part of the picture
{%- if several %}, means of logarithms over all trials{% if seeds > 1 %} with 95 % intervals{% endif %}{% endif %}.
Parts of one split together are the domain
{%- if occluded %}; “occluded in view 2” lies outside it: there is no true match, so every estimate
is wrong{% endif %}.
{% if left_out %}Grey: what lies within 30° of the baseline, which no other figure counts.{% endif %}

"""
_TABLE = """
Errors by part of the picture over all trials, all pixels weighted equally: means of logarithms for medians, plain means
for shares, with 95 % intervals from resampling seeds.
"""
_BASE_TRIAL = """
Errors by part of the picture in {{ "the base trial" if several else "this experiment" }}, per pixel of the panorama and
per solid angle: pixels near the panorama’s lower border cover less of the sphere than those at the horizon.
Each method over the pixels that it has an estimate for.
"""


@section_of(About.ALL_TRIALS, "regions", "Errors by region")
def section(context: Context) -> Iterator[Block]:
    """Errors by part over all trials, and of the base trial, per pixel and per solid angle."""
    several = context.sweep.several
    pictures, table = over_trials(context.sweep)
    occluded = any(row[1].text == OCCLUDED for row in table.rows)
    left_out = any(row[1].text == NEAR_BASELINE for row in table.rows)
    caption = html(_ERRORS, several=several, seeds=len(context.sweep.seeds), occluded=occluded, left_out=left_out)
    yield Figure("figure-regions", pictures, caption, "wide", None if several else table.data)
    if several:
        yield TableBlock("table-regions", table, html(_TABLE))
    if context.methods:
        yield TableBlock("table-regions-base", of_base_trial(context.methods), html(_BASE_TRIAL, several=several))


@dataclass(frozen=True)
class _Part:
    split: str
    part: str


def over_trials(sweep: Sweep) -> tuple[list[Picture], Table]:
    """Means over all trials of each method, with intervals by bootstrap over seeds."""
    regions = [(index, region) for index, payload in enumerate(sweep.payloads) for region in payload["regions"]]
    columns: dict[str, Any] = {name: [region[name] for _, region in regions] for name in ("split", "part")}
    # Rows of version 0.2.0 have no `low`: their parts keep the order in which a trial names them.
    lows = [each.get("low", at) for payload in sweep.payloads for at, each in enumerate(payload["regions"])]
    columns["low"] = np.array(lows, dtype=np.float64)
    for name in ("pixels", *_KEYS):
        columns[name] = np.array([region[name] for _, region in regions], dtype=np.float64)
    table = pd.DataFrame(columns | {"trial": [index for index, _ in regions]})
    table["region"], names = pd.factorize(pd.MultiIndex.from_frame(table[["split", "part"]]))
    of_trial = sweep.trials[["matcher", "subpixel", "seed"]].iloc[table["trial"]].reset_index(drop=True)
    table = pd.concat([table, of_trial], axis=1)
    parts = _ordered(table)
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    curves: dict[tuple[MethodStyle, str], dict[_Part, tuple[float, float, float]]] = {}
    for method in sweep.methods:
        mine = method.of(table)
        for key in _KEYS:
            values = mine.pivot_table(index=["seed", "trial"], columns="region", values=key, aggfunc="mean")
            if values.empty:
                continue
            curve = mean_over_seeds(values, logarithmic=METRICS[key].geometric)
            for region, mean, low, high in zip(values.columns, curve.mean, curve.low, curve.high, strict=True):
                curves.setdefault((method, key), {})[_Part(*names[region])] = (float(mean), float(low), float(high))
    pixels = table.groupby(["split", "part"])["pixels"].mean()
    for part in parts:
        for method in sweep.methods:
            figures = {key: curves[method, key][part] for key in _KEYS if part in curves.get((method, key), {})}
            if not figures:
                continue
            rows.append(
                [
                    words(SPLITS.get(part.split, part.split)),
                    words(part.part.replace("-", "−")),
                    words(method.label, method.colour),
                    count(round(float(pixels[part.split, part.part]))),
                    _cell(figures.get("density"), ".1f", 100),
                    *(_cell(figures.get(each.name), each.form, each.scale) for each in _MEASURES),
                ]
            )
            rows[-1] = _greyed(rows[-1], part.part)
            plain.append([method.matcher, method.subpixel, part.split, part.part])
            for key in _KEYS:
                plain[-1] += figures.get(key, (np.nan,) * 3)
    headings = [f"{key}{end}" for key in _KEYS for end in ("", "_ci95_low", "_ci95_high")]
    data = Data("regions", ["matcher", "subpixel", "split", "part", *headings], plain)
    head = [
        Heading("Split", text=True),
        Heading("Part", text=True),
        Heading("Method", text=True),
        Heading("Pixels", "mean"),
        Heading("Density", "%"),
    ]
    head += [Heading(each.heading, each.unit) for each in _MEASURES]
    return [_picture(sweep, parts, curves)], Table(head, rows, data)


def _cell(figure: tuple[float, float, float] | None, form: str, scale: float) -> Cell:
    if figure is None:
        return Cell("–")
    mean, low, high = figure
    return number(mean, form, scale, (low, high) if np.isfinite(low) else None)


def _greyed(cells: list[Cell], part: str) -> list[Cell]:
    """The cells of a part; in grey for a part that no other figure counts."""
    return [replace(cells[0], faint=True), *cells[1:]] if part == NEAR_BASELINE else cells


def _ordered(table: pd.DataFrame) -> list[_Part]:
    """Parts in the order in which trials name them; those of one split together, bins of values ascending."""
    first = table.drop_duplicates(["split", "part"])
    order = {split: i for i, split in enumerate(dict.fromkeys([*SPLITS, *first["split"]]))}
    first = first.assign(of_split=first["split"].map(order), low=first["low"].fillna(0.0))
    first = first.sort_values(["of_split", "low"], kind="stable")
    return [_Part(split, part) for split, part in zip(first["split"], first["part"], strict=True)]


@theme.panel
def _picture(
    sweep: Sweep, parts: list[_Part], curves: dict[tuple[MethodStyle, str], dict[_Part, tuple[float, float, float]]]
) -> Picture:
    """Dots in lines, one line for each part."""
    gaps = np.cumsum([0.0, *(1.9 if a.split != b.split else 1.0 for a, b in pairwise(parts))])
    height = round(17 * (gaps[-1] + 1) + 110)
    fig = theme.figure(WIDE, height)
    axes = [theme.axes(fig, 260, 40, 360, height - 86), theme.axes(fig, 650, 40, 360, height - 86)]
    for ax, (key, label, scale) in zip(
        axes,
        (
            ("disparity_median_abs_px", "median |disparity error| (px)", 1.0),
            ("range_median_abs_m", "median |range error| (mm)", 1000.0),
        ),
        strict=True,
    ):
        drawn = []
        for index, method in enumerate(sweep.methods):
            values_of = curves.get((method, key), {})
            shift = 0.16 * (index - (len(sweep.methods) - 1) / 2)
            y = np.array([gaps[i] + shift for i, part in enumerate(parts) if part in values_of])
            values = scale * np.array([values_of[part] for part in parts if part in values_of]).reshape(-1, 3)
            ax.hlines(y, values[:, 1], values[:, 2], color=method.colour, linewidth=1.2)
            ax.plot(
                values[:, 0],
                y,
                method.marker,
                color=method.colour,
                markersize=4.6,
                markerfacecolor=method.face,
                label=theme.plain(method.label),
            )
            drawn.append(values[values > 0])
        known = np.concatenate([np.array([]), *drawn])
        known = known[np.isfinite(known)]
        if known.size:
            theme.logarithmic(ax, "x", float(known.min()) / 1.2, float(known.max()) * 1.2, most=7)
        ax.set_ylim(gaps[-1] + 0.7, -0.7)
        ax.set_yticks(gaps if ax is axes[0] else [])
        for at, part in zip(gaps, parts, strict=True):
            if part.part == NEAR_BASELINE:
                ax.axhspan(at - 0.5, at + 0.5, color=theme.OUTSIDE, linewidth=0, zorder=0)
        ax.hlines(gaps, 0, 1, transform=ax.get_yaxis_transform(), color="#E8E8E8", linewidth=0.5, zorder=0)
        ax.grid(axis="x", color="#E8E8E8", linewidth=0.5)
        ax.set_axisbelow(True)
        ax.tick_params(axis="y", length=0)
        ax.set_xlabel(label)
    axes[0].set_yticklabels([_name(part) for part in parts])
    axes[0].legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncol=len(sweep.methods),
        columnspacing=1.4,
        borderaxespad=0.3,
        handletextpad=0.3,
    )
    worst = [
        f"{method.label} largest for {_name(max(means, key=lambda part: means[part][0]))}"
        for (method, key), means in curves.items()
        if key == "range_median_abs_m" and means
    ]
    return theme.picture(
        fig, f"Median disparity and range errors in {len(parts)} parts of the picture; range error: {'; '.join(worst)}."
    )


def _name(part: _Part) -> str:
    prefix = {"alpha_1": "α₁ ", "elevation": "elevation ", "range": "range "}.get(part.split, "")
    return f"{prefix}{part.part}".replace("-", "−").replace("α₁", r"$\alpha_1$")


def of_base_trial(methods: list[Method]) -> Table:
    """The trials that the report shows in detail: every part per pixel and per solid angle."""
    outcome = methods[0].outcome
    grid = outcome.trial.panorama
    solid_angle = np.broadcast_to((1 + grid.z[:, None] ** 2) ** -1.5, grid.shape).ravel()
    head = [Heading("Split", text=True), Heading("Part", text=True), Heading("Method", text=True), Heading("Pixels")]
    head += [Heading("Density", "% of pixels"), Heading("Density", "% of solid angle")]
    for each in _MEASURES:
        head += [Heading(each.heading, f"{each.unit}, per {per}") for per in ("pixel", "solid angle")]
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for region in outcome.regions:
        for method in methods:
            weights = solid_angle[region.pixels]
            figures = [_measured(method, region.pixels), _measured(method, region.pixels, weights)]
            rows.append(
                [
                    words(SPLITS.get(region.split, region.split)),
                    words(region.part.replace("-", "−")),
                    words(method.label, method.colour),
                    count(region.pixels.size),
                    *(number(measures["density"], ".1f", 100) for measures in figures),
                ]
            )
            plain.append([region.split, region.part, method.key, region.pixels.size, float(weights.sum())])
            plain[-1] += [measures["density"] for measures in figures]
            for each in _MEASURES:
                rows[-1] += [number(measures[each.name], each.form, each.scale) for measures in figures]
            rows[-1] = _greyed(rows[-1], region.part)
            for each in _MEASURES:
                plain[-1] += [measures[each.name] for measures in figures]
    headings = ["split", "part", "method", "pixels", "solid_angle_weight", "density", "density_solid_angle"]
    headings += [f"{each.name}{end}" for each in _MEASURES for end in ("", "_solid_angle")]
    return Table(head, rows, Data("regions-base-trial", headings, plain))


def _measured(method: Method, pixels: NDArray[np.intp], weights: Array | None = None) -> dict[str, float]:
    """The figures of the columns, with every pixel counted by its weight, or all alike."""
    outcome = method.outcome
    valid = outcome.valid.ravel()[pixels]
    disparity = np.abs(outcome.errors.disparity_px.ravel()[pixels][valid])
    distance = np.abs(outcome.errors.range_m.ravel()[pixels][valid])
    if not disparity.size:
        return {"density": 0.0, **dict.fromkeys((each.name for each in _MEASURES), np.nan)}
    if weights is None:
        medians = float(np.median(disparity)), float(np.median(distance))
        shares = float(valid.mean()), float((disparity > 1).mean())
    else:
        w = weights[valid]
        medians = weighted_median(disparity, w), weighted_median(distance, w)
        shares = float(w.sum() / weights.sum()), float(w[disparity > 1].sum() / w.sum())
    return {
        "density": shares[0],
        "disparity_median_abs_px": medians[0],
        "bad_1px": shares[1],
        "range_median_abs_m": medians[1],
    }
