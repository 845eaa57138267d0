"""The law tested three ways: geometry alone, images, and what becomes of the angle's own error."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from harness.camera.angles import Array
from harness.evaluation.law import GROSS, verdict
from harness.evaluation.law_geometry import GeometryCheck, check_geometry
from harness.evaluation.law_images import LAWS, baseline_curve, fit_laws, residuals
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, interval, number, words
from harness.report.statistics import between, mean_over_seeds, median_over_seeds
from harness.report.sweep import Sweep, Way, in_words, log_edges
from harness.report.sweeps import SURFACES, draw_line
from harness.report.theme import FAINT, HALF, INK, Picture
from harness.report.words import figure, typeset

LAW_NAMES = {"exact": "exact law", "paper": "$d^2/|t|$"}
_PLAIN = {"exact": "exact law", "paper": "d²/|t|"}
_DENSE = LinearSegmentedColormap.from_list("cells", ["#FFFFFF", "#D5DEE8", "#7A8DA3", "#2F4158"])
_RANGES = ("#440154", "#414487", "#2A788E", "#22A884", "#7AD151", "#C9B800")
"""Of ranges, from near to far."""
LINEAR = 0.05
"""The linearisation has ended where a spread is off by more than this share."""

Fit = dict[str, Any]


@dataclass(frozen=True)
class Part:
    """Figures and tables of one of the three sections."""

    pictures: dict[str, list[Picture]]
    tables: dict[str, Table]
    data: dict[str, Data]
    notes: dict[str, str] = field(default_factory=dict)
    """Numbers that captions speak of."""


@dataclass(frozen=True)
class Finding:
    """What can be said of the law for one method and surface."""

    way: Way
    surface: str
    words: str
    """The verdict of the evaluation."""
    reasons: list[str]
    """Where and why, as far as the numbers show it."""


# --- Verdict ------------------------------------------------------------------------------------------------------


def findings(sweep: Sweep, law: dict[str, Any]) -> list[Finding]:
    """The verdict for every method and surface, with where the law fails."""
    found = []
    for surface in sweep.surfaces:
        for way in sweep.ways:
            fits = [fit for fit in law["images"] if _is(fit, way, surface)]
            exact = next((fit for fit in fits if fit["law"] == "exact" and fit["slope"] is not None), None)
            if exact is None:
                continue
            said = verdict(fits, sweep.cells, directions=False).partition(": ")[2]
            said = typeset(f"{said[:1].upper()}{said[1:]}")
            found.append(Finding(way, surface, said, list(_reasons(sweep, way, surface, exact, law))))
    return found


def _reasons(sweep: Sweep, way: Way, surface: str, exact: Fit, law: dict[str, Any]) -> Iterator[str]:
    """Where the slope's interval leaves out 1, and how the angle's own error grows."""
    known = [each for each in exact["by_alpha_1"] if each["slope_ci95"] is not None]
    off = [each for each in known if not each["slope_ci95"][0] <= 1 <= each["slope_ci95"][1]]
    if known and off:
        places = ", ".join(
            f"{each['from_deg']:g}\u2060–\u2060{each['to_deg']:g}°\u00a0({figure(each['slope'], '.2f')})"
            for each in off
        )
        which = "all directions" if len(off) == len(known) else f"{len(off)} of {len(known)} directions"
        yield f"The interval leaves out 1 in {which}: α₁ = {places}."
    elif known:
        yield f"In each of the {len(known)} directions by itself the interval holds 1."
    grown = next((each for each in law["sigma_alpha"] if _is(each, way, surface)), None)
    if grown and grown["slope_ci95"] is not None:
        slope, (low, high) = grown["slope_on_t_over_d"], grown["slope_ci95"]
        power = f"the power {figure(slope, '.2f')} {interval((low, high), '.2f')} of |t|/d"
        if low <= 0 <= high:
            yield f"σ(α₂) goes with {power}: no dependence on baseline and range can be told."
        else:
            tail = (
                "the law’s one empirical premise, a constant σ(α₂), does not hold here"
                if abs(slope) > 0.3
                else "a small dependence, but one that the data can tell from none"
            )
            yield f"σ(α₂) goes with {power}: {tail}."
    cells = way.of(sweep.cells[sweep.cells["surface"] == surface])
    low_half, high_half = _gross_halves(cells)
    if max(low_half, high_half) > GROSS:
        yield (
            f"Estimates off by over a pixel: {100 * low_half:.0f}\u00a0% in the half of the cells with the "
            f"smaller |t|/d, {100 * high_half:.0f}\u00a0% in the other half."
        )


def _gross_halves(cells: pd.DataFrame) -> tuple[float, float]:
    ratio = cells["baseline_m"] / cells["range_m"]
    halves = (cells[ratio <= ratio.median()], cells[ratio > ratio.median()])
    low, high = (
        float((half["gross"] * half["pixels"]).sum() / half["pixels"].sum()) if len(half) else 0.0 for half in halves
    )
    return low, high


def _is(entry: dict[str, Any], way: Way, surface: str) -> bool:
    return (entry["matcher"], entry["subpixel"], entry["surface"]) == (way.matcher, way.subpixel, surface)


# --- 1. Geometry --------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _geometry() -> GeometryCheck:
    return check_geometry()


def geometry() -> Part:
    """Exact angles with known noise: measured over predicted."""
    check = _geometry()
    relative = check.relative_spread.ravel()
    kinds = {
        "spread / exact law": check.spread_over_exact.ravel(),
        "spread / short form d²/|t|": check.spread_over_paper.ravel(),
        "bias / second-order bias": check.bias_over_second_order.ravel(),
    }
    lost = int(np.isnan(kinds["spread / exact law"]).sum())
    pictures = [
        _ratios(
            relative,
            {"spread / exact law": INK, "spread / short form d²/|t|": theme.PIXEL},
            kinds,
            "(a) spread",
            (0.5, 2.6),
        ),
        _ratios(relative, {"bias / second-order bias": INK}, kinds, "(b) bias", (0.0, 3.0)),
    ]
    small = check.relative_spread[..., 0].max()
    rows = []
    for name, values, at_smallest in (
        ("Spread over the exact law", kinds["spread / exact law"], check.spread_over_exact[..., 0]),
        ("Spread over d²/|t|", kinds["spread / short form d²/|t|"], check.spread_over_paper[..., 0]),
        ("Bias over the second-order bias", kinds["bias / second-order bias"], check.bias_over_second_order[..., 2]),
        ("Spread from an error of |t| over d/|t| (eq. 10)", None, check.baseline_spread_over_eq10),
    ):
        finite = at_smallest[np.isfinite(at_smallest)]
        off = relative[np.abs(values - 1) > LINEAR] if values is not None else np.array([])
        end = number(float(off.min()), ".1f", 100) if off.size else Cell("–")
        rows.append(
            [
                words(name),
                number(float(np.median(finite)), ".3f"),
                number(float(finite.min()), ".3f"),
                number(float(finite.max()), ".3f"),
                end,
            ]
        )
    table = Table(
        [
            Heading("Measured over predicted", text=True),
            Heading("Median"),
            Heading("Smallest"),
            Heading("Largest"),
            Heading(f"First off by {100 * LINEAR:.0f}\u00a0%", "spread, % of the range"),
        ],
        rows,
    )
    data = Data(
        "law-geometry",
        ["relative_spread", "spread_over_exact", "spread_over_paper", "bias_over_second_order"],
        [list(each) for each in zip(relative, *kinds.values(), strict=True)],
    )
    return Part(
        {"ratios": pictures},
        {"geometry": table},
        {"ratios": data},
        {"lost": str(lost), "points": str(relative.size), "small": f"{100 * small:.1f}"},
    )


def _ratios(
    relative: Array, drawn: dict[str, str], kinds: dict[str, Array], title: str, span: tuple[float, float]
) -> Picture:
    fig = theme.figure(HALF, 300)
    ax = theme.axes(fig, 56, 30, HALF - 70, 224)
    ax.axhline(1, color=FAINT, linewidth=0.8)
    told = []
    for (name, colour), marker in zip(drawn.items(), "oD", strict=False):
        values = kinds[name]
        inside = np.clip(values, *span)
        beyond = np.isfinite(values) & (inside != values)
        ax.plot(
            100 * relative,
            np.where(beyond, np.nan, inside),
            marker,
            color=colour,
            markersize=3.6,
            markeredgewidth=0,
            alpha=0.75,
            label=name,
        )
        ax.plot(100 * relative[beyond], inside[beyond], "|", color=colour, markersize=6)
        told.append(f"{name} median {np.nanmedian(values):.3f}, largest {np.nanmax(values):.2f}")
    theme.logarithmic(ax, "x", 100 * float(relative.min()) / 1.2, 100 * float(relative.max()) * 1.2)
    ax.set_ylim(*span)
    ax.set_xlabel("predicted spread, law × σ / d (% of the range)")
    ax.set_ylabel("measured over predicted")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=2, borderaxespad=0.2, handletextpad=0.3)
    return theme.picture(
        fig,
        f"{title[4:].capitalize()} of the range measured over predicted, against the predicted relative spread: "
        f"{'; '.join(told)}.",
        title,
    )


# --- 2. Images ----------------------------------------------------------------------------------------------------


def images(sweep: Sweep, fits: list[Fit]) -> Part:
    """Regressions of the relative error on both laws."""
    pictures: list[Picture] = []
    binned: list[list[Any]] = []
    for way in sweep.ways:
        for surface in SURFACES:
            mine = {fit["law"]: fit for fit in fits if _is(fit, way, surface) and fit["slope"] is not None}
            if mine:
                pictures.append(_regression(sweep, way, surface, mine, binned))
    residual_rows: list[list[Any]] = []
    directions: list[list[Any]] = [
        [
            fit["matcher"],
            fit["subpixel"],
            fit["surface"],
            fit["law"],
            f"{each['from_deg']:g}-{each['to_deg']:g}",
            each["slope"],
            *(each["slope_ci95"] or (None, None)),
            each["r2"],
        ]
        for fit in fits
        for each in fit["by_alpha_1"]
    ]
    method = ["matcher", "subpixel", "surface", "law"]
    return Part(
        {
            "regression": pictures,
            "residuals": [
                _residuals(sweep, fits, surface, letter, residual_rows) for surface, letter in _lettered(sweep)
            ],
            "directions": [_directions(sweep, fits, surface, letter) for surface, letter in _lettered(sweep)],
        },
        {"slopes": _slope_table(sweep, fits), "conditions": _condition_table(sweep)},
        {
            "regression": Data(
                "law-images", [*method, "law_over_d", "cells", "median_spread_over_d", "ci95_low", "ci95_high"], binned
            ),
            "residuals": Data(
                "law-residuals", [*method, "law_over_d", "quartile_1", "median", "quartile_3"], residual_rows
            ),
            "directions": Data(
                "law-directions", [*method, "alpha_1_deg", "slope", "ci95_low", "ci95_high", "r2"], directions
            ),
        },
    )


def _lettered(sweep: Sweep) -> list[tuple[str, str]]:
    return list(zip(sweep.surfaces, "abcd", strict=False))


def _adjusted(cells: pd.DataFrame) -> "pd.Series[float]":
    """log(spread/d), every condition brought to the level of all."""
    y = np.log(cells["spread_m"] / cells["range_m"])
    return y - y.groupby(cells["condition"]).transform("mean") + y.mean()


def _regression(sweep: Sweep, way: Way, surface: str, fits: dict[str, Fit], binned: list[list[Any]]) -> Picture:
    there = sweep.cells[sweep.cells["surface"] == surface]
    cells = way.of(there)
    y = np.exp(_adjusted(cells))
    limits_y = _around(
        np.exp(pd.concat([_adjusted(each.of(there)) for each in sweep.ways if len(each.of(there))])), 0.003
    )
    limits_x = _around(pd.concat([there["law_exact"] / there["range_m"], there["law_paper"] / there["range_m"]]), 0.001)
    fig, panels = theme.pair(height=330, top=46)
    told = []
    for ax, law in zip(panels, LAWS, strict=True):
        theme.logarithmic(ax, "x", *limits_x, most=4)
        theme.logarithmic(ax, "y", *limits_y)
        ax.set_xlabel("exact law / $d$ (per rad)" if law == "exact" else "$d\\,/\\,|t|$ (per rad)")
        if law not in fits:
            theme.note(ax, "not fitted")
            continue
        fit = fits[law]
        x = cells[f"law_{law}"] / cells["range_m"]
        _density(ax, x, y, limits_x, limits_y)
        centre = float(np.exp(np.log(x).mean())), float(np.exp(np.log(y).mean()))
        ends = np.array([x.min(), x.max()])
        ax.plot(ends, centre[1] * (ends / centre[0]), color=theme.TRUTH, linestyle=(0, (4, 2.5)), linewidth=1.0)
        ax.plot(ends, centre[1] * (ends / centre[0]) ** fit["slope"], color=way.colour, linewidth=1.6)
        edges = log_edges(x, 9)
        index = np.digitize(x, edges) - 1
        points = []
        for i in range(9):
            inside = index == i
            if inside.sum() >= 8:
                median, low, high = median_over_seeds(y[inside].to_numpy(), cells["seed"][inside].to_numpy())
                at = math.sqrt(edges[i] * edges[i + 1])
                points.append((at, median, low, high))
                binned.append([way.matcher, way.subpixel, surface, law, at, int(inside.sum()), median, low, high])
        across, middle, lower, upper = np.array(points).reshape(-1, 4).T
        ax.vlines(across, lower, upper, color=way.colour, linewidth=1.4)
        ax.plot(
            across, middle, way.marker, color=way.colour, markersize=5, markerfacecolor=theme.PAPER, markeredgewidth=1.3
        )
        ci = fit["slope_ci95"]
        words_of_fit = f"slope {figure(fit['slope'], '.2f')}{'' if ci is None else ' ' + interval(ci, '.2f')}"
        ax.set_title(f"{words_of_fit}\nR² {fit['r2']:.2f}", fontsize=9.5)
        told.append(f"{'exact law' if law == 'exact' else 'short form'} {words_of_fit}, R² {fit['r2']:.2f}")
    panels[0].set_ylabel("spread / $d$, conditions aligned")
    name = f"{way.label}, {SURFACES[surface]}"
    return theme.picture(fig, f"Relative range error against the law over the range, {name}: {'; '.join(told)}.", name)


def _around(values: "pd.Series[float]", cut: float) -> tuple[float, float]:
    low, high = np.quantile(values, [cut, 1 - cut])
    return float(low) / 1.3, float(high) * 1.3


def _density(
    ax: Axes, x: "pd.Series[float]", y: "pd.Series[float]", limits_x: tuple[float, float], limits_y: tuple[float, float]
) -> None:
    """How many cells lie where, as a picture of few pixels."""
    counts, _, _ = np.histogram2d(np.log(x), np.log(y), bins=(40, 44), range=(np.log(limits_x), np.log(limits_y)))
    shown = np.sqrt(counts.T / max(counts.max(), 1))
    # On axes of their own: a picture is linear, the axes are logarithmic.
    below = ax.figure.add_axes(ax.get_position().bounds, zorder=ax.get_zorder() - 1)
    below.set_axis_off()
    below.imshow(
        np.round(shown * 20) / 20, cmap=_DENSE, origin="lower", aspect="auto", vmin=0, vmax=1, interpolation="none"
    )
    ax.patch.set_alpha(0)


def _residuals(sweep: Sweep, fits: list[Fit], surface: str, letter: str, rows: list[list[Any]]) -> Picture:
    fig, panels = theme.pair()
    there = sweep.cells[sweep.cells["surface"] == surface]
    limits = _around(pd.concat([there["law_exact"] / there["range_m"], there["law_paper"] / there["range_m"]]), 0.001)
    told, reach = [], [0.5]
    for ax, law in zip(panels, LAWS, strict=True):
        theme.logarithmic(ax, "x", *limits, most=4)
        ax.axhline(0, color=FAINT, linewidth=0.8)
        ax.set_title(LAW_NAMES[law])
        ax.set_xlabel("law / $d$ (per rad)")
        for number_of, way in enumerate(sweep.ways):
            fit = next((f for f in fits if _is(f, way, surface) and f["law"] == law and f["slope"] is not None), None)
            if fit is None:
                continue
            x, off = np.array(list(residuals(sweep.cells, fit))).T
            edges = log_edges(pd.Series(x), 9)
            index = np.digitize(x, edges) - 1
            points = [
                (math.sqrt(edges[i] * edges[i + 1]) * 1.03**number_of, *np.quantile(off[index == i], [0.25, 0.5, 0.75]))
                for i in range(9)
                if (index == i).sum() >= 8
            ]
            at, low, middle, high = np.array(points).reshape(-1, 4).T
            if len(sweep.ways) < 3:  # more would hide each other
                ax.vlines(at, low, high, color=way.colour, linewidth=1.1, alpha=0.8)
            else:
                low = high = middle
            ax.plot(
                at,
                middle,
                color=way.colour,
                linestyle=way.stroke,
                marker=way.marker,
                markersize=4,
                markerfacecolor=way.face,
            )
            rows += [[way.matcher, way.subpixel, surface, law, *each] for each in points]
            reach += [float(np.abs([low, high]).max())] if points else []
            told.append(
                f"{way.label} {_PLAIN[law]}: medians within {figure(float(middle.min()), '+.2f')} to "
                f"{figure(float(middle.max()), '+.2f')}"
            )
    for ax in panels:
        ax.set_ylim(-1.1 * max(reach), 1.1 * max(reach))
    panels[0].set_ylabel("residual, ln(measured / fitted)")
    name = SURFACES[surface]
    return theme.picture(
        fig, f"Residuals of the fits on {name} against the law over the range: {'; '.join(told)}.", f"({letter}) {name}"
    )


def _directions(sweep: Sweep, fits: list[Fit], surface: str, letter: str) -> Picture:
    fig, panels = theme.pair()
    middle = np.array([(low + high) / 2 for low, high in pairwise(ALPHA_1_EDGES_DEG)])
    told = []
    seen = [1.0]
    for ax, law in zip(panels, LAWS, strict=True):
        ax.axhline(1, color=theme.TRUTH, linestyle=(0, (4, 2.5)), linewidth=0.9)
        ax.set_title(LAW_NAMES[law])
        ax.set_xlim(ALPHA_1_EDGES_DEG[0], ALPHA_1_EDGES_DEG[-1])
        ax.set_xticks(ALPHA_1_EDGES_DEG[1:-1])
        ax.set_xlabel(r"angle to the baseline $\alpha_1$ (°)")
        for index, way in enumerate(sweep.ways):
            fit = next((each for each in fits if _is(each, way, surface) and each["law"] == law), None)
            if fit is None:
                continue
            x = middle + 3.0 * (index - (len(sweep.ways) - 1) / 2)
            slopes = np.array([np.nan if each["slope"] is None else each["slope"] for each in fit["by_alpha_1"]])
            bounds = np.array([each["slope_ci95"] or (np.nan, np.nan) for each in fit["by_alpha_1"]]).T
            ax.vlines(x, *bounds, color=way.colour, linewidth=1.3)
            ax.plot(x, slopes, way.marker, color=way.colour, markersize=4.6, markerfacecolor=way.face)
            known = slopes[np.isfinite(slopes)]
            if known.size:
                seen += [float(known.min()), float(known.max())]
                told.append(
                    f"{way.label} {_PLAIN[law]} {figure(float(known.min()), '.2f')} to "
                    f"{figure(float(known.max()), '.2f')}"
                )
    low, high = min(0.0, *seen), max(seen)
    for ax in panels:
        ax.set_ylim(low - 0.12 * (high - low), high + 0.2 * (high - low))
    panels[0].set_ylabel("slope")
    name = SURFACES[surface]
    return theme.picture(fig, f"Slopes on both laws by direction, {name}: {'; '.join(told)}.", f"({letter}) {name}")


def _slope_table(sweep: Sweep, fits: list[Fit]) -> Table:
    headings = [
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("Law", text=True),
        Heading("Slope"),
        Heading("95 % low"),
        Heading("95 % high"),
        Heading("R²"),
        Heading("Cells"),
    ]
    rows = [
        [
            words(SURFACES[surface]),
            words(way.label, way.colour),
            words("exact" if fit["law"] == "exact" else "d²/|t|"),
            *_slope_cells(fit),
            count(fit["cells"]),
        ]
        for surface in sweep.surfaces
        for way in sweep.ways
        for fit in fits
        if _is(fit, way, surface)
    ]
    return Table(headings, rows)


def _slope_cells(fit: Fit) -> list[Cell]:
    low, high = fit["slope_ci95"] or (None, None)
    return [number(fit["slope"], ".3f"), number(low, ".3f"), number(high, ".3f"), number(fit["r2"], ".2f")]


def _condition_table(sweep: Sweep) -> Table:
    """Slopes on the exact law within each condition; nothing when there is one only."""
    headings = [
        Heading("Condition", text=True),
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("Slope"),
        Heading("95 % low"),
        Heading("95 % high"),
        Heading("R²"),
        Heading("Off by over 1 px", "%"),
    ]
    rows: list[list[Cell]] = []
    if sweep.cells["condition"].nunique() < 2:
        return Table(headings, rows)
    for condition, cells in sweep.cells.groupby("condition", sort=False):
        fits = fit_laws(cells.assign(alpha_bin=-1))  # over all directions only: parts of each would take long
        for surface in sweep.surfaces:
            for way in sweep.ways:
                part = way.of(cells[cells["surface"] == surface])
                rows += [
                    [
                        words(in_words(str(condition))),
                        words(SURFACES[surface]),
                        words(way.label, way.colour),
                        *_slope_cells(fit),
                        number(float((part["gross"] * part["pixels"]).sum() / part["pixels"].sum()), ".0f", 100),
                    ]
                    for fit in fits
                    if _is(fit, way, surface) and fit["law"] == "exact"
                ]
    return Table(headings, rows)


# --- 3. Decomposition ---------------------------------------------------------------------------------------------


def decomposition(sweep: Sweep, law: dict[str, Any], column_deg: float) -> Part:
    """How the angle's own error grows, and the baseline that is best for a range."""
    rows: list[list[Any]] = []
    cells = sweep.cells
    step = math.log(RANGE_RATIO)
    ratio_bin = np.round(np.log(cells["baseline_m"] / cells["range_m"]) / step)
    near = (RANGE_RATIO**ratio_bin).rename("x")
    middles = np.array([(low + high) / 2 for low, high in pairwise(ALPHA_1_EDGES_DEG)])
    direction = pd.Series(middles[cells["alpha_bin"].to_numpy()], index=cells.index)
    sigma_px = np.degrees(cells["sigma_alpha"]) / column_deg
    ratio_label = r"$|t|\,/\,d$"
    alpha_label = r"angle to the baseline $\alpha_1$ (°)"
    pictures = [
        _against(
            sweep,
            near,
            sigma_px,
            ratio_label,
            "$\\sigma(\\alpha_2)$ (px)",
            "(a) the angle’s spread",
            rows,
            "sigma_px",
            log_y=True,
        ),
        _against(
            sweep,
            near,
            cells["gross"],
            ratio_label,
            "off by over 1 px (% of estimates)",
            "(b) mismatches",
            rows,
            "gross",
            scale=100,
        ),
        _against(
            sweep,
            direction,
            sigma_px,
            alpha_label,
            "$\\sigma(\\alpha_2)$ (px)",
            "(c) by direction",
            rows,
            "sigma_px",
            log_y=True,
            log_x=False,
        ),
        _against(
            sweep,
            near,
            cells["missing"],
            ratio_label,
            "without an estimate (% of pixels)",
            "(d) lost",
            rows,
            "missing",
            scale=100,
        ),
    ]
    curves: list[list[Any]] = []
    trade = _trade_off(sweep, curves)
    return Part(
        {"sigma": pictures, "baseline": trade},
        {"sigma": _sigma_table(sweep, law), "baseline": _baseline_table(sweep, law)},
        {
            "sigma": Data(
                "law-decomposition",
                ["matcher", "subpixel", "surface", "measure", "against", "at", "mean", "ci95_low", "ci95_high"],
                rows,
            ),
            "baseline": Data(
                "law-best-baseline",
                ["matcher", "subpixel", "surface", "range_m", "baseline_m", "spread_m", "ci95_low", "ci95_high"],
                curves,
            ),
        },
    )


