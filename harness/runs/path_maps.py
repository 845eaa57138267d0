"""Scores of a run's maps over seeds, and the maps as files."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from harness.evaluation.statistics import mean_with_interval
from harness.mapping.map_files import write_map
from harness.mapping.occupancy import GridFrame
from harness.mapping.packed import unpacked
from harness.runs.experiment import Planned
from harness.runs.methods import MethodName, in_words

FIGURES = ("iou_free", "iou_occupied", "known", "border_m", "border_p95_m", "missed_borders")
FOLDER = "occupancy"
"""The folder of maps in a run's output folder."""


def path_maps_of(done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `maps` of `summary.json`: for each method and condition, means over seeds.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them; those without a map are left out.

    Returns
    -------
    list of dict
        `matcher`, `subpixel`, `condition`, `seeds`; the figures of `map_scores.MapScore`, each with its 95 % interval
        by bootstrap over seeds (`_ci95`); and `ceiling`, a table of the same figures of the true profiles' maps.
    """
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for planned, payload in done:
        if payload.get("map"):
            groups.setdefault((*planned.method, planned.condition), []).append(payload["map"])
    return [_entry(*key, maps) for key, maps in groups.items()]


def path_maps_conclusions(entries: list[dict[str, Any]], names: Mapping[MethodName, str]) -> list[str]:
    """Sentences on the agreement of each method's map with the floor plan, beside the ceiling's; none from one seed.

    Parameters
    ----------
    entries
        The entries of `path_maps_of`; the sentences are about those of the first condition.
    names
        The names of methods.
    """
    mine = [each for each in entries if each["condition"] == entries[0]["condition"] and each["seeds"] > 1]
    return [
        f"Maps ({in_words((each['matcher'], each['subpixel']), names)}) agree with the floor plan in "
        f"{_share(each, 'iou_free')} of the free cells and {_share(each, 'iou_occupied')} of the occupied ones "
        f"(IoU; with true ranges {100 * each['ceiling']['iou_free']:.1f} and "
        f"{100 * each['ceiling']['iou_occupied']:.1f} %)."
        for each in mine
    ]


def write_path_maps(done: Iterable[tuple[Planned, dict[str, Any]]], folder: Path) -> list[str]:
    """Write the map of each trial that has one as PNG and YAML into `FOLDER`, and return the files' names.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    names = []
    for planned, payload in done:
        if entry := payload.get("map"):
            label = re.sub(r"[^A-Za-z0-9_.-]+", "-", "-".join(planned.method))
            name = f"{label}-{planned.key}"
            cells = unpacked(entry["state"], tuple(entry["shape"]))
            write_map(cells, frame_of(entry), folder / FOLDER, name)
            names.append(name)
    return names


def frame_of(made: Mapping[str, Any]) -> GridFrame:
    """The cells of a stored map."""
    (x, y), (rows, columns) = made["origin_m"], made["shape"]
    return GridFrame((x, y), made["cell_m"], (rows, columns))


def _entry(matcher: str, subpixel: str, condition: str, maps: list[dict[str, Any]]) -> dict[str, Any]:
    entry: dict[str, Any] = {"matcher": matcher, "subpixel": subpixel, "condition": condition, "seeds": len(maps)}
    for name in FIGURES:
        known = [each["score"][name] for each in maps if each["score"][name] is not None]
        mean, ends = mean_with_interval(np.array(known)) if known else (None, None)
        entry |= {name: mean, f"{name}_ci95": ends}
    exact = {name: [each["ceiling"][name] for each in maps] for name in FIGURES}
    entry["ceiling"] = {name: float(np.mean(values)) if None not in values else None for name, values in exact.items()}
    return entry


def _share(entry: dict[str, Any], name: str) -> str:
    low, high = entry[f"{name}_ci95"]
    return f"{100 * entry[name]:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
