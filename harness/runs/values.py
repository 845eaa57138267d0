"""Values of settings as text: for people, for tables, and as identities."""

import json
import math
from collections.abc import Mapping
from typing import Any

Settings = dict[str, Any]
"""Dotted keys of a trial, such as `matching.window_px` or `scene.objects.0.size_m`, and their values."""


def shown(coordinates: Settings) -> str:
    """Coordinates on the axes as text; other values of the same keys never give the same text."""
    return ", ".join(f"{key} = {_quoted(value)}" for key, value in coordinates.items()) or "the base trial"


def _quoted(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) and ", " in value else text_of(value)


def text_of(value: Any) -> str:
    """A value's distinct text in tables: empty for None, and otherwise one that reads back exactly.

    Text stands as it is, unless it would read as something else, such as a number: then in quotes.
    """
    if value is None:
        return ""
    if type(value) is float and math.isfinite(value):
        return repr(value)  # as JSON has it, and tables are full of them
    if not isinstance(value, str):
        return json.dumps(value)
    try:
        json.loads(value)
    except ValueError:
        return value or '""'
    return json.dumps(value, ensure_ascii=False)


def value_of(text: str) -> Any:
    """The value that `text_of` shows."""
    if not text:
        return None
    try:
        return json.loads(text)
    except ValueError:
        return text


def identity_of(key: str, value: Any) -> str:
    """The identity of a key's value: equal texts for equal values, however a number is written.

    A matcher may distinguish 1 from 1.0 in a parameter, and then so do its trials.
    """
    exact = key == "matching" or key.startswith("matching.parameters")
    return json.dumps(value if exact else _in_one_type(value), sort_keys=True)


def _in_one_type(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _in_one_type(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_in_one_type(each) for each in value]
    # But for the zero with a sign, which makes another trial.
    whole = isinstance(value, float) and value.is_integer() and (value != 0 or math.copysign(1, value) > 0)
    return int(value) if whole else value
