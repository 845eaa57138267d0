"""The settings reference, generated from the specifications: every key of an experiment, its type, unit and meaning."""

import json
import re
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from harness.errors import InputError, nearest
from harness.pipeline.specification import Trial
from harness.renamed import up_to_date_key
from harness.runs.cases import NAME, NAME_MEANING
from harness.runs.experiment import Experiment
from harness.runs.key_meanings import key_meanings
from harness.spec import LARGEST, LARGEST_COEFFICIENT

UNITS = {
    "_per_px": "per pixel",
    "_m": "m",
    "_mm": "mm",
    "_px": "px",
    "_deg": "degrees",
    "_rad": "rad",
    "_s": "s",
    "_grey": "grey levels",
    "_bits": "bits",
    "_percent": "%",
}
"""The unit that a key's ending stands for; the first ending that fits counts."""

ITEM = "N"
"""Stands for the index of an item in a key such as `scene.objects.N.size_m`."""

OTHER_KIND = "any other"
"""The kind of a matcher that is not part of this program."""

_REQUIRED = "required"


@dataclass(frozen=True)
class Setting:
    """One key of an experiment, as one kind of matcher, object or texture has it."""

    key: str
    """Dotted, as in `--set` and on axes; the keys of a trial without `trial.`."""
    kinds: tuple[str, ...]
    """The values of `kind` beside it that have this key; empty for a key that is always there."""
    type: str
    """The type of its values, in words."""
    unit: str
    """The unit; empty for a key without one."""
    default: str
    """The default as TOML; `required` if there is none, empty for a table whose keys have their own. Leaving out a
    table may differ from an empty table."""
    meaning: str


@lru_cache(maxsize=1)
def settings_reference() -> tuple[Setting, ...]:
    """Every key of an experiment: those of its trials first, in the order of the pipeline."""
    expanded: dict[Any, str] = {}
    trial = Experiment.model_fields["trial"].annotation
    keys = [*_of_spec(trial, "", (), expanded)]
    own = (each for each in _of_spec(Experiment, "", (), expanded) if not each.key.startswith("trial"))
    # A case is a table of any keys, so that no specification has its name.
    return (*keys, *own, Setting(f"cases.{ITEM}.{NAME}", (), "text", "", _REQUIRED, NAME_MEANING))


def reference_of(spec: type[BaseModel]) -> tuple[Setting, ...]:
    """Every key of another specification."""
    return tuple(_of_spec(spec, "", (), {}))


def find_settings(key: str | None = None) -> tuple[Setting, ...]:
    """The settings that a key names.

    Parameters
    ----------
    key
        A key (`matching.window_px`, `scene.objects.0.size_m`), a table (`matching`, `sensor.camera`), or the last part
        of a key (`window_px`); all settings when None.

    Raises
    ------
    InputError
        When there is no such key.
    """
    every = settings_reference()
    if key is None:
        return every
    wanted = re.sub(r"\[(\d+)\]", r".\1", key.strip()).removeprefix("trial.")
    wanted = up_to_date_key(Trial, wanted)
    wanted = ".".join(ITEM if part.isdecimal() else part for part in wanted.split("."))
    matching = [each for each in every if f"{each.key}.".startswith(f"{wanted}.")]
    matching = matching or [each for each in every if each.key.endswith(f".{wanted}")]
    if not matching:
        keys = dict.fromkeys(each.key for each in every)
        last = dict.fromkeys(name.rpartition(".")[2] for name in keys)
        hint = nearest(wanted, [*keys, *last])
        if hint.startswith("valid"):
            hint = "omnirange settings lists them all"
        raise InputError(f"unknown key '{key}'; {hint}", key="KEY")
    return tuple(matching)


def settings_markdown(settings: Sequence[Setting]) -> str:
    """The reference as Markdown: a heading and a table for each table of the experiment."""
    parts = []
    for table, group in groupby(settings, lambda each: _table_of(each.key)):
        parts.append(f"## `{table}`\n" if table else "## The experiment\n")
        parts.append("| key | for `kind` | type | unit | default | meaning |\n|---|---|---|---|---|---|")
        parts += [
            "| "
            + " | ".join(
                text.replace("|", "\\|")
                for text in (
                    f"`{each.key}`",
                    ", ".join(f"`{kind}`" if kind != OTHER_KIND else kind for kind in each.kinds),
                    each.type,
                    each.unit,
                    f"`{each.default}`" if each.default not in ("", _REQUIRED) else each.default,
                    each.meaning,
                )
            )
            + " |"
            for each in group
        ]
        parts.append("")
    return "\n".join(parts)


def _table_of(key: str) -> str:
    """The table under whose heading a key stands: the first part of the key, of a trial's plain values none."""
    return key.partition(".")[0] if "." in key or key in _tables() else ""


@lru_cache(maxsize=1)
def _tables() -> frozenset[str]:
    return frozenset(each.key.partition(".")[0] for each in settings_reference() if "." in each.key)


# --- The tree of specifications -----------------------------------------------------------------------------------


def _of_spec(spec: Any, stem: str, kinds: tuple[str, ...], expanded: dict[Any, str]) -> Iterator[Setting]:
    for name, field in spec.model_fields.items():
        meaning = field.description or key_meanings(spec).get(name, "")
        yield from _of_field(f"{stem}{name}", field, meaning, kinds, expanded)