def _against(
    sweep: Sweep,
    x: "pd.Series[float]",
    y: "pd.Series[float]",
    label: str,
    ordinate: str,
    title: str,
    rows: list[list[Any]],
    name: str,
    *,
    log_x: bool = True,
    log_y: bool = False,
    scale: float = 1.0,
) -> Picture:
    fig, panels = theme.pair()
    told, seen = [], []
    for ax, (surface, surface_words) in zip(panels, SURFACES.items(), strict=True):
        ax.set_title(surface_words)
        for way in sweep.ways:
            cells = way.of(sweep.cells[sweep.cells["surface"] == surface])
            if cells.empty:
                continue
            table = cells.assign(x=x[cells.index], value=y[cells.index]).pivot_table(
                index=["seed", "condition"], columns="x", values="value", aggfunc=_log_mean if log_y else "mean"
            )
            curve = mean_over_seeds(table, logarithmic=log_y)
            at = [float(value) for value in table.columns]
            draw_line(ax, way, at, curve, scale)
            seen += [scale * curve.mean, scale * curve.low, scale * curve.high]
            told.append(
                f"{way.label} on {surface_words} from {scale * curve.mean[0]:.3g} to {scale * curve.mean[-1]:.3g}"
            )
            against = "t_over_d" if log_x else "alpha_1_deg"
            rows += [
                [way.matcher, way.subpixel, surface, name, against, *each]
                for each in zip(at, curve.mean, curve.low, curve.high, strict=True)
            ]
    known = np.concatenate(seen)
    known = known[np.isfinite(known)]
    for ax in panels:
        if log_x:
            theme.logarithmic(ax, "x", float(x.min()) / 1.15, float(x.max()) * 1.15, most=5)
        else:
            ax.set_xlim(ALPHA_1_EDGES_DEG[0], ALPHA_1_EDGES_DEG[-1])
            ax.set_xticks(ALPHA_1_EDGES_DEG[1:-1])
        if log_y:
            theme.logarithmic(ax, "y", float(known.min()) / 1.25, float(known.max()) * 1.25)
        else:
            ax.set_ylim(0, max(1.08 * float(known.max()), 1.0))
        ax.set_xlabel(label)
    panels[0].set_ylabel(ordinate)
    plain = ordinate.replace("$\\sigma(\\alpha_2)$", "sigma of alpha 2")
    return theme.picture(fig, f"{plain} against {'|t|/d' if log_x else 'alpha 1'}: {'; '.join(told)}.", title)


def _log_mean(values: "pd.Series[float]") -> float:
    return float(np.exp(np.log(values).mean()))


def _sigma_table(sweep: Sweep, law: dict[str, Any]) -> Table:
    headings = [
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("σ(α₂) on |t|/d", "power"),
        Heading("95 % low"),
        Heading("95 % high"),
    ]
    rows = []
    for surface in sweep.surfaces:
        for way in sweep.ways:
            for each in law["sigma_alpha"]:
                if _is(each, way, surface):
                    low, high = each["slope_ci95"] or (None, None)
                    rows.append(
                        [
                            words(SURFACES[surface]),
                            words(way.label, way.colour),
                            number(each["slope_on_t_over_d"], "+.3f"),
                            number(low, "+.3f"),
                            number(high, "+.3f"),
                        ]
                    )
    return Table(headings, rows)


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
                if not _is(each, way, surface):
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
