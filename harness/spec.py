"""Specifications: small, frozen, hashable, JSON-able records read from TOML, and the messages for wrong ones."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar, get_args, get_origin

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from harness.annotations import inside, members, tags
from harness.display import brief, listed, shortened
from harness.errors import InputError, nearest
from harness.renamed import Renaming, former_names, give_notice, up_to_date
from harness.toml import levels, read_toml

LARGEST = 1e9
"""The limit of all numbers with a unit, and of the inverses of positive ones: products of several stay finite, also in
single precision."""
Positive = Annotated[float, Field(gt=0, ge=1 / LARGEST, le=LARGEST, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
LARGEST_COEFFICIENT = 1e60
"""The limit of coefficients of powers, which are huge where the base is small."""
Coefficient = Annotated[float, Field(ge=-LARGEST_COEFFICIENT, le=LARGEST_COEFFICIENT, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]

MOST_LEVELS = 32
"""Tables and lists inside each other in a value of any type: `toml.MOST_LEVELS` with room for what is around it."""

Location = tuple[int | str, ...]
"""Keys and list indices that lead to a value."""

_PYDANTIC = frozenset(dir(BaseModel)) - frozenset(dir(object))
"""Names that belong to pydantic: there, but not shown."""


def _is_shown(name: str) -> bool:
    return name not in _PYDANTIC and not name.startswith("__pydantic_")


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class _SpecType(ModelMetaclass):
    def __dir__(cls) -> list[str]:  # noqa: N805 - an instance of a metaclass is a class
        """The keys and what the class adds to them: none of pydantic's own methods."""
        return [*filter(_is_shown, super().__dir__()), *getattr(cls, "model_fields", ())]


class Spec(BaseModel, metaclass=_SpecType):
    """Base of all specifications. Unknown keys are refused; no instance can be changed."""

    # Docstrings of keys are for `runs.key_meanings`: pydantic would parse the sources anew at each start.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, allow_inf_nan=True)

    def __repr__(self) -> str:
        """The class and what differs from its defaults, in one line."""
        parts = {name: getattr(self, name) for name in type(self).model_fields}
        given = {
            name: value
            for name, value in parts.items()
            if value != type(self).model_fields[name].get_default(call_default_factory=True)
        }
        return (
            f"{type(self).__name__}({shortened(', '.join(f'{name}={brief(value)}' for name, value in given.items()))})"
        )

    __str__ = __repr__

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            present = former_names(type(self)).get(name)
            if present is None:
                return super().__getattr__(name)
            give_notice([Renaming(f"{type(self).__name__}.{name}", name, present)])
            return getattr(self, present)

    def __dir__(self) -> list[str]:
        """The keys and what the class adds to them: none of pydantic's own methods, which are there all the same."""
        return [*filter(_is_shown, super().__dir__())]

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, with some values changed; results computed from the old ones (`cached_property`) are dropped."""
        copied = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


S = TypeVar("S", bound=Spec)


def parse(
    model: type[S],
    table: Mapping[str, Any],
    *,
    file: str | Path | None = None,
    key: str = "",
    checked: dict[int, Any] | None = None,
) -> S:
    """Build a specification from a table read from `file`.

    Parameters
    ----------
    key
        The dotted key of `table` inside the file, for messages.
    checked
        The parts of tables, by identity, whose values are known to be of the right types; added to. For many tables
        that share most of their parts, and are not written to.

    Raises
    ------
    InputError
        One line that names the file, the key and what would be right; the first problem only.
    """
    try:
        given, renamed = up_to_date(model, dict(table) if isinstance(table, Mapping) else table, key)
    except InputError as error:
        raise InputError(error.problem, file=file, key=error.key) from error
    give_notice(renamed, file)
    try:
        spec = model.model_validate(given)
    except ValidationError as error:
        location, text = _explain([_locate(model, each) for each in error.errors()])
        raise InputError(text, file=file, key=_dotted(location, key)) from error
    taken = put_back(spec, spec.model_dump())
    for location, text in _coerced(given, taken, checked={} if checked is None else checked):
        raise InputError(text, file=file, key=_dotted(location, key))
    return spec


def load(model: type[S], path: Path) -> S:
    """Read one specification from a TOML file; errors as in `read_toml` and `parse`."""
    return parse(model, read_toml(path), file=path)


def dump_toml(spec: Spec, *, given: bool = False) -> str:
    """The TOML text of a specification, every default written out; `parse` reads it back to an equal one.

    With `given`, what was worked out from something else is written as it was given: see `as_given`.

    Tables of any keys, such as an experiment's axes, keep their keys' order. TOML has no null: a None is left out, so
    only a key that is None by default may hold it.
    """
    table = _without_none(as_given(spec) if given else as_table(spec))
    in_lines = [
        name for name, field in type(spec).model_fields.items() if table.get(name) and _has_any_keys(field.annotation)
    ]
    parts = [tomli_w.dumps({name: value for name, value in table.items() if name not in in_lines})]
    for name in in_lines:
        several = isinstance(table[name], list)
        for each in table[name] if several else [table[name]]:
            lines = [f"{_word(key)} = {_in_line(value)}" for key, value in each.items()]
            parts.append("\n".join([f"[[{name}]]" if several else f"[{name}]", *lines, ""]))
    return "\n".join(parts)


def _has_any_keys(annotation: Any) -> bool:
    """Whether a key holds a table of any keys, or a list of such."""
    if get_origin(annotation) is list:
        return any(_has_any_keys(each) for each in members(get_args(annotation)[0]))
    return get_origin(annotation) is dict


def _word(key: str) -> str:
    """A key as TOML has it."""
    return tomli_w.dumps({key: 0}).rpartition(" = ")[0]


def _in_line(value: Any) -> str:
    """A value in one line. TOML's own tables must follow all plain keys; in a line they keep their order."""
    if isinstance(value, dict):
        return (
            f"{{ {', '.join(f'{_word(key)} = {_in_line(each)}' for key, each in value.items())} }}" if value else "{}"
        )
    if isinstance(value, list):
        return f"[{', '.join(map(_in_line, value))}]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


