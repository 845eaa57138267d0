"""Dotted keys, such as `matching.window_px` or `scene.objects.0.size_m`: reading and changing one value of a table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.camera import models
from harness.errors import InputError
from harness.matching import registry
from harness.runs.named_files import SENSORS, read_in
from harness.runs.values import Settings, text_of

KIND = "matching.kind"
"""The key that selects the matcher, on which the other keys of its table depend."""

MODEL_KINDS = ("sensor.model.kind", "sensor_2.model.kind")
"""The keys that select a camera model."""

_OF_VIEW_2 = {"sensor_2": "sensor", "optics_2": "optics"}
"""Tables of the second view, and the first view's tables that stand in for missing ones."""


def changed(table: Mapping[str, Any], settings: Settings, *, file: str | Path | None = None, key: str = "") -> Any:
    """A trial's table with some of its values changed, the innermost last; scene and sensor files are read in.

    A key of `sensor_2` or `optics_2`, where there is none, changes a copy of the first view's.

    Raises
    ------
    InputError
        When a key leads through a value that has no keys, or past the end of a list.
    """
    for dotted in sorted(
        settings, key=lambda each: (_table_of_view_2(each) is not None, each.count("."), not each.endswith(".kind"))
    ):
        name = _table_of_view_2(dotted)
        if name and table.get(name) is None and table.get(_OF_VIEW_2[name]) is not None:
            table = {**table, name: table[_OF_VIEW_2[name]]}
        where = f"{key}.{dotted}" if key else dotted
        if dotted == KIND and isinstance(table.get("matching"), Mapping):
            # Before the matcher's other keys, which depend on its kind.
            table = {**table, "matching": registry.carried_over(table["matching"], settings[dotted])}
        if dotted in MODEL_KINDS:
            sensor, model, _ = dotted.split(".")
            if isinstance(value_at(table, f"{sensor}.{model}"), Mapping):
                other = models.carried_over(value_at(table, f"{sensor}.{model}"), settings[dotted])
                table = {**table, sensor: {**table[sensor], model: other}}
        table = _with(table, dotted.split("."), settings[dotted], file, where)
        if dotted == "scene" or dotted in SENSORS:
            table = read_in(table, Path(), file, key)
    return table


def _table_of_view_2(dotted: str) -> str | None:
    """The second view's table that a key leads into."""
    name, dot, _ = dotted.partition(".")
    return name if dot and name in _OF_VIEW_2 else None


def value_at(table: Any, key: str) -> Any:
    """The value at a dotted key; None if there is no such key."""
    for part in key.split("."):
        try:
            table = table[int(part)] if isinstance(table, list | tuple) else table.get(part)
        except (AttributeError, IndexError, ValueError):
            return None
    return table


def worked_out(value: Any, spec: Any, key: str) -> Any:
    """The given value at a dotted key of a specification, or the number computed from it if it is text or None."""
    if value is not None and not isinstance(value, str):
        return value
    for part in key.split("."):
        spec = getattr(spec, part, None)
    return spec if isinstance(spec, int | float) else value


def _with(table: Any, keys: list[str], value: Any, file: str | Path | None, where: str) -> Any:
    first, *rest = keys
    if isinstance(table, list | tuple):
        if not (first.isdecimal() and int(first) < len(table)):
            raise InputError(f"'{first}' is no item of a list of {len(table)}; the first is 0", file=file, key=where)
        i = int(first)
        return [*table[:i], _with(table[i], rest, value, file, where) if rest else value, *table[i + 1 :]]
    if table is not None and not isinstance(table, Mapping):
        raise InputError(f"there is no key '{first}' in {text_of(table)}, which is a plain value", file=file, key=where)
    table = table or {}
    return {**table, first: _with(table.get(first), rest, value, file, where) if rest else value}
