"""Keys under their former names, which are read for one version more.

The field of a specification says what its key was called: `validation_alias=AliasChoices("model", "mirror")`, the
present name first. Tables and dotted keys are brought up to date here before they are validated or kept, so that
no other module has to know former names.
"""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args

from pydantic import AliasChoices, BaseModel

from harness.annotations import inside, members, tags
from harness.display import shortened
from harness.errors import InputError, Notice


@dataclass(frozen=True)
class DottedKeys:
    """Marks a field whose tables have dotted keys of a specification, such as `sensor.model.a_m` of a trial."""

    of: type[BaseModel]
    listed: bool = False
    """Whether there is a list of values at each key."""


@dataclass(frozen=True)
class Renaming:
    """A key that was found under a former name."""

    where: str
    """Dotted, as it was found."""
    former: str
    present: str


def up_to_date(model: type[BaseModel], table: Any, where: str = "") -> tuple[Any, list[Renaming]]:
    """A specification's table with all keys under their present names, and what was found under former ones.

    Parameters
    ----------
    table
        Not written to: a part that has no former name in it is returned itself.
    where
        The dotted key of `table`.

    Raises
    ------
    InputError
        When a key is given under both names.
    """
    renamings: list[Renaming] = []
    return _of_spec(model, table, where, renamings), renamings


def dotted_up_to_date(keys: DottedKeys, table: Mapping[str, Any], where: str = "") -> tuple[Any, list[Renaming]]:
    """A table with dotted keys of a specification, as `up_to_date`."""
    renamings: list[Renaming] = []
    return _of_dotted(keys, table, where, renamings), renamings


def up_to_date_key(model: type[BaseModel], key: str) -> str:
    """A dotted key of a specification with all its parts under their present names."""
    return _of_key(model, key)[0]


def give_notice(renamings: Iterable[Renaming], file: str | Path | None = None) -> None:
    """Say, once for each new name, which keys of a file have it."""
    keys: dict[tuple[str, str], list[str]] = {}
    for each in renamings:
        keys.setdefault((each.former, each.present), []).append(each.where)
    for (former, present), locations in keys.items():
        where = ": ".join(part for part in (str(file or ""), shortened(", ".join(dict.fromkeys(locations)))) if part)
        text = f"{where}: '{former}' is now called '{present}'; the next version will not read the former name"
        warnings.warn(text, Notice, stacklevel=2)


@lru_cache(maxsize=512)
def former_names(model: type[BaseModel]) -> Mapping[str, str]:
    """The former names of a specification's own keys, and the present ones."""
    return {
        str(former): name
        for name, field in model.model_fields.items()
        if isinstance(field.validation_alias, AliasChoices)
        for former in field.validation_alias.choices
        if former != name
    }


# --- Tables -------------------------------------------------------------------------------------------------------


def _of_spec(model: type[BaseModel], table: Any, where: str, renamings: list[Renaming]) -> Any:
    if not isinstance(table, Mapping):
        return table
    names, changed = former_names(model), {}
    for key in names.keys() & table.keys():
        if names[key] in table:
            raise InputError(f"'{key}' is now called '{names[key]}'; give only that one", key=_below(where, key))
        renamings.append(Renaming(_below(where, key), key, names[key]))
        changed[names[key]] = table[key]
    fields = _worth_a_look(model)
    for key in (*table, *changed):
        if key in fields:
            before = changed.get(key, table.get(key))
            location = _below(where, next((old for old, new in names.items() if new == key and old in table), key))
            after = _of_value(fields[key], before, location, renamings)
            if after is not before:
                changed[key] = after
    if not changed:
        return table
    return {names.get(key, key): changed.get(names.get(key, key), value) for key, value in table.items()}


