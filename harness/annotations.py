"""The types that the value at a key of a specification may have, read from its annotations."""

import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel


def members(annotation: Any) -> list[Any]:
    """The types that a value may have: those of a union one by one, without None, and bare of `Annotated`."""
    if get_origin(annotation) is Annotated:
        return members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [each for member in get_args(annotation) for each in members(member) if each is not type(None)]
    return [annotation]


def inside(annotation: Any, part: int | str) -> list[Any]:
    """The types that may stand at a key or an index of a value of this type, the members of a union one by one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        field = annotation.model_fields.get(str(part))
        return [] if field is None else members(field.annotation)
    arguments = get_args(annotation)
    if not arguments:
        return []
    if get_origin(annotation) is tuple and isinstance(part, int) and arguments[-1] is not ...:
        return members(arguments[part]) if part < len(arguments) else []
    is_table = isinstance(get_origin(annotation), type) and issubclass(get_origin(annotation), Mapping)
    return members(arguments[1] if is_table else arguments[0])


def tags(annotation: Any, name: str | None = None) -> set[Any]:
    """The values of the literal keys of a specification, or of one of them: one is the tag that pydantic sees."""
    fields = getattr(annotation, "model_fields", {})
    literals = [
        f.annotation for key, f in fields.items() if name in (None, key) and get_origin(f.annotation) is Literal
    ]
    return {tag for literal in literals for tag in get_args(literal)}