def as_table(spec: Spec, *, without: str = "") -> dict[str, Any]:
    """A specification as plain data: dictionaries, lists, text, numbers (infinite ones too), truth values, None.

    Not pydantic's own mode "json", which turns infinity into None inside values of any type.

    Parameters
    ----------
    without
        A key that is left out.
    """
    return {name: _as_plain(value) for name, value in spec.model_dump(exclude={without}).items()}


# --- Values that are given in words, or left open, and worked out -------------------------------------------------


class _LeftOut(Enum):
    LEFT_OUT = "left out"


LEFT_OUT = _LeftOut.LEFT_OUT
"""The recorded value of a key that was not given."""

_GIVEN = "given"


def remember(spec: S, given: Mapping[str, Any]) -> S:
    """The specification itself, with a record of the given values from which values of its keys were computed.

    Such as `"fit"` for a focal length, or `LEFT_OUT`. It is no part of the specification: copies, and what is written,
    have the values alone, and it makes no difference to equality.
    """
    spec.__dict__[_GIVEN] = {**given_of(spec), **given}
    return spec


def given_of(spec: Spec) -> dict[str, Any]:
    """The values that were given for keys of a specification whose values were computed from them."""
    return dict(spec.__dict__.get(_GIVEN, {}))


def put_back(spec: Spec, table: dict[str, Any]) -> dict[str, Any]:
    """The table of a specification, changed in place: computed values are replaced by those that were given."""
    for name in type(spec).model_fields:
        value = getattr(spec, name)
        if isinstance(value, Spec) and isinstance(table.get(name), dict):
            put_back(value, table[name])
    for name, given in given_of(spec).items():
        if given is LEFT_OUT:
            del table[name]
        else:
            table[name] = given
    return table


def as_given(spec: Spec) -> dict[str, Any]:
    """A specification as plain data, as `as_table`, but with the given value in place of one computed from it.

    A table to be changed and read again: what follows from other keys then follows from the changed ones.
    """
    return put_back(spec, as_table(spec))


