"""The causes of range errors: the error of each, predicted and measured, alone and together."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import FuncFormatter, NullFormatter

from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import FAINT, HALF, INK, SPARE, Picture

Entry = dict[str, Any]

_WORDS = """
<p>Images come from the true rig, and are matched with one that is believed: off by errors that each seed draws. What
each cause does to the range follows from its standard deviation by propagation through both views (predicted), and
shows in the errors themselves (measured).{% if worst %} Errors over those that follow from the draws, where
they are more than 10 % off and the interval leaves out 1: {{ worst }}. What is left over there is the matcher’s own,
which it does not predict (edges, grazing walls).{% endif %}</p>
"""
_CAPTION = """
Errors of the range that 68 % of the pixels of all seeds stay within, against {{ over.words }}:
(a) each cause alone, on top of the matcher’s own part; (b) all together. Lines: predicted; marks with 95 % intervals
over seeds: measured{% if alone %}; crosses: the root of the sum of squares of what each cause did alone{% endif %}.
"""
_TABLE = """
The same in figures. Measured over predicted is 1 where the propagation is right and the seeds are many: {{ seeds }}
draws of one number tell its standard deviation to {{ "%.0f" | format(100 / (2 * seeds) ** 0.5) }} %. Measured over
drawn is 1 where it is right, however few they are: what was measured over what follows from these very draws.
"""
_COLOURS = {
    "rotation": theme.PIXEL,
    "t direction": SPARE[3],
    "t length": SPARE[1],
    "odometry": theme.OCHRE,
    "calibration": SPARE[0],
    "alignment": theme.SUBPIXEL,
    "alignment, calibrated": SPARE[2],
}
_SPARE = (theme.PIXEL, theme.SUBPIXEL, *SPARE)
_MARKS = {
    "rotation": "o",
    "t direction": "s",
    "t length": "^",
    "odometry": "<",
    "calibration": "D",
    "alignment": "v",
    "alignment, calibrated": "P",
}


class Over(NamedTuple):
    """The abscissa of an error plot."""

    key: str
    """The field of an entry that holds it."""
    words: str
    label: str
    unit: str
    is_logarithmic: bool


RANGE = Over("range_m", "the range, 30° or more off the baseline", "range (m)", "m", True)
DIRECTION = Over("alpha_1_deg", "the angle to the baseline, all ranges together", r"$\alpha_1$ (°)", "degrees", False)


@section_of(About.ALL_TRIALS, "budget", "What limits the range")
def section(context: Context) -> Iterator[Block]:
    """Figures and a table; nothing where no trial has a budget."""
    entries: list[Entry] = context.summary.get("budget") or []
    if not entries:
        return
    first = (entries[0]["matcher"], entries[0]["subpixel"])
    mine = [each for each in entries if (each["matcher"], each["subpixel"]) == first]
    seeds = max(each["seeds"] for each in mine)
    yield Paragraph(html(_WORDS, worst=_worst(mine)))
    alone = any(each["alone_m"] for each in mine)
    yield Figure("figure-budget", _pictures(mine, RANGE), html(_CAPTION, over=RANGE, alone=alone))
    yield TableBlock("table-budget", _table(mine), html(_TABLE, seeds=seeds))
    sideways: list[Entry] = context.summary.get("budget_by_direction") or []
    sideways = [each for each in sideways if (each["matcher"], each["subpixel"]) == first]
    if sideways:
        alone = any(each["alone_m"] for each in sideways)
        yield Figure(
            "figure-budget-direction", _pictures(sideways, DIRECTION), html(_CAPTION, over=DIRECTION, alone=alone)
        )


def _pictures(entries: list[Entry], over: "Over") -> list[Picture]:
    return [_alone([each for each in entries if len(each["causes"]) < 2], over), _together(entries, over)]


def _worst(entries: list[Entry]) -> str:
    """The cases and ranges whose errors differ from those of the draws by over 10 %, beyond doubt, with the ratio."""
    ratios_by_name: dict[str, dict[float, list[float]]] = {}
    for each in entries:
        ratio, ends = each["over_drawn"], each["over_drawn_ci95"]
        if ends and abs(ratio - 1) > 0.1 and not ends[0] <= 1 <= ends[1]:
            ratios_by_name.setdefault(_named(each), {}).setdefault(each["range_m"], []).append(ratio)
    return "; ".join(
        f"{name} {', '.join(f'{_between(ratios)} at {range_m:.2g} m' for range_m, ratios in at.items())}"
        for name, at in ratios_by_name.items()
    )


def _between(values: list[float]) -> str:
    low, high = f"{min(values):.2f}", f"{max(values):.2f}"
    return low if low == high else f"{low} to {high}"


_FROM_EACH = "from each alone"


def _named(entry: Entry) -> str:
    """The case's name, or else the cause."""
    causes = entry["causes"]
    if entry.get("case"):
        return str(entry["case"])
    return "the matcher alone" if not causes else causes[0] if len(causes) == 1 else "all together"


