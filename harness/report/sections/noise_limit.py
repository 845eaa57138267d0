"""Spread of the methods against the Cramér-Rao bound, over the noise."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from harness.evaluation.efficiency import GROSS_PX
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.sweep import MethodStyle, Sweep, in_words
from harness.report.theme import HALF, Picture

Entry = dict[str, Any]
"""An entry of the summary's `limit`."""


_WORDS = """
<p>The spread of an unbiased matcher over draws of the noise cannot be less than the Cramér-Rao bound, which follows
from the noise of both mirror images, the texture that its window covers, and the number of parameters that it
estimates. Spread and bias are separated here, and errors above {{ "%g" | format(gross_px) }} px are counted apart from
both, since a wrong match is not an imprecise one. A biased matcher, such as one that rounds to whole samples, can have
less spread than the bound; so can one that looks beyond its window or assumes smoothness.</p>
"""
_SPREAD = """
Spread of the disparity over draws of the noise, each pixel against its own bound
{%- if condition %}, for {{ condition }}{% endif %}: (a) medians over pixels of the ratio; 1 is the limit;
(b) median spread, bias and bound. The bound holds for each method’s own window: the raw mirror pixels that it covers,
known noise, a plane surface; slant, gain and offset count as unknown for methods that fit them. Pixels whose window
holds a discontinuity have no bound and are left out. Methods without a window of their own are not drawn in (a).
"""
_TABLE = """
Sampled pixels of the domain. Spread: median standard deviation over seeds, corrected for their number; bias: median of
|mean error| over seeds, less what the spread explains. Within 1σ: share of errors within one standard deviation as the
method predicts it; 68.3 % if the prediction is right. Without noise there is no spread. The
figures are of all pixels and seeds together, without intervals; the figure shows the quartiles of the pixels.
"""


@section_of(About.ALL_TRIALS, "limit", "The limit that noise sets")
def section(context: Context) -> Iterator[Block]:
    """Spread against the bound; nothing where the summary has no `limit`."""
    if "limit" in context.summary:
        limited = limit(context.sweep, context.summary["limit"])
        yield Paragraph(html(_WORDS, gross_px=GROSS_PX))
        yield Figure("figure-limit", limited.pictures, html(_SPREAD, condition=limited.condition), data=limited.data)
        yield TableBlock("table-limit", limited.table, html(_TABLE))


@dataclass(frozen=True)
class Limit:
    """Figures and a table."""

    pictures: list[Picture]
    table: Table
    data: Data
    condition: str
    """The condition that the figures are about, in words; empty if there is one only."""


def limit(sweep: Sweep, entries: list[Entry]) -> Limit:
    """Draw and tabulate the `limit` of a summary."""
    conditions = list(dict.fromkeys(entry["condition"] for entry in entries))
    # Where chips differ, and white noise does not vary, each setting of the chip is a noise level.
    is_of_chips = len({entry["sigma_grey"] for entry in entries}) == 1 < len({entry["noise_grey"] for entry in entries})
    drawn = [entry for entry in entries if is_of_chips or entry["condition"] == conditions[0]]
    of_method = [(method, [each for each in drawn if _is_of(each, method)]) for method in sweep.methods]
    return Limit(
        pictures=[_efficiency(of_method, joined=not is_of_chips), _apart(of_method, joined=not is_of_chips)],
        table=_table(sweep, entries, several=len(conditions) > 1),
        data=Data("limit", _NAMES, [[_flat(entry, name) for name in _NAMES] for entry in entries]),
        condition=in_words(sweep.conditions[conditions[0]]) if len(conditions) > 1 and not is_of_chips else "",
    )


_NAMES = [
    "matcher",
    "subpixel",
    "condition",
    "sigma_grey",
    "noise_grey",
    "seeds",
    "density",
    "median_abs_px",
    "bad_1px",
    "bad_3px",
    "bound_px",
    "std_px",
    "bias_px",
    "std_over_bound",
    "rms_over_bound",
    "within_1_sigma",
    "within_2_sigma",
    "within_3_sigma",
]


def _flat(entry: Entry, name: str) -> Any:
    if not name.startswith("within_"):
        return entry[name]
    within = entry["within_sigma"]
    return within[int(name[len("within_")]) - 1] if within else None


def _is_of(entry: Entry, method: MethodStyle) -> bool:
    return (entry["matcher"], entry["subpixel"]) == (method.matcher, method.subpixel)


def _axes(ordinate: str) -> tuple[Any, Any]:
    fig = theme.figure(HALF, 340)
    ax = theme.axes(fig, 62, 50, HALF - 76, 240)
    ax.set_xlabel(r"noise $\sigma$ (grey levels)")
    ax.set_ylabel(ordinate)
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    return fig, ax


def _line(entries: list[Entry], value: Callable[[Entry], float | None]) -> tuple[list[float], list[float]]:
    known = sorted((each["noise_grey"], number) for each in entries if (number := value(each)))
    return [x for x, _ in known], [y for _, y in known]


