"""Specifications: small, frozen, hashable, JSON-able records read from TOML, and what is said when one is wrong."""

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from harness.errors import InputError

Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Spec(BaseModel):
    """Base of all specifications. Unknown keys are refused; no instance can be changed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, allow_inf_nan=True)


S = TypeVar("S", bound=Spec)


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file.

    Raises
    ------
    InputError
        When the file is missing, is not readable, or is not TOML.
    """
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as a TOML text file ({error})", file=path) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}", file=path) from error


def parse(model: type[S], table: Mapping[str, Any], *, file: str | Path | None = None, key: str = "") -> S:
    """Build a specification from a table read from `file`.

    Parameters
    ----------
    key
        The dotted place of `table` inside the file, for messages.

    Raises
    ------
    InputError
        One line that names the file, the key and what would be right; the first problem only.
    """
    try:
        return model.model_validate(dict(table))
    except ValidationError as error:
        first = error.errors()[0]
        location = _location(first["loc"])
        dotted = ".".join(str(part) for part in ([key] if key else []) + location)
        raise InputError(_explain(model, first, location), file=file, key=dotted or None) from error


def load(model: type[S], path: Path) -> S:
    """Read one specification from a TOML file; errors as in `read_toml` and `parse`."""
    return parse(model, read_toml(path), file=path)


def dump_toml(spec: Spec) -> str:
    """The TOML text of a specification, every default written out; `parse` reads it back to an equal one."""
    return tomli_w.dumps(_without_none(spec.model_dump(mode="json")))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_without_none(v) for v in value]
    return value


def _location(loc: Sequence[int | str]) -> list[int | str]:
    # pydantic puts the names of validators and union members ("function-after[...]", "box") into the location.
    return [part for part in loc if not (isinstance(part, str) and "[" in part)]


def nearest(word: str, choices: Sequence[str]) -> str:
    """A hint that ends a message: the nearest valid word, or all of them."""
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"valid: {', '.join(choices)}"


def _explain(model: type[BaseModel], error: Any, location: list[int | str]) -> str:
    kind, given = error["type"], error.get("input")
    if kind == "extra_forbidden":
        word = str(location[-1])
        return f"unknown key '{word}'; {nearest(word, _fields_at(model, location[:-1]))}"
    if kind == "missing":
        return "this key is missing"
    if kind == "union_tag_not_found":
        return f"the key {error['ctx']['discriminator']} is missing"
    if kind == "union_tag_invalid":
        valid = [tag.strip().strip("'") for tag in error["ctx"]["expected_tags"].split(",")]
        return f"unknown {error['ctx']['discriminator']} '{error['ctx']['tag']}'; {nearest(str(error['ctx']['tag']), valid)}"
    if kind == "literal_error" and isinstance(given, str):
        valid = [word.strip("' ") for word in error["ctx"]["expected"].replace(" or ", ", ").split(",")]
        return f"'{given}' is not valid; {nearest(given, valid)}"
    message = str(error["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message[0].lower() + message[1:]
    if kind == "value_error" or isinstance(given, dict | list | BaseModel):
        return message
    return f"{message}; found {given!r}"


def _fields_at(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Names of the keys allowed at a place in a specification, through lists, options and tagged unions."""
    candidates: list[type[BaseModel]] = [model]
    for part in location:
        found: list[type[BaseModel]] = []
        for candidate in candidates:
            if isinstance(part, str) and part in candidate.model_fields:
                found += _models_in(candidate.model_fields[part].annotation)
            elif isinstance(part, str) and part in _tags(candidate):
                found.append(candidate)
            elif isinstance(part, int):
                found.append(candidate)
        candidates = found or candidates
    return sorted({name for candidate in candidates for name in candidate.model_fields})


def _tags(model: type[BaseModel]) -> set[str]:
    field = model.model_fields.get("kind")
    return set(get_args(field.annotation)) if field is not None else set()


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
