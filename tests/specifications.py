"""Every specification that the models allow, as hypothesis strategies made from the models themselves."""

import contextlib
import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from hypothesis import reject
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from pydantic import BaseModel, JsonValue, ValidationError
from pydantic.fields import FieldInfo

from harness.simulation.scene import Box
from harness.simulation.texture import NoiseTexture, Texture

TEXT = st.text(st.characters(codec="utf-8"), max_size=8)
"""TOML is UTF-8: it has no lone surrogates."""

PLAIN = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=6,
)
"""What a key of any type may hold."""


def specification(model: type[BaseModel], **fixed: SearchStrategy[Any]) -> SearchStrategy[Any]:
    """Instances of a model, its fields within and at their bounds; `fixed`: strategies of some of them."""
    fields = {
        name: fixed.get(name, _of_field(field))
        if field.is_required() or name in fixed
        else st.none() | _of_field(field)
        for name, field in model.model_fields.items()
    }

    @st.composite
    def build(draw: st.DrawFn) -> Any:
        chosen = draw(st.fixed_dictionaries(fields))
        given = {name: value for name, value in chosen.items() if value is not None}  # None stands for the default
        needed = {name: each for name, each in given.items() if name in fixed or model.model_fields[name].is_required()}
        for values in (given, needed):
            # What only a validator of the whole knows (d_min_m below d_max_m, an odd window) is not in the fields.
            with contextlib.suppress(ValidationError):
                return model(**values)
        return reject()

    return build()


def _of_field(field: FieldInfo) -> SearchStrategy[Any]:
    return strategy_of(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)


def strategy_of(annotation: Any, metadata: tuple[Any, ...] = ()) -> SearchStrategy[Any]:
    """Values of a type, within the constraints beside it."""
    if annotation is JsonValue or annotation is Any:
        return PLAIN
    if get_origin(annotation) is Annotated:
        inner, *beside = get_args(annotation)
        return strategy_of(inner, (*_flat(beside), *metadata))
    if get_origin(annotation) in (Union, types.UnionType):
        members = [each for each in get_args(annotation) if each is not type(None)]
        return st.one_of(*(strategy_of(each) for each in members))
    if get_origin(annotation) is Literal:
        return st.sampled_from(get_args(annotation))
    if get_origin(annotation) in (tuple, list):
        return _sequence(annotation, metadata)
    if isinstance(get_origin(annotation), type) and issubclass(get_origin(annotation), Mapping):
        return st.dictionaries(TEXT, strategy_of(get_args(annotation)[1]), max_size=3)
    if annotation is Box:
        return specification(Box, texture=strategy_of(Texture))
    if annotation is NoiseTexture:
        band = {"tile_m": 4.0, "shortest_m": 0.5, "longest_m": 2.0}
        return specification(NoiseTexture, size_px=st.integers(16, 4096), **{k: st.just(v) for k, v in band.items()})
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return specification(annotation)
    return _scalar(annotation, metadata)


def _flat(metadata: Any) -> list[Any]:
    """Constraints out of what pydantic groups."""
    result: list[Any] = []
    for each in metadata:
        result += _flat(each.metadata) if isinstance(each, FieldInfo) else [each]
    return result


def _sequence(annotation: Any, metadata: tuple[Any, ...]) -> SearchStrategy[Any]:
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple and arguments[-1] is not ...:
        return st.tuples(*map(strategy_of, arguments))
    least = next((each.min_length for each in metadata if isinstance(each, annotated_types.MinLen)), 0)
    return st.lists(strategy_of(arguments[0]), min_size=least, max_size=least + 2)


def _scalar(annotation: Any, metadata: tuple[Any, ...]) -> SearchStrategy[Any]:
    if annotation is bool:
        return st.booleans()
    if annotation is str:
        return TEXT
    low, high = _bound(metadata, "ge", "gt"), _bound(metadata, "le", "lt")
    if annotation is int:
        return st.integers(-(2**63) if low is None else int(low), 2**63 - 1 if high is None else int(high))
    if annotation is float:
        infinite = all(getattr(each, "allow_inf_nan", True) for each in metadata)
        return st.floats(low, high, allow_nan=False, allow_infinity=infinite and (low is None or high is None))
    raise TypeError(f"no strategy for {annotation!r}")


def _bound(metadata: tuple[Any, ...], *names: str) -> Any:
    return next((getattr(each, name) for name in names for each in metadata if hasattr(each, name)), None)