def _looks(entries: list[Entry]) -> dict[str, tuple[str, str]]:
    """Distinct colours and marks of the curves: a cause's own where no other case has the same cause."""
    names = dict.fromkeys(map(_named, entries))
    causes = {_named(each): each["causes"][0] for each in entries if len(each["causes"]) == 1}
    of_none = [name for name in names if name not in causes]
    looks: dict[str, tuple[str, str]] = {of_none[0]: (FAINT if causes else INK, "o")} if len(of_none) == 1 else {}
    for name, cause in causes.items():
        if list(causes.values()).count(cause) == 1:
            looks[name] = (_COLOURS[cause], _MARKS[cause])
    free = (
        (_SPARE[(i + shift) % len(_SPARE)], mark) for shift in range(len(_SPARE)) for i, mark in enumerate("osv^DP<")
    )
    spare = itertools.cycle([look for look in free if look not in looks.values()])
    return {name: looks[name] if name in looks else next(spare) for name in names}


def _columns(names: Iterable[str]) -> int:
    """The number of names that fit beside each other above a panel without being shortened."""
    longest = max(map(len, names))
    return 3 if longest <= 22 else 2 if longest <= 36 else 1


def _axes(entries: list[Entry], names: Sequence[str], over: Over) -> tuple[Any, Any]:
    above = max(62, 14 + 16 * math.ceil(len(names) / _columns(names)))
    fig = theme.figure(HALF, 298 + above)
    ax = theme.axes(fig, 64, above, HALF - 80, 248)
    ax.set_xlabel(over.label)
    ax.set_ylabel("range error, 68 % within (mm)")
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    middles = sorted({each[over.key] for each in entries})
    if over.is_logarithmic:
        ax.set_xscale("log")
        ax.set_xticks(
            [tick for tick in (0.25, 0.5, 1, 2, 4, 8, 16, 32) if middles[0] / 1.3 <= tick <= 1.3 * middles[-1]]
        )
    else:
        ax.set_xticks(middles)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    values = [1000 * v for e in entries for v in (e["total_m"], e["measured_m"]) if v > 0]
    theme.logarithmic(ax, "y", 0.7 * min(values), 1.5 * max(values))
    return fig, ax


def _draw(ax: Any, entries: list[Entry], over: Over, look: tuple[str, str], label: str) -> None:
    colour, mark = look
    entries = sorted(entries, key=lambda each: each[over.key])
    x = [each[over.key] for each in entries]
    ax.plot(x, [1000 * each["total_m"] for each in entries], color=colour, linewidth=1.2)
    measured = np.array([1000 * each["measured_m"] for each in entries])
    ends = np.array([each["measured_ci95_m"] or [np.nan, np.nan] for each in entries]) * 1000
    ax.vlines(x, ends[:, 0], ends[:, 1], color=colour, linewidth=0.9, alpha=0.7)
    ax.plot(x, measured, mark, color=colour, markersize=5, label=label)