def _of_field(
    key: str, field: FieldInfo, meaning: str, kinds: tuple[str, ...], expanded: dict[Any, str]
) -> Iterator[Setting]:
    tables, is_list = _tables_in(field.annotation)
    first = expanded.setdefault(tables, key) if tables else key
    described = _described(field.annotation, field.metadata) if not tables else "list of tables" if is_list else "table"
    yield Setting(
        key=key,
        kinds=kinds,
        type=described if first == key else f"table, with the keys of {first}",
        unit=unit_of(key),
        default=_default_of(field, is_table=bool(tables)),
        meaning=" ".join(meaning.split()),
    )
    if tables and first == key:
        stem = f"{key}.{ITEM}." if is_list else f"{key}."
        yield from _of_tables(tables, stem, expanded) if len(tables) > 1 else _of_spec(tables[0], stem, (), expanded)


def _of_tables(tables: Sequence[Any], stem: str, expanded: dict[Any, str]) -> Iterator[Setting]:
    """The keys of tables with a `kind`: equal ones once, with all kinds that have them."""
    merged: dict[Setting, list[str]] = {}
    for table in tables:
        # A table inside the tables of several kinds is expanded once, at the first of them.
        for each in _of_spec(table, stem, (), expanded):
            kinds = each.kinds or _kinds_of(table)
            bare = Setting(each.key, each.kinds, each.type, each.unit, each.default, each.meaning)
            merged.setdefault(bare, []).extend(kinds)
    order = list(dict.fromkeys(each.key for each in merged))
    for bare in sorted(merged, key=lambda each: order.index(each.key)):
        kinds = tuple(dict.fromkeys(merged[bare]))
        yield Setting(bare.key, kinds, bare.type, bare.unit, bare.default, bare.meaning)


def _kinds_of(table: Any) -> tuple[str, ...]:
    values = get_args(table.model_fields["kind"].annotation)
    return tuple(values) or (OTHER_KIND,)


def _tables_in(annotation: Any) -> tuple[tuple[Any, ...], bool]:
    """The specifications that may stand at a key, and whether it holds a list of them."""
    plain = _plain(annotation)
    if isinstance(plain, type) and issubclass(plain, BaseModel):
        return (plain,), False
    if get_origin(plain) in (Union, types.UnionType):
        tables = [_tables_in(member)[0] for member in get_args(plain) if member is not type(None)]
        return tuple(each for of_member in tables for each in of_member), False
    if get_origin(plain) in (tuple, list):
        return _tables_in(get_args(plain)[0])[0], True
    return (), False


def _plain(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def unit_of(key: str) -> str:
    """The unit that the end of a key's name stands for; empty without one."""
    return next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")


def _default_of(field: FieldInfo, *, is_table: bool) -> str:
    if field.is_required():
        return _REQUIRED
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        plain = {name: each.get_default() for name, each in type(value).model_fields.items()}
        changed = {name: json.dumps(getattr(value, name)) for name in plain if getattr(value, name) != plain[name]}
        return f"{{ {', '.join(f'{name} = {text}' for name, text in changed.items())} }}" if changed else ""
    return "" if value is None or is_table else json.dumps(value)


# --- Types in words -----------------------------------------------------------------------------------------------

_BOUNDS = {"gt": "above {}", "ge": "at least {}", "lt": "below {}", "le": "at most {}"}


def _described(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _described(inner, [*more, *metadata])
    limits = _limits(metadata)
    if get_origin(annotation) is Literal:
        return " or ".join(json.dumps(value) for value in get_args(annotation))
    if annotation is bool:
        return "true or false"
    if annotation in (int, float):
        return ", ".join(["whole number" if annotation is int else "number", *_range_text(limits)])
    if annotation is str:
        return "text"
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (tuple, list):
        if origin is list or arguments[-1] is ...:
            return f"list, each: {_described(arguments[0])}" if arguments[0] is not Any else "list"
        return f"list of {len(arguments)}, each: {_described(arguments[0])}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        inside = _described(arguments[1])
        return f"table, each value: {inside}" if inside != "any value" else "table"
    return "any value"


def _limits(metadata: Sequence[Any]) -> dict[str, float]:
    bounds: dict[str, float] = {}
    for each in metadata:
        for part in getattr(each, "metadata", [each]):
            bounds |= {name: getattr(part, name) for name in _BOUNDS if getattr(part, name, None) is not None}
    return bounds


def _range_text(limits: dict[str, float]) -> list[str]:
    beyond = (1 / LARGEST, LARGEST, -LARGEST, LARGEST_COEFFICIENT, -LARGEST_COEFFICIENT)
    limits = {name: limit for name, limit in limits.items() if limit not in beyond}
    if limits.keys() == {"ge", "le"}:
        return [f"{_number(limits['ge'])} .. {_number(limits['le'])}"]
    return [_BOUNDS[name].format(_number(limit)) for name, limit in limits.items()]


def _number(limit: float) -> str:
    return f"2^{limit.bit_length() - 1}" if isinstance(limit, int) and limit > 2**32 else f"{limit:g}"
