"""Range profiles as a robot uses them: figures by method, which obstacles are found, and plans of one."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from harness.pipeline.scan import ScoredScan, scan_of
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.method_styles import Method, looks
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import HALF, INK, Picture
from harness.runs.methods import MethodName
from harness.runs.scans import MEANS, scans_conclusions

Entry = dict[str, Any]
Labels = Mapping[MethodName, str]

_WORDS = """
<p>For each of {{ scan.bearings }} bearings the horizontal distance of the nearest obstacle between
{{ "%.3g" | format(scan.low_m) }} and {{ "%.3g" | format(scan.high_m) }} m of height, from the ranges of each matcher,
beside that cut from the scene itself. {{ sentence }}</p>
"""
_TABLE = """
Profiles against the truth, means over seeds{% if intervals %} with 95 % intervals{% endif %}. An estimate is right
within {{ "%.3g" | format(100 * scan.tolerance) }} % of the true distance; bias and RMS are of the right ones.
Missed: it is farther than that, and a robot would drive into what is there. False: it is nearer. 68.3 and 95.4 % of the
errors should be within 1 and 2 σ.
"""
_OBSTACLES = """
What stands in front of something: its mean angle as seen, and in how many of the views each method has found it
(an estimate within the tolerance at a bearing that it covers, even in part).
"""
_PLAN = """
Profiles from above, view 1 in the middle, x to the right. Black: the truth. Coloured: the estimate, with bars of one
standard deviation where they are longer than a dot. Crosses: obstacles that were not found.
"""
_LONGEST_BARS = 720


@section_of(About.ALL_TRIALS, "range-profiles", "Range profiles of a robot")
def section(context: Context) -> Iterator[Block]:
    """A sentence, two tables and plans; nothing where no trial has a profile."""
    entries: list[Entry] = context.summary.get("scans") or []
    if not entries:
        return
    labels, scan = context.result.experiment.method_labels, context.trial.scan
    names = context.result.experiment.names_of_methods
    yield Paragraph(html(_WORDS, scan=scan, sentence=" ".join(scans_conclusions(entries, names))))
    intervals = any(each["seeds"] > 1 for each in entries)
    yield TableBlock("table-scans", _table(entries, labels), html(_TABLE, scan=scan, intervals=intervals))
    if any(each["obstacles"] for each in entries):
        yield TableBlock("table-obstacles", _obstacles(entries, labels), html(_OBSTACLES))
    scans = [(each, scan_of(each.outcome)) for each in context.methods]
    panels = [_plan(method, scored) for method, scored in scans if scored is not None]
    if panels:
        yield Figure("figure-scans", panels, html(_PLAN))


def _looks(entries: list[Entry], labels: Labels) -> dict[tuple[str, str], Any]:
    return looks(list(dict.fromkeys((each["matcher"], each["subpixel"]) for each in entries)), labels)


def _table(entries: list[Entry], labels: Labels) -> Table:
    several = len({each["condition"] for each in entries}) > 1
    appearance = _looks(entries, labels)
    shown = {
        "density": (Heading("Density", "%"), ".1f", 100),
        "bias_m": (Heading("Bias", "mm"), "+.1f", 1000),
        "rms_m": (Heading("RMS error", "mm"), ".1f", 1000),
        "median_abs_m": (Heading("Median |error|, all", "mm"), ".1f", 1000),
        "within_1_sigma": (Heading("Within 1 σ", "%"), ".1f", 100),
        "within_2_sigma": (Heading("Within 2 σ", "%"), ".1f", 100),
        "missed": (Heading("Missed", "%"), ".2f", 100),
        "false": (Heading("False", "%"), ".2f", 100),
    }
    rows: list[list[Cell]] = []
    for each in entries:
        look = appearance[each["matcher"], each["subpixel"]]
        names = [words(look.label, look.colour), *([words(each["condition"])] if several else [])]
        cells = [number(each[name], form, scale, each[f"{name}_ci95"]) for name, (_, form, scale) in shown.items()]
        rows.append([*names, count(each["seeds"]), *cells])
    head = [Heading("Method", text=True), *([Heading("Condition", text=True)] if several else []), Heading("Seeds")]
    plain = [[each[name] for name in ("matcher", "subpixel", "condition", "seeds", *MEANS)] for each in entries]
    named = ["matcher", "subpixel", "condition", "seeds", *MEANS]
    return Table([*head, *(heading for heading, _, _ in shown.values())], rows, Data("range-profiles", named, plain))


def _obstacles(entries: list[Entry], labels: Labels) -> Table:
    """A row for each obstacle, a column for each method, of the first condition."""
    mine = [each for each in entries if each["condition"] == entries[0]["condition"]]
    appearance = _looks(mine, labels)
    by_method = [{each["name"]: each for each in entry["obstacles"]} for entry in mine]
    rows: list[list[Cell]] = []
    for each in mine[0]["obstacles"]:
        cells = [
            number(found["found"] / found["seen"], ".0f", 100)
            if (found := table.get(each["name"]))
            else number(None, "")
            for table in by_method
        ]
        rows.append([words(each["name"]), number(each["width_deg"], ".2f"), count(each["seen"]), *cells])
    methods = [appearance[entry["matcher"], entry["subpixel"]].label for entry in mine]
    head = [Heading("Obstacle", text=True), Heading("Angle", "°"), Heading("Views")]
    plain = [[cell.text if i == 0 else cell.value for i, cell in enumerate(row)] for row in rows]
    data = Data("obstacles", ["obstacle", "angle_deg", "views", *(f"{each} found_%" for each in methods)], plain)
    return Table([*head, *(Heading(each, "%") for each in methods)], rows, data)


@theme.panel
def _plan(method: Method, scored: ScoredScan) -> Picture:
    fig = theme.figure(HALF, HALF - 16)
    ax = theme.axes(fig, 52, 12, HALF - 72, HALF - 72)
    true, profile = scored.true, scored.profile
    half = 1.1 * float(np.nanmax(true.fine_m)) if np.isfinite(true.fine_m).any() else 1.0
    phi = -np.pi + (np.arange(true.fine_m.size) + 0.5) * 2 * np.pi / true.fine_m.size
    ax.plot(true.fine_m * np.cos(phi), true.fine_m * np.sin(phi), color=INK, linewidth=0.8)
    x, y = profile.points_m.T
    theme.dots(ax, x, y, method.colour, 2.0)
    _bars(ax, scored, method.colour)
    lost = [each for each in scored.obstacles if not each.found]
    middle = [phi[(each.begin + each.end) // 2 % phi.size] for each in lost]
    ax.plot(
        [each.range_m * np.cos(at) for each, at in zip(lost, middle, strict=True)],
        [each.range_m * np.sin(at) for each, at in zip(lost, middle, strict=True)],
        "x", color=theme.PIXEL, markersize=7, markeredgewidth=1.5, zorder=5,
    )  # fmt: skip
    ax.plot(0, 0, "+", color=INK, markersize=7)
    ax.set_xlim(-half, half)
    ax.set_ylim(-half, half)
    ax.set_aspect("equal")
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    score = scored.score
    text = f"{score.obstacles_found} of {score.obstacles} obstacles found"
    alt = (
        f"Plan of the range profile of {method.label} and of the true one; {text}, {score.missed:.1%} of the bearings "
        f"missed, {score.false:.1%} false."
    )
    return theme.picture(fig, alt, f"{method.label}: {text}")


def _bars(ax: Axes, scored: ScoredScan, colour: str) -> None:
    """One standard deviation to either side, as one line with gaps."""
    profile = scored.profile
    shown = np.flatnonzero(profile.known & np.isfinite(profile.sigma_m))[:_LONGEST_BARS]
    ends = profile.range_m[shown, None] + profile.sigma_m[shown, None] * np.array([-1.0, 1.0, np.nan])
    bearing = profile.bearing[shown, None]
    ax.plot((ends * np.cos(bearing)).ravel(), (ends * np.sin(bearing)).ravel(), color=colour, linewidth=0.7)