def _of_value(annotations: tuple[Any, ...], value: Any, where: str, renamings: list[Renaming]) -> Any:
    """A value that may be of any of these types, each a specification, a container, or `DottedKeys`."""
    if isinstance(value, list | tuple):
        items = [
            _of_value(_inside(annotations, number), item, f"{where}[{number}]", renamings)
            for number, item in enumerate(value)
        ]
        return value if all(one is other for one, other in zip(value, items, strict=True)) else items
    if not isinstance(value, Mapping):
        return value
    specs = [each for each in annotations if isinstance(each, type) and issubclass(each, BaseModel)]
    named = [each for each in specs if value.get("kind") in tags(each, "kind")]
    for spec in named or specs:
        value = _of_spec(spec, value, where, renamings)
    for each in annotations:
        if isinstance(each, DottedKeys):
            return _of_dotted(each, value, where, renamings)
    if specs:
        return value
    changed = {
        key: _of_value(_inside(annotations, key), item, _below(where, key), renamings) for key, item in value.items()
    }
    return value if all(changed[key] is item for key, item in value.items()) else changed


def _inside(annotations: tuple[Any, ...], part: Any) -> tuple[Any, ...]:
    return tuple(
        one
        for each in annotations
        for one in ([each] if isinstance(each, DottedKeys) else inside(each, part))
        if isinstance(each, DottedKeys) or _is_worth_a_look(one)
    )


def _below(where: str, key: Any) -> str:
    return f"{where}.{key}" if where else str(key)


# --- Dotted keys --------------------------------------------------------------------------------------------------


def _of_dotted(keys: DottedKeys, table: Mapping[str, Any], where: str, renamings: list[Renaming]) -> Any:
    changed: dict[str, Any] = {}
    for key, value in table.items():
        present, annotations, renamed = _of_key(keys.of, str(key))
        location = _below(where, key)
        if renamed and present in table:
            raise InputError(f"'{key}' is now called '{present}'; give only that one", key=location)
        renamings += [Renaming(location, *each) for each in renamed]
        if keys.listed and isinstance(value, list | tuple):
            changed[present] = [_of_value(annotations, each, location, renamings) for each in value]
        else:
            changed[present] = _of_value(annotations, value, location, renamings)
    return changed


def _of_key(model: type[BaseModel], key: str) -> tuple[str, tuple[Any, ...], list[tuple[str, str]]]:
    """The present key, what may stand there, and which of its parts had another name."""
    here: list[Any] = [model]
    parts, renamed = [], []
    for part in key.split("."):
        present = next((names[part] for each in here if part in (names := _names_of(each))), part)
        if present != part:
            renamed.append((part, present))
        parts.append(present)
        here = [one for each in here for one in inside(each, int(part) if part.isdecimal() else present)]
    return ".".join(parts), tuple(each for each in here if _is_worth_a_look(each)), renamed


def _names_of(annotation: Any) -> Mapping[str, str]:
    return former_names(annotation) if isinstance(annotation, type) and issubclass(annotation, BaseModel) else {}


# --- What is worth a look: specifications of many thousand trials are read ----------------------------------------


@lru_cache(maxsize=512)
def _worth_a_look(model: type[BaseModel]) -> Mapping[str, tuple[Any, ...]]:
    """The keys of a specification inside which a former name may be, and what may stand there."""
    fields: dict[str, tuple[Any, ...]] = {}
    for name, field in model.model_fields.items():
        dotted = tuple(each for each in field.metadata if isinstance(each, DottedKeys))
        worth = dotted or tuple(each for each in members(field.annotation) if _is_worth_a_look(each))
        if worth:
            fields[name] = worth
    return fields


def _is_worth_a_look(annotation: Any, above: frozenset[Any] = frozenset()) -> bool:
    if annotation in above:  # a specification inside itself
        return False
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return bool(former_names(annotation)) or any(
            any(isinstance(each, DottedKeys) for each in field.metadata)
            or any(_is_worth_a_look(each, above | {annotation}) for each in members(field.annotation))
            for field in annotation.model_fields.values()
        )
    return any(_is_worth_a_look(one, above) for each in get_args(annotation) for one in members(each))
