"""Checked access to the values of a parsed file: numbers, whole numbers, lists, tables, matrices."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from harness.display import shortened
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.io.calibrations.record import Content
from harness.spec import LARGEST_COEFFICIENT

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
"""YAML 1.1 reads `1e-05` as text."""


def refusal(content: Content, key: str, problem: str) -> InputError:
    """An error that names the file and the key."""
    return InputError(problem, file=content.file, key=key or None)


def number(content: Content, value: Any, key: str) -> float:
    """The value as a finite number; text that spells one is accepted."""
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise refusal(content, key, f"must be a number; found {_shown(value)}")
    try:
        value = float(value)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise refusal(content, key, f"must be a finite number; found {value}")
    if abs(value) > LARGEST_COEFFICIENT:
        raise refusal(content, key, f"must be at most {LARGEST_COEFFICIENT:g}; found {value:g}")
    return value


def whole(content: Content, value: Any, key: str) -> int:
    """The value as a whole number."""
    as_float = number(content, value, key)
    if as_float != int(as_float):
        raise refusal(content, key, f"must be a whole number; found {as_float:g}")
    return int(as_float)


def numbers(content: Content, value: Any, key: str, names: str | None = None) -> list[float]:
    """The value as a list of finite numbers.

    Parameters
    ----------
    names
        The names of the numbers in order, separated by spaces; their count is checked.
    """
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise refusal(content, key, f"must be a list of numbers; found {_shown(value)}")
    values = [number(content, each, f"{key}[{i}]") for i, each in enumerate(value)]
    if names is not None and len(values) != len(names.split()):
        expected = f"must be {len(names.split())} numbers ({names})" if names else "must be an empty list"
        raise refusal(content, key, f"{expected}; found {len(values)}")
    return values


def table(content: Content, value: Any, key: str) -> Mapping[str, Any]:
    """The value as a table."""
    if not isinstance(value, Mapping):
        raise refusal(content, key, f"must be a table; found {_shown(value)}")
    return value


def member(content: Content, parent: Mapping[str, Any], name: str, above: str = "") -> tuple[Any, str]:
    """The value of a required key, and its dotted key."""
    key = f"{above}.{name}" if above else name
    if name not in parent:
        there = ", ".join(map(str, parent)) or "none"
        raise refusal(content, key, f"this key is missing; there are: {shortened(there)}")
    return parent[name], key


def is_matrix(value: Any) -> bool:
    """Whether a value is a matrix of OpenCV's, or a list of numbers or of rows."""
    if isinstance(value, Mapping):
        return {"rows", "cols", "data"} <= set(value)
    return isinstance(value, list) and bool(value)


def matrix(content: Content, value: Any, key: str) -> Array:
    """The array `[rows, columns]` of a table with `rows`, `cols` and `data`, of a list of rows, or of one row."""
    if isinstance(value, Mapping):
        rows, cols = (whole(content, *member(content, value, each, key)) for each in ("rows", "cols"))
        data, data_key = member(content, value, "data", key)
        flat = numbers(content, data, data_key)
        if rows < 1 or len(flat) != rows * cols:
            raise refusal(content, data_key, f"must be {rows} x {cols} numbers; found {len(flat)}")
        return np.array(flat).reshape(rows, cols)
    if isinstance(value, list) and value and isinstance(value[0], list):
        parsed = [numbers(content, row, f"{key}[{i}]") for i, row in enumerate(value)]
        if len({len(row) for row in parsed}) != 1:
            raise refusal(content, key, "must be rows of one length")
        return np.array(parsed)
    return np.array([numbers(content, value, key)])


def transform(content: Content, value: Any, key: str) -> Array:
    """The value as a rigid motion `[4, 4]`."""
    rows = matrix(content, value, key)
    if rows.shape != (4, 4):
        raise refusal(content, key, f"must be 4 x 4 numbers; found {rows.shape[0]} x {rows.shape[1]}")
    check_rotation(content, rows[:3, :3], key)
    if not np.allclose(rows[3], [0, 0, 0, 1], rtol=0, atol=1e-6):
        raise refusal(content, key, "must have the last row 0 0 0 1")
    return rows


def check_rotation(content: Content, rotation: Array, key: str) -> None:
    """Check that a matrix is a rotation, to the five digits that files have at least."""
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise refusal(content, key, "is not a rotation: its rows must be orthonormal and right-handed")


def pixels(content: Content, value: Any, key: str) -> tuple[int, int]:
    """Width and height, pixels, from a list of two whole numbers."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise refusal(content, key, f"must be width and height, pixels; found {_shown(value)}")
    width, height = (whole(content, each, f"{key}[{i}]") for i, each in enumerate(value))
    return width, height


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return shortened(repr(value))