@theme.panel
def _efficiency(of_method: list[tuple[MethodStyle, list[Entry]]], *, joined: bool) -> Picture:
    fig, ax = _axes("standard deviation / bound")
    ax.axhline(1, color=theme.TRUTH, linewidth=1.0, zorder=1)
    described, values = [], [1.0]
    for method, entries in of_method:
        x, y = _line(entries, lambda entry: entry["std_over_bound"])
        if not x:
            continue
        ax.plot(
            x,
            y,
            color=method.colour,
            linestyle=method.stroke if joined else "none",
            marker=method.marker,
            markersize=4.5,
            label=theme.plain(method.label),
        )
        in_order = sorted(entries, key=lambda each: (each["noise_grey"], each["std_over_bound"] or 0))
        ends = [each["std_over_bound_quartiles"] for each in in_order if each["std_over_bound"]]
        low, high = (np.array([end[i] for end in ends]) for i in (0, 1))
        ax.vlines(x, low, high, color=method.colour, linewidth=0.8, alpha=0.6)
        values += [*low[low > 0], *high]
        described.append(f"{method.label} {y[0]:.2f} to {y[-1]:.2f}")
    theme.logarithmic(ax, "y", 0.85 * min(values), 1.2 * max(values))
    ax.set_xlim(0, None)
    if described:
        theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=3)
    else:
        theme.note(ax, "no method with a window of its own was run with noise and three seeds")
    alt = f"Standard deviation over the bound against the noise: {'; '.join(described) or 'nothing drawn'}."
    return theme.picture(fig, alt, "(a) efficiency: medians, strokes from quartile to quartile")


@theme.panel
def _apart(of_method: list[tuple[MethodStyle, list[Entry]]], *, joined: bool) -> Picture:
    fig, ax = _axes("disparity (px)")
    described, values = [], []
    for method, entries in of_method:
        x, std = _line(entries, lambda entry: entry["std_px"])
        if not x:
            continue
        style = {"color": method.colour, "markersize": 4.5}
        stroke = method.stroke if joined else "none"
        ax.plot(x, std, linestyle=stroke, marker=method.marker, label=theme.plain(method.label), **style)
        x_bias, bias = _line(entries, lambda entry: entry["bias_px"])
        dots = {"linestyle": (0, (1, 1.5))} if joined else {"linestyle": "none", "marker": "."}
        ax.plot(x_bias, bias, linewidth=1.0, **dots, **style)
        x_bound, bound = _line(entries, lambda entry: entry["bound_px"])
        if bound:
            thin = {"linewidth": 0.6} if joined else {"linestyle": "none", "marker": "_", "markersize": 12}
            ax.plot(x_bound, bound, color=method.colour, alpha=0.7, **thin)
        values += [*std, *bias, *bound]
        described.append(f"{method.label} spread {std[-1]:.3g} px, bias {bias[-1] if bias else 0:.3g} px")
    if values:
        theme.logarithmic(ax, "y", max(min(values) / 1.3, max(values) / 1000), 1.3 * max(values))
        theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=3)
    else:
        theme.note(ax, "no method was run with noise and three seeds")
    ax.set_xlim(0, None)
    ends = "; ".join(described) or "nothing drawn"
    alt = f"Spread and bias of the disparity against the noise; at the last point drawn of each {ends}."
    drawn = (
        "spread (marked lines), bias (dotted), bound (thin)" if joined else "spread (discs), bias (dots), bound (bars)"
    )
    return theme.picture(fig, alt, f"(b) {drawn}")


def _table(sweep: Sweep, entries: list[Entry], *, several: bool) -> Table:
    headings = [
        Heading("Method", text=True),
        *([Heading("Setting", text=True)] if several else []),
        Heading("Noise", "grey"),
        Heading("Seeds"),
        Heading("Density", "%"),
        Heading("Median |error|", "px"),
        Heading(f"Above {GROSS_PX:g}\u00a0px", "%"),
        Heading("Spread", "px"),
        Heading("Bias", "px"),
        Heading("Bound", "px"),
        Heading("Spread / bound"),
        Heading("Within 1σ", "%"),
        Heading("Within 2σ", "%"),
        Heading("Within 1σ, without bias", "%"),
    ]
    methods = {(method.matcher, method.subpixel): method for method in sweep.methods}
    rows: list[list[Cell]] = []
    for entry in entries:
        method = methods[entry["matcher"], entry["subpixel"]]
        within = entry["within_sigma"] or (None, None)
        without_bias = entry["within_sigma_without_bias"] or (None,)
        rows.append(
            [
                words(method.label, method.colour),
                *([words(in_words(sweep.conditions[entry["condition"]]))] if several else []),
                number(entry["noise_grey"], ".3g"),
                count(entry["seeds"]),
                number(entry["density"], ".1f", 100),
                number(entry["median_abs_px"], ".3f"),
                number(entry["bad_3px"], ".2f", 100),
                number(entry["std_px"], ".3f"),
                number(entry["bias_px"], ".3f"),
                number(entry["bound_px"], ".4f"),
                number(entry["std_over_bound"], ".2f"),
                number(within[0], ".1f", 100),
                number(within[1], ".1f", 100),
                number(without_bias[0], ".1f", 100),
            ]
        )
    return Table(headings, rows)
