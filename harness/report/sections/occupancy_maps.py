"""Maps from range profiles along a path: figures by method, and each method's map beside the floor plan's."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from harness.mapping.occupancy import Cell
from harness.mapping.packed import unpacked
from harness.report import theme
from harness.report.data import Cell as Number
from harness.report.data import Data, Heading, Table, count, number, words
from harness.report.markup import html
from harness.report.method_styles import looks
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import HALF, Picture
from harness.runs.methods import MethodName
from harness.runs.path_maps import FIGURES, FOLDER, frame_of, path_maps_conclusions

Entry = dict[str, Any]
Labels = Mapping[MethodName, str]

_WORDS = """
<p>The range profiles of {{ pairs }} pairs along a path, put together on cells of {{ "%.3g" | format(100 * cell_m) }} cm
with each profile’s own standard deviations, beside the floor plan cut from the scene. {{ sentence }} The maps are in
the folder <code>{{ folder }}</code>, as ROS’s map_server reads them.</p>
"""
_TABLE = """
Maps against the floor plan, means over seeds{% if intervals %} with 95 % intervals{% endif %}. IoU: cells that are free
(occupied) in both, over those that are in either; a border is one cell wide, so that half a cell’s error halves the
second. Known: cells called free or occupied. Borders: distance of occupied cells from the plan’s nearest line, mean and
what 95 % are within. Missed: borders of the plan without an occupied cell within two cells. With true ranges: the same
places and the same map, with the profiles cut from the scene.
"""
_MAPS = """
The floor plan and the maps of one seed. Black: occupied. White: free. Grey: unknown, in the plan not scored. Dots: the
first viewpoints of the pairs.
"""
_COLOURS = ListedColormap(["#BDBDBD", "#FFFFFF", "#222222"])


@section_of(About.ALL_TRIALS, "occupancy-maps", "Maps of a robot")
def section(context: Context) -> Iterator[Block]:
    """A sentence, a table and the maps; nothing where no trial has one."""
    entries: list[Entry] = context.summary.get("maps") or []
    if not entries:
        return
    labels = context.result.experiment.method_labels
    shown = _first_of_each(context, entries)
    first = next(iter(shown.values()))
    sentence = " ".join(path_maps_conclusions(entries, context.result.experiment.names_of_methods))
    yield Paragraph(
        html(_WORDS, pairs=len(first["stations_m"]), cell_m=first["cell_m"], sentence=sentence, folder=FOLDER)
    )
    intervals = any(each["seeds"] > 1 for each in entries)
    yield TableBlock("table-maps", _table(entries, labels), html(_TABLE, intervals=intervals))
    names = looks(list(shown), labels)
    panels = [_map(first, "true", "floor plan"), _map(first, "ceiling_state", "map of the true ranges")]
    panels += [_map(entry, "state", names[method].label) for method, entry in shown.items()]
    yield Figure("figure-maps", panels, html(_MAPS))


def _first_of_each(context: Context, entries: list[Entry]) -> dict[tuple[str, str], dict[str, Any]]:
    """The map of the first trial of each method, under the first condition."""
    shown: dict[tuple[str, str], dict[str, Any]] = {}
    for row in context.result.rows:
        if row.state == "done" and row.planned.condition == entries[0]["condition"] and row.payload.get("map"):
            shown.setdefault(row.planned.method, row.payload["map"])
    return shown


def _table(entries: list[Entry], labels: Labels) -> Table:
    several = len({each["condition"] for each in entries}) > 1
    appearance = looks(list(dict.fromkeys((each["matcher"], each["subpixel"]) for each in entries)), labels)
    shown = {
        "iou_free": (Heading("IoU, free"), ".3f", 1),
        "iou_occupied": (Heading("IoU, occupied"), ".3f", 1),
        "known": (Heading("Known", "%"), ".1f", 100),
        "border_m": (Heading("Borders", "mm"), ".0f", 1000),
        "border_p95_m": (Heading("Borders, 95 %", "mm"), ".0f", 1000),
        "missed_borders": (Heading("Missed", "%"), ".1f", 100),
    }
    rows: list[list[Number]] = []
    for each in entries:
        look = appearance[each["matcher"], each["subpixel"]]
        names = [words(look.label, look.colour), *([words(each["condition"])] if several else [])]
        cells = [number(each[name], form, scale, each[f"{name}_ci95"]) for name, (_, form, scale) in shown.items()]
        rows.append([*names, count(each["seeds"]), *cells])
    exact = entries[0]["ceiling"]
    cells = [number(exact[name], form, scale) for name, (_, form, scale) in shown.items()]
    rows.append([words("true ranges"), *([words(entries[0]["condition"])] if several else []),
                 count(entries[0]["seeds"]), *cells])  # fmt: skip
    head = [Heading("Ranges", text=True), *([Heading("Condition", text=True)] if several else []), Heading("Seeds")]
    named = ["matcher", "subpixel", "condition", "seeds"]
    plain = [[*(each[name] for name in named), *(each[name] for name in FIGURES)] for each in entries]
    data = Data("maps", [*named, *FIGURES], plain)
    return Table([*head, *(heading for heading, _, _ in shown.values())], rows, data)


@theme.panel
def _map(made: dict[str, Any], which: str, title: str) -> Picture:
    frame = frame_of(made)
    cells = unpacked(made[which], frame.shape)
    rows, columns = frame.shape
    side = HALF - 72
    height = side * rows / columns
    fig = theme.figure(HALF, round(height) + 56)
    ax = theme.axes(fig, 52, 10, side, height)
    x, y = frame.origin_m
    extent = (x, x + columns * frame.cell_m, y, y + rows * frame.cell_m)
    ax.imshow(cells, cmap=_COLOURS, vmin=0, vmax=2, extent=extent, origin="lower", interpolation="nearest")
    stations = np.array(made["stations_m"])
    ax.plot(*stations.T, "o", color=theme.PIXEL, markersize=3)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    shares = _shares(cells)
    return theme.picture(fig, f"Map, {title}: {shares}.", title)


def _shares(state: NDArray[np.uint8]) -> str:
    return ", ".join(f"{float((state == each).mean()):.0%} {each.name.lower()}" for each in Cell)
