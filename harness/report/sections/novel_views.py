"""Views from other viewpoints: how good they are against the distance, and pictures of one."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from harness.geometry.panorama import Grid
from harness.pipeline.novel_views import NovelView, novel_views
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.method_styles import Method, looks
from harness.report.panoramas import extent_of, panorama_axes, unmirrored
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import FAINT, INK, WIDE, Picture
from harness.runs.methods import MethodName
from harness.runs.novel_views import views_conclusions
from harness.warping.warp import shares_in_words

Entry = dict[str, Any]
Labels = Mapping[MethodName, str]

_WORDS = """
<p>The view from another viewpoint, warped from both images with each matcher’s ranges, against the rendered one.
{{ sentence }} Holes are filled from their surroundings before anything is counted.</p>
"""
_CAPTION = """
Peak signal-to-noise ratio of warped views, against their distance from the first viewpoint; means over {{ seeds }}
seed{{ "s" if seeds != 1 }}{% if seeds > 1 %}, with 95 % intervals{% endif %}. Dashed: the same warp with the true
ranges, the ceiling of any matcher. Dotted: the nearest of the two images as it is, the floor. Higher is better.
"""
_TABLE = """
The same in figures. Gain: warped less nearest image. WS-PSNR: pixels weighted by their solid angle. Holes: filled, as
no source shows what is there. Not seen before: what the first view cannot have seen, by the truth; its error is that of
the filled picture. Figures without an interval are means over seeds.
"""
_PICTURES = """
The view {{ "%.3g" | format(distance) }} m from the first viewpoint, with the ranges of {{ method }}: as rendered, as
warped (holes black), and the difference, ±{{ limit }} grey levels. Of the pixels compared {{ shares }}.
"""
_LIMIT_GREY = 64


@section_of(About.ALL_TRIALS, "novel-views", "Views from other viewpoints")
def section(context: Context) -> Iterator[Block]:
    """A sentence, a figure, a table and pictures; nothing where no trial has such views."""
    entries: list[Entry] = context.summary.get("novel_views") or []
    if not entries:
        return
    condition = entries[0]["condition"]
    mine = [each for each in entries if each["condition"] == condition]
    labels = context.result.experiment.method_labels
    names = context.result.experiment.names_of_methods
    seeds = max(each["seeds"] for each in mine)
    yield Paragraph(html(_WORDS, sentence=" ".join(views_conclusions(mine, names))))
    yield Figure("figure-novel-views", [_curves(mine, labels)], html(_CAPTION, seeds=seeds), "wide")
    yield TableBlock("table-novel-views", _table(entries, labels), html(_TABLE))
    if context.methods and context.trial.novel_views.distances_m:
        yield from _pictures(_best(context.methods, mine, labels), context.trial.panorama)


def _looks(entries: list[Entry], labels: Labels) -> dict[tuple[str, str], Any]:
    return looks(list(dict.fromkeys((each["matcher"], each["subpixel"]) for each in entries)), labels)


def _of(entries: list[Entry], matcher: str, subpixel: str) -> list[Entry]:
    return [each for each in entries if (each["matcher"], each["subpixel"]) == (matcher, subpixel)]


def _best(methods: list[Method], entries: list[Entry], labels: Labels) -> Method:
    """The method whose views are best on average, of those whose pixels are there."""
    means: dict[str, list[float]] = {}
    for (matcher, subpixel), look in _looks(entries, labels).items():
        means[look.label] = [each["psnr_db"]["warped"] for each in _of(entries, matcher, subpixel)]
    return max(methods, key=lambda each: float(np.mean(means.get(each.label, [-np.inf]))))


@theme.panel
def _curves(entries: list[Entry], labels: Labels) -> Picture:
    fig = theme.figure(WIDE, 360)
    ax = theme.axes(fig, 60, 50, WIDE - 90, 262)
    ax.set_xscale("log")
    ax.set_xlabel("distance from the first viewpoint (m)")
    ax.set_ylabel("PSNR (dB)")
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    handles, names = [], []
    for (matcher, subpixel), look in _looks(entries, labels).items():
        part = sorted(_of(entries, matcher, subpixel), key=lambda each: each["distance_m"])
        x = [each["distance_m"] for each in part]
        (line,) = ax.plot(x, [each["psnr_db"]["warped"] for each in part], "o-", color=look.colour, markersize=4)
        ends = [each["psnr_ci95_db"]["warped"] or [np.nan, np.nan] for each in part]
        ax.vlines(x, [low for low, _ in ends], [high for _, high in ends], color=look.colour, linewidth=1.0)
        handles.append(line)
        names.append(look.label)
    first = sorted(_of(entries, entries[0]["matcher"], entries[0]["subpixel"]), key=lambda each: each["distance_m"])
    x = [each["distance_m"] for each in first]
    for name, style, colour, label in (("ceiling", "--", INK, "true ranges"), ("floor", ":", FAINT, "nearest image")):
        ax.plot(x, [each["psnr_db"][name] for each in first], style, color=colour, linewidth=1.3)
        handles.append(Line2D([], [], color=colour, linestyle=style))  # type: ignore[arg-type]
        names.append(label)
    ax.set_xticks(x)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    theme.legend_above(ax, handles, names, gap=0.3)
    values = ", ".join(
        f"{each['matcher']} {each['psnr_db']['warped']:.1f} dB" for each in entries if each["distance_m"] == x[-1]
    )
    return theme.picture(fig, f"PSNR of warped views against their distance; at {x[-1]:g} m {values}.")


def _table(entries: list[Entry], labels: Labels) -> Table:
    several = len({each["condition"] for each in entries}) > 1
    appearance = _looks(entries, labels)
    rows: list[list[Cell]] = []
    plain: list[list[Any]] = []
    for each in entries:
        look = appearance[each["matcher"], each["subpixel"]]
        names = [words(look.label, look.colour), *([words(each["condition"])] if several else [])]
        psnr, ends = each["psnr_db"], each["psnr_ci95_db"]
        cells = [
            number(psnr["warped"], ".2f", 1, ends["warped"]),
            number(each["gain_db"], "+.2f", 1, each["gain_ci95_db"]),
            number(psnr["ceiling"], ".2f"),
            number(each["ws_psnr_db"], ".2f"),
            number(each["ssim"], ".3f"),
            number(each["holes"], ".1f", 100),
            number(each["disoccluded"], ".1f", 100),
            number(each["disoccluded_rmse_grey"], ".1f"),
        ]
        rows.append([*names, number(each["distance_m"], ".3g"), count(each["seeds"]), *cells])
        values = [psnr["warped"], each["gain_db"], psnr["ceiling"], psnr["floor"]]
        values += [each[key] for key in ("ws_psnr_db", "ssim", "holes", "disoccluded", "disoccluded_rmse_grey")]
        plain.append([each["matcher"], each["subpixel"], each["condition"], each["distance_m"], each["seeds"], *values])
    head = [Heading("Method", text=True), *([Heading("Condition", text=True)] if several else [])]
    head += [Heading("Distance", "m"), Heading("Seeds"), Heading("PSNR", "dB"), Heading("Gain", "dB")]
    head += [Heading("PSNR, true ranges", "dB"), Heading("WS-PSNR", "dB"), Heading("SSIM"), Heading("Holes", "%")]
    head += [Heading("Not seen before", "%"), Heading("its RMS error", "grey")]
    named = ["matcher", "subpixel", "condition", "distance_m", "seeds", "psnr_db", "gain_db", "ceiling_db", "floor_db"]
    named += ["ws_psnr_db", "ssim", "holes", "disoccluded", "disoccluded_rmse_grey"]
    return Table(head, rows, Data("novel-views", named, plain))


def _pictures(method: Method, grid: Grid) -> Iterator[Block]:
    distances = method.outcome.trial.novel_views.distances_m
    views = novel_views(method.outcome, distances[len(distances) // 2 : len(distances) // 2 + 1])
    if not views:
        return
    (view,) = views
    shares = shares_in_words(view.warped.state[view.compared])
    pictures = [
        _picture(grid, np.where(view.compared, view.expected, 0.0), "(a) as rendered"),
        _picture(grid, np.where(view.warped.holes | ~view.compared, 0.0, view.warped.grey), "(b) as warped"),
        _difference(grid, view),
    ]
    caption = html(
        _PICTURES,
        distance=view.distance_m,
        method=method.label,
        limit=_LIMIT_GREY,
        shares=", ".join(shares).replace("%", "\u00a0%"),
    )
    yield Figure("figure-novel-view", pictures, caption, "wide")


@theme.panel
def _picture(grid: Grid, grey: NDArray[np.floating], title: str) -> Picture:
    fig, ax, _ = panorama_axes(grid, bar=False, label=False)
    ax.imshow(unmirrored(grey), cmap="gray", vmin=0, vmax=255, extent=extent_of(grid), aspect="auto")
    return theme.picture(fig, f"Panorama {title[4:]}.", title)


@theme.panel
def _difference(grid: Grid, view: NovelView) -> Picture:
    fig, ax, colours = panorama_axes(grid)
    known = view.compared & ~view.warped.holes
    difference = np.where(known, view.warped.grey - view.expected, np.nan)
    drawn = ax.imshow(
        unmirrored(difference), cmap="RdBu", vmin=-_LIMIT_GREY, vmax=_LIMIT_GREY, extent=extent_of(grid), aspect="auto"
    )
    ax.set_facecolor("#D0D0D0")
    fig.colorbar(drawn, cax=colours, extend="both").set_label("warped − rendered (grey levels)")
    rms = float(np.sqrt(np.nanmean(difference**2)))
    return theme.picture(
        fig, f"Difference of the warped and the rendered view, {rms:.1f} grey levels RMS.", "(c) difference"
    )