@theme.panel
def _alone(entries: list[Entry], over: Over) -> Picture:
    names = list(dict.fromkeys(_named(each) for each in entries))
    fig, ax = _axes(entries, names, over)
    for name, look in _looks(entries).items():
        _draw(ax, [each for each in entries if _named(each) == name], over, look, theme.plain(name))
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=_columns(names))
    ends = "; ".join(f"{name} {_last(entries, name, over):.1f} mm" for name in names)
    return theme.picture(
        fig, f"Range errors by cause against {over.words}; at the last {ends}.", "(a) each cause alone"
    )


def _last(entries: list[Entry], name: str, over: Over) -> float:
    return 1000 * float(max((e for e in entries if _named(e) == name), key=lambda e: e[over.key])["measured_m"])


@theme.panel
def _together(entries: list[Entry], over: Over) -> Picture:
    joint = [each for each in entries if len(each["causes"]) > 1] or entries
    names = [*dict.fromkeys(map(_named, joint)), _FROM_EACH]
    fig, ax = _axes(joint, names, over)
    for name, look in _looks(joint).items():
        _draw(ax, [each for each in joint if _named(each) == name], over, look, theme.plain(name))
    known = sorted((each for each in joint if each["alone_m"]), key=lambda each: each[over.key])
    if known:
        x, y = [each[over.key] for each in known], [1000 * each["alone_m"] for each in known]
        ax.plot(x, y, "x", color=theme.PIXEL, markersize=6, label=_FROM_EACH)
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=_columns(names))
    last = max(joint, key=lambda each: each[over.key])
    alt = (
        f"Range errors of all causes together: {1000 * last['measured_m']:.1f} mm measured at {last[over.key]:.1f} "
        f"{over.unit}."
    )
    return theme.picture(fig, alt, "(b) all together")


def _table(entries: list[Entry]) -> Table:
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for each in sorted(entries, key=lambda e: (len(e["causes"]), e["causes"], _named(e), e["range_m"])):
        low, high = each["measured_ci95_m"] or (None, None)
        ratio, of_draws = each["measured_m"] / each["total_m"], each["over_drawn"]
        below, above = each["over_drawn_ci95"] or (None, None)
        own = each["predicted_m"][each["causes"][0]] if len(each["causes"]) == 1 else None
        figures = [
            each["range_m"],
            own,
            each["total_m"],
            each["measured_m"],
            low,
            high,
            ratio,
            of_draws,
            below,
            above,
            each["alone_m"],
        ]
        rows.append(
            [
                words(_named(each).replace(" ", "\u00a0")),
                number(each["range_m"], ".2f"),
                number(own, ".2f", 1000),
                number(each["total_m"], ".2f", 1000),
                number(each["measured_m"], ".2f", 1000),
                number(low, ".2f", 1000),
                number(high, ".2f", 1000),
                number(ratio, ".2f"),
                number(of_draws, ".2f"),
                number(below, ".2f"),
                number(above, ".2f"),
                number(each["alone_m"], ".2f", 1000),
                count(each["seeds"]),
            ]
        )
        plain.append([_named(each), each["condition"], *figures, each["seeds"]])
    head = [
        Heading("Cause", text=True),
        Heading("Range", "m"),
        Heading("Cause, predicted", "mm"),
        Heading("All, predicted", "mm"),
        Heading("Measured", "mm"),
        Heading("from", "mm"),
        Heading("to", "mm"),
        Heading("Measured / predicted"),
        Heading("Measured / drawn"),
        Heading("from"),
        Heading("to"),
        Heading("From each alone", "mm"),
        Heading("Seeds"),
    ]
    names = [
        "range_m",
        "cause_m",
        "predicted_m",
        "measured_m",
        "low_m",
        "high_m",
        "ratio",
        "over_drawn",
        "over_drawn_low",
        "over_drawn_high",
        "from_each_alone_m",
        "seeds",
    ]
    return Table(head, rows, Data("budget", ["cause", "condition", *names], plain))
