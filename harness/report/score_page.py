"""A page on anybody's maps against a data set: the figures, by parts of the picture and by pairs, and pictures."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm

from harness.datasets.scoring import Score
from harness.evaluation.metric_table import METRICS, Metric
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import template
from harness.report.theme import HALF, WIDE, Picture

_OF_PARTS = ("density", "range_median_abs_m", "range_rmse_m", "disparity_median_abs_px", "bad_1px")
_OF_PAIRS = (*_OF_PARTS, "range_abs_rel", "range_bias_m")
_NOT_HERE = ("motion_", "view_", "refined", "scan_", "occlusion_")
_SPLITS = {"visibility": "Visibility", "kind": "Kind", "alpha_1": "Angle α₁", "range": "Range"}
_MOST_PAIRS = 300
_HEIGHT = 330
_NOTHING = "#D4D4D4"


def build_page(
    scores: Sequence[Score],
    summary: dict[str, float | None],
    parts: list[dict[str, Any]],
    *,
    estimate: str,
    truth: str,
    quantity: str = "range",
) -> str:
    """The page, one self-contained HTML file."""
    ranked = sorted((each for each in scores if _error(each) is not None), key=lambda each: _error(each) or 0.0)
    shown = {"median": ranked[len(ranked) // 2], "largest": ranked[-1]} if ranked else {}
    with theme.style():
        curves = [_cumulative(scores), _over_range(scores)]
        pictures = {f"the pair with the {name} error, {each.pair.name}": _maps(each) for name, each in shown.items()}
    return template("score.html.j2").render(
        estimate=estimate,
        truth=truth,
        quantity=quantity,
        pairs=len(scores),
        figures=_figures(summary),
        parts=_of_parts(parts),
        of_pairs=_of_pairs(scores),
        curves=curves,
        pictures=pictures,
    )


def _error(score: Score) -> float | None:
    return score.measures.get("range_median_abs_m")


def _figures(summary: dict[str, float | None]) -> Table:
    """Every figure of the set, over pixels and over solid angle."""
    headings = [Heading("Figure", text=True), Heading("unit", text=True), Heading("pixels"), Heading("solid angle")]
    rows = []
    for name, metric in METRICS.items():
        if name in summary and not name.startswith(_NOT_HERE):
            weighted = summary.get(f"solid_angle_{name}")
            cells = [number(value, metric.form, metric.scale) for value in (summary[name], weighted)]
            rows.append([words(metric.heading), words(metric.unit), *cells])
    return Table(headings, rows)


def _headings(names: Sequence[str]) -> list[Heading]:
    return [Heading(METRICS[name].short, METRICS[name].unit) for name in names]


def _cells(figures: dict[str, Any], names: Sequence[str]) -> list[Cell]:
    metrics: list[Metric] = [METRICS[name] for name in names]
    return [number(figures.get(each.name), each.form, each.scale) for each in metrics]


def _of_parts(parts: list[dict[str, Any]]) -> Table:
    headings = [Heading("Split", text=True), Heading("Part", text=True), Heading("Pixels"), *_headings(_OF_PARTS)]
    rows = [
        [words(_SPLITS[each["split"]]), words(each["part"]), count(each["pixels"]), *_cells(each, _OF_PARTS)]
        for each in parts
    ]
    return Table(headings, rows)


def _of_pairs(scores: Sequence[Score]) -> Table:
    names = ["pair", *_OF_PAIRS]
    numbers = [[each.pair.name, *(each.measures.get(name) for name in _OF_PAIRS)] for each in scores]
    data = Data("scores", names, numbers)
    worst = sorted(scores, key=lambda each: -(_error(each) or np.inf))
    rows = [[words(each.pair.name), *_cells(each.measures, _OF_PAIRS)] for each in worst[:_MOST_PAIRS]]
    return Table([Heading("Pair", text=True), *_headings(_OF_PAIRS)], rows, data, max(0, len(scores) - _MOST_PAIRS))


def _pooled(scores: Sequence[Score]) -> tuple[Array, Array]:
    """Absolute range errors and true ranges of all pixels that count and have an estimate."""
    off, true = [np.empty(0)], [np.empty(0)]
    for each in scores:
        scored = each.domain & np.isfinite(each.range_m)
        off.append(np.abs(each.range_m - each.truth_m)[scored])
        true.append(each.truth_m[scored])
    return np.concatenate(off), np.concatenate(true)


@theme.panel
def _cumulative(scores: Sequence[Score]) -> Picture:
    """The cumulative distribution of relative errors over the scored pixels; a missing estimate exceeds every error."""
    off, _ = _pooled(scores)
    whole = sum(int(each.domain.sum()) for each in scores)
    fig = theme.figure(HALF, _HEIGHT)
    ax = theme.axes(fig, 54, 16, HALF - 72, _HEIGHT - 66)
    grid = np.geomspace(1e-4, 10, 200)
    share = np.searchsorted(np.sort(off), grid, side="right") / max(whole, 1)
    ax.plot(grid, 100 * share, color=theme.SUBPIXEL)
    ax.set_xscale("log")
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0, 100)
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_xlabel("|range error| (m)")
    ax.set_ylabel("pixels within it (%)")
    at = {f"{limit:g} m": float(np.mean(off <= limit) * off.size / max(whole, 1)) for limit in (0.01, 0.1, 1.0)}
    within = ", ".join(f"{100 * each:.0f} % within {name}" for name, each in at.items())
    alt = f"Share of pixels within an error: {within}."
    return theme.picture(fig, alt, "(a) distribution of errors; what has no estimate is within none")


@theme.panel
def _over_range(scores: Sequence[Score]) -> Picture:
    """Median, and 68 and 95 %, of the error relative to the range, against the range."""
    off, true = _pooled(scores)
    fig = theme.figure(HALF, _HEIGHT)
    ax = theme.axes(fig, 54, 16, HALF - 72, _HEIGHT - 66)
    if not off.size:
        theme.note(ax, "no estimate")
        return theme.picture(fig, "No estimate.", "(b) error against range")
    edges = np.unique(np.quantile(true, np.linspace(0, 1, 13)))
    label = np.clip(np.searchsorted(edges, true, side="right") - 1, 0, len(edges) - 2)
    middle, lines = [], []
    for i in range(len(edges) - 1):
        inside = label == i
        if inside.sum() >= 20:
            middle.append(float(np.median(true[inside])))
            lines.append(100 * np.quantile(off[inside] / true[inside], [0.5, 0.68, 0.95]))
    for column, stroke, name in zip(np.array(lines).T, ("-", "--", ":"), ("50 %", "68 %", "95 %"), strict=True):
        ax.plot(middle, column, stroke, color=theme.SUBPIXEL, label=name)
    known = np.array(lines)
    if known.max() > 0:  # the truth itself has no errors
        ax.set_yscale("log")
        theme.logarithmic(ax, "y", float(known[known > 0].min()), float(known.max()))
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_xlabel("true range (m)")
    ax.set_ylabel("|error| / range (%)")
    ax.legend()
    medians = f"{lines[0][0]:.2g} to {lines[-1][0]:.2g} per cent"
    alt = f"Median error relative to the range: {medians} at {middle[0]:.1f} to {middle[-1]:.1f} metres."
    return theme.picture(fig, alt, "(b) error relative to the range that so many estimates stay within")


def _maps(score: Score) -> list[Picture]:
    """Truth, estimate and relative error of a pair."""
    known = score.truth_m[np.isfinite(score.truth_m)]
    low, high = np.percentile(known, [1, 99]).tolist() if known.size else (1.0, 10.0)
    norm = LogNorm(low, max(high, 1.01 * low))
    relative = 100 * np.abs(score.range_m / score.truth_m - 1)
    errors = LogNorm(0.01, 100)
    return [
        _map(score.truth_m, norm, "viridis_r", "truth: range (m)"),
        _map(score.range_m, norm, "viridis_r", "estimate: range (m)"),
        _map(np.maximum(relative, 0.01), errors, "magma_r", "|error| / range (%)"),
    ]


@theme.panel
def _map(values: Array, norm: LogNorm, colours: str, title: str) -> Picture:
    height, width = values.shape
    wide = WIDE // 3 - 10
    tall = round((wide - 66) * height / width)
    fig = theme.figure(wide, tall + 20)
    ax = theme.axes(fig, 2, 4, wide - 66, tall)
    bar = theme.axes(fig, wide - 58, 4, 10, tall)
    ax.set_facecolor(_NOTHING)
    drawn = ax.imshow(values, cmap=colormaps[colours].resampled(64), norm=norm, aspect="auto")
    ax.set_xticks([])
    ax.set_yticks([])
    fig.colorbar(drawn, cax=bar)
    bar.minorticks_off()
    theme.logarithmic(bar, "y", float(norm.vmin or 0.01), float(norm.vmax or 100.0))
    share = float(np.isfinite(values).mean())
    return theme.picture(fig, f"{title}; {100 * share:.0f} % of the pixels have a value.", title)
