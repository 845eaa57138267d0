"""How payloads show themselves: one line, in which arrays are told by type and shape and never printed."""

from dataclasses import fields, is_dataclass
from typing import Any

LONGEST = 160
"""Characters of a repr; what is longer ends in dots."""


_NESTED = 60
"""Characters of something inside a repr; of what is longer only the type is told, and its name if it has one."""


class OneLine:
    """Base of payloads: `Matches(alpha_2=float64[200, 720], confidence=float64[200, 720])`.

    For dataclasses declared with `repr=False`. What is None is left out.
    """

    def __repr__(self) -> str:
        parts = {each.name: getattr(self, each.name) for each in fields(self) if each.repr}  # type: ignore[arg-type]
        text = ", ".join(f"{name}={brief(value)}" for name, value in parts.items() if value is not None)
        return f"{type(self).__name__}({shortened(text)})"


def brief(value: Any) -> str:
    """A value in a few words: an array by its type and shape, a small one by its values, a collection by its size."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        if value.ndim == 1 and value.size <= 3:
            return "[" + ", ".join(f"{each:g}" for each in value) + "]"
        return f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    if isinstance(value, tuple) and len(value) <= 2:
        return f"({', '.join(map(brief, value))})"
    if isinstance(value, list | tuple | dict | set | frozenset):
        return f"{type(value).__name__} of {len(value)}"
    text = repr(value) if isinstance(value, OneLine) or not is_dataclass(value) else ""
    if not text or len(text) > _NESTED:
        name = getattr(value, "name", None)
        return f"{type(value).__name__}({f'{name!r}, ' if isinstance(name, str) else ''}...)"
    return text


def shortened(text: str) -> str:
    """A text in one line, no longer than `LONGEST`."""
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 4].rstrip(', ')} ..."