def checked_plain(value: Any) -> Any:
    """A value of any type as a specification may hold it: what TOML can write, so that it reads back the same.

    Tuples become lists; a scalar of NumPy becomes a plain number; a specification becomes a table.

    Raises
    ------
    ValueError
        When there is something else in it, text that is no Unicode, or more than `MOST_LEVELS` levels.
    """
    if levels(value) > MOST_LEVELS:
        raise ValueError(f"tables and lists are nested more than {MOST_LEVELS} deep")
    return _checked_plain(value)


def _checked_plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return _checked_plain(value.item())
    if isinstance(value, BaseModel):
        return _checked_plain(_without_none(value.model_dump()))
    if isinstance(value, Mapping):
        if not all(isinstance(name, str) for name in value):
            raise ValueError("the keys of a table must be text")
        return {_checked_plain(name): _checked_plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_checked_plain(each) for each in value]
    if isinstance(value, str):
        if not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
            raise ValueError(f"text must be Unicode without lone surrogates; found {value!a}")
        return str(value)
    if isinstance(value, bool | int | float):
        return value
    if value is None:
        raise ValueError("TOML has no value for None; leave the key out")
    raise ValueError(f"must be text, a number, true, false, a list or a table; found {_shown(value)}")


def _as_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _as_plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_as_plain(each) for each in value]
    return value


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_without_none(v) for v in value]
    return value


def _dotted(location: Location, start: str = "") -> str | None:
    """A location as one would write it: `objects[1].texture.kind`, keys that TOML would quote in quotes."""
    text = start
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = _brief(part) if re.fullmatch(r"[\w-]+", part) else f'"{_brief(part)}"'
            text += f".{name}" if text else name
    return text or None


# --- What pydantic complains of, in the words of someone who writes TOML ------------------------------------------


@dataclass(frozen=True)
class _Problem:
    error: Any
    """pydantic's `ErrorDetails`."""
    location: Location
    """Location in the file: `loc` without the names of union members."""
    parents: list[Any]
    """The annotations that the value around it may have."""
    alternatives: list[Any]
    """Those and the other members of their union, which the value's tag excludes."""
    members: list[Any]
    """The annotations that the value itself may have."""
    fork: int | None
    """Depth in `location` of a union without a tag, if there is one: pydantic tries all its members."""


def _locate(model: type[BaseModel], error: Any) -> _Problem:
    # pydantic's location mixes keys of the file with names of union members ("box", "list[float]"), so it can
    # only be read with the types beside it.
    location: list[int | str] = []
    here: list[Any] = [model]
    parents = alternatives = before = here
    fork = None
    member_is_next = False
    for part in error["loc"]:
        if member_is_next:
            tagged = [each for each in here if part in tags(each)]
            named = [each for each in here if getattr(each, "__name__", "?") in str(part)]
            fork = len(location) if not tagged and fork is None else fork
            here, member_is_next = tagged or named or here, False
        else:
            location.append(part)
            parents, alternatives = here, before
            here = before = [each for parent in here for each in inside(parent, part)]
            member_is_next = len(here) > 1
    return _Problem(error, tuple(location), parents, alternatives, here, fork)


def _explain(problems: list[_Problem]) -> tuple[Location, str]:
    # A misspelt key often leaves another one missing: report the misspelling.
    problem = min(problems, key=lambda each: each.error["type"] != "extra_forbidden")
    if problem.fork is not None:
        stem = problem.location[: problem.fork]
        tried = [each for each in problems if each.fork == problem.fork and each.location[: each.fork] == stem]
        deepest = max(tried, key=lambda each: len(each.location))
        if len(deepest.location) > problem.fork:  # the member that validated furthest is the intended one
            problem = deepest
        elif len(tried) == 1:
            problem = tried[0]
        else:
            expected = dict.fromkeys(_expected(each) for each in tried)
            return stem, f"must be {' or '.join(expected)}; found {_shown(problem.error['input'])}"
    return _describe(problem)


