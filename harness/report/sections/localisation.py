"""Localisation by appearance: the error against the number of real images, and what made views are worth."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, NullLocator

from harness.pipeline.localise import WAYS
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import HALF, Picture
from harness.runs.localisations import APPEARANCES, WAYS_IN_WORDS, localisations_conclusions
from harness.runs.methods import MethodName

Entry = dict[str, Any]
Labels = Mapping[MethodName, str]

_WORDS = """
<p>Does range from a pair replace images, and how many? {{ settings.queries }} new images a seed, turned by any yaw, are
placed by what they look like. What is learned from: the images of pairs; these and {{ settings.synthesised }} views
made of each pair with its ranges; and as many single images at places of their own, which is what the real images
could have been spent on.</p>
{% if sentences %}
<ul>
{% for each in sentences %}<li>{{ each | unbroken }}</li>
{% endfor %}
</ul>
{% endif %}
"""
_CAPTION = """
Mean distance of new images from where they are placed, against the number of real images learned from; means over
{{ seeds }} seed{{ "s" if seeds != 1 }}{% if seeds > 1 %}, with 95 % intervals{% endif %}. Lower is better.
Points of the same number are set side by side.
"""
_GAINS = """
What the views are worth. Error: the mean error with the views that were made over that of the pairs alone; below 1 they
help. As good as: the number of single images with the same error, of the pairs with the views and of the pairs alone.
Replaced: the first over the second, how many times as many real images it is like; not where one of them is beyond what
was tried (≤, ≥), where intervals end, too.
"""
_COLOURS = {
    "pairs": theme.PIXEL,
    "synthesised": theme.SUBPIXEL,
    "true ranges": theme.FAINT,
    "singles": theme.INK,
}
_ASIDE = 1.04
"""The factor between the places of one number of images, so that bars do not hide each other."""
_STYLES = {"pairs": "o-", "synthesised": "o-", "true ranges": "o--", "singles": "o:"}


@section_of(About.ALL_TRIALS, "localisation", "Localisation by appearance")
def section(context: Context) -> Iterator[Block]:
    """A sentence, a figure for each descriptor, and a table; nothing where no trial has such a test."""
    entries: list[Entry] = context.summary.get("localisation") or []
    if not entries:
        return
    labels = context.result.experiment.method_labels
    names = context.result.experiment.names_of_methods
    sentences = localisations_conclusions(entries, names)
    yield Paragraph(html(_WORDS, settings=context.trial.localisation, sentences=sentences))
    first = entries[0]
    mine = [each for each in entries if all(each[key] == first[key] for key in ("matcher", "subpixel", "condition"))]
    panels = [_curves(each) for each in mine]
    yield Figure("figure-localisation", panels, html(_CAPTION, seeds=first["seeds"]), data=_data(entries))
    if any(each["gains"] for each in entries):
        yield TableBlock("table-localisation", _table(entries, labels), html(_GAINS))


@theme.panel
def _curves(entry: Entry) -> Picture:
    fig = theme.figure(HALF, 400)
    ax = theme.axes(fig, 56, 84, HALF - 76, 262)
    ax.set_xscale("log")
    ax.set_xlabel("real images")
    ax.set_ylabel("mean error (m)")
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    handles, names = [], []
    every: list[int] = []
    for place, way in enumerate(WAYS):
        rows = [each for each in entry["errors"] if each["way"] == way]
        if not rows:
            continue
        every += [each["images"] for each in rows]
        aside = _ASIDE ** (place - (len(WAYS) - 1) / 2)
        x = [each["images"] * aside for each in rows]
        colour = _COLOURS[way]
        (line,) = ax.plot(x, [each["mean_m"] for each in rows], _STYLES[way], color=colour, markersize=4)
        ends = [each["mean_m_ci95"] or [np.nan, np.nan] for each in rows]
        ax.vlines(x, [low for low, _ in ends], [high for _, high in ends], color=colour, linewidth=1.0)
        handles.append(line)
        names.append(WAYS_IN_WORDS[way])
    ticks = sorted(set(every))
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_ylim(bottom=0)
    theme.legend_above(ax, handles, names, gap=0.3, most=2)
    title = APPEARANCES[entry["appearance"]]
    rows = [each for each in entry["errors"] if each["images"] == ticks[-2]]
    means = ", ".join(f"{WAYS_IN_WORDS[each['way']]} {each['mean_m']:.2f} m" for each in rows)
    return theme.picture(fig, f"Localisation error with {title}; from {ticks[-2]} real images: {means}.", title)


def _table(entries: list[Entry], labels: Labels) -> Table:
    several = len({(each["matcher"], each["subpixel"], each["condition"]) for each in entries}) > 1
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for entry in entries:
        method = labels.get((entry["matcher"], entry["subpixel"]), entry["matcher"])
        for gain in entry["gains"]:
            who = [words(method), words(entry["condition"])] if several else []
            cells = [
                number(gain["error_ratio"], ".2f", 1, gain["error_ratio_ci95"]),
                _bounded(gain, "worth"),
                _bounded(gain, "pairs_worth"),
                number(gain["replaced"], ".2f", 1, gain["replaced_ci95"]),
            ]
            rows.append([words(APPEARANCES[entry["appearance"]]), *who, count(gain["images"]), *cells])
            values = [gain[name] for name in ("error_ratio", "worth", "pairs_worth", "replaced")]
            plain.append([entry["appearance"], entry["matcher"], entry["condition"], gain["images"], *values])
    head = [Heading("Descriptor", text=True)]
    head += [Heading("Method", text=True), Heading("Condition", text=True)] if several else []
    head += [Heading("Real images"), Heading("Error, with views / without"), Heading("As good as, with views")]
    head += [Heading("As good as, pairs alone"), Heading("Replaced")]
    named = ["appearance", "matcher", "condition", "images", "error_ratio", "worth", "pairs_worth", "replaced"]
    return Table(head, rows, Data("made-views", named, plain))


def _bounded(gain: dict[str, Any], name: str) -> Cell:
    """A number of images, marked where it is at an end of those that were tried."""
    cell = number(gain[name], ".0f", 1, gain[f"{name}_ci95"])
    sign = {"at most": "≤\u00a0", "at least": "≥\u00a0"}.get(gain[f"{name}_bound"], "")
    return Cell(sign + cell.text, cell.value, below=cell.below)


def _data(entries: list[Entry]) -> Data:
    named = ["matcher", "condition", "appearance", "way", "images", "mean_m", "median_m", "nll"]
    rows = [
        [entry["matcher"], entry["condition"], entry["appearance"], *(each[name] for name in named[3:])]
        for entry in entries
        for each in entry["errors"]
    ]
    return Data("localisation", named, rows)