def _describe(problem: _Problem) -> tuple[Location, str]:
    error, location = problem.error, problem.location
    kind, given, context = error["type"], error.get("input"), error.get("ctx", {})
    if kind == "extra_forbidden":
        word = str(location[-1])
        valid = sorted({name for each in problem.parents for name in getattr(each, "model_fields", ())})
        return location, f"unknown key '{_brief(word)}'; {_owners(word, problem.alternatives) or nearest(word, valid)}"
    if kind == "missing" and isinstance(location[-1], int):
        wanted = max(len(get_args(each)) for each in problem.parents)
        return location[:-1], f"must be a list of {wanted}; found a list of {len(given)}"
    if kind == "missing":
        return location, "this key is missing"
    if kind == "union_tag_not_found":
        tag = context["discriminator"].strip("'")
        valid = sorted({str(word) for each in problem.members for word in tags(each, tag)})
        return (*location, tag), f"this key is missing; valid: {', '.join(valid)}"
    if kind == "union_tag_invalid":
        tag, word = context["discriminator"].strip("'"), str(context["tag"])
        return (*location, tag), f"unknown {tag} '{_brief(word)}'; {nearest(word, _words(context['expected_tags']))}"
    if kind == "literal_error" and isinstance(given, str):
        return location, f"'{_brief(given)}' is not valid; {nearest(given, _words(context['expected']))}"
    if kind in ("value_error", "assertion_error"):
        return location, str(context["error"])
    return location, f"must be {_expected(problem)}; found {_shown(given)}"


def _owners(word: str, alternatives: list[Any]) -> str:
    """Which members of a union have a key, by their tags, as a hint; empty if none has."""
    for tag in ("kind", "model"):
        owners = [each for each in alternatives if word in getattr(each, "model_fields", ())]
        if names := sorted({f"'{name}'" for each in owners for name in tags(each, tag)}):
            return f"it is a key of {tag} {listed(names, 'or')}"
    return ""


_EXPECTED = {
    "greater_than": "above {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "below {lt:g}",
    "less_than_equal": "at most {le:g}",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
    "list_type": "a list",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "literal_error": "{expected}",
    "too_long": "a list of at most {max_length}",
    "too_short": "a list of at least {min_length}",
}
_BOUNDS = frozenset({"greater_than", "greater_than_equal", "less_than", "less_than_equal"})


def _expected(problem: _Problem) -> str:
    error = problem.error
    if error["type"] in _BOUNDS and isinstance(error["input"], bool):
        return "a number"
    if error["type"] in _BOUNDS and isinstance(error["input"], float) and math.isnan(error["input"]):
        return _EXPECTED["finite_number"]
    if error["type"] == "greater_than_equal" and error["ctx"]["ge"] == 1 / LARGEST and float(error["input"]) <= 0:
        return "above 0"  # from `Positive`
    if error["type"] in _EXPECTED:
        return _EXPECTED[error["type"]].format(**error.get("ctx", {}))
    return str(error["msg"]).removeprefix("Input should be ")


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return _brief(repr(value))


def _brief(text: str) -> str:
    """A text that fits into a message."""
    return text if len(text) <= 80 else f"{text[:60]}...{text[-15:]}"


def _coerced(
    given: Any, taken: Any, location: Location = (), *, checked: dict[int, Any]
) -> Iterator[tuple[Location, str]]:
    """Values that pydantic would let pass for another type: `"3"` for a number, `true` for 1, 1 for `true`.

    Its own strict mode would refuse lists too, which are the only way to write a tuple in TOML.
    """
    if id(given) in checked:
        return
    if isinstance(given, dict) and isinstance(taken, dict):
        for name in given:
            if name in taken:
                yield from _coerced(given[name], taken[name], (*location, name), checked=checked)
        checked[id(given)] = given  # kept, so that its identity stays its own
    elif isinstance(given, list | tuple) and isinstance(taken, list | tuple):
        for i, (one, other) in enumerate(zip(given, taken, strict=False)):
            yield from _coerced(one, other, (*location, i), checked=checked)
        checked[id(given)] = given
    elif isinstance(taken, bool | int | float) and (
        isinstance(given, str) or isinstance(given, bool) != isinstance(taken, bool)
    ):
        word = {bool: "true or false", int: "a whole number", float: "a number"}[type(taken)]
        yield location, f"must be {word}; found {_shown(given)}"


def _words(quoted: str) -> list[str]:
    """The words in pydantic's "'one', 'two' or 'three'"."""
    return re.findall(r"'([^']*)'", quoted)
