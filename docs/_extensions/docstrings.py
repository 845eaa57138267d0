"""Docstrings are written for `help()`; here they become text that reStructuredText and napoleon leave alone."""

import re
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx

CODE = re.compile(r"(``.*?``|`[^`\n]*`)")
VALUES = {"attribute", "data", "property"}

_as_written: dict[str, list[str]] = {}


def escape(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """Escape bars, stars and trailing underscores outside of code: `|t|` is no substitution here."""
    for number, line in enumerate(lines):
        parts = CODE.split(line)
        parts[::2] = [re.sub(r"(\||\*(?!\*)|(?<=\w)_(?=\W|$))", r"\\\1", part) for part in parts[::2]]
        lines[number] = "".join(parts)
    if what in VALUES:
        _as_written[name] = list(lines)


def restore(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """Take back what napoleon makes of a value whose first line has a colon: it would be read as a type."""
    if what in VALUES and name in _as_written:
        lines[:] = _as_written.pop(name)


def skip(app: Sphinx, what: str, name: str, obj: Any, skipped: bool, options: Any) -> bool | None:  # noqa: ARG001
    """Leave the keys of specifications to the settings reference, which says more about them."""
    keys = _keys_of_specifications()
    return True if what == "class" and name in keys and not callable(obj) and not isinstance(obj, property) else None


def _keys_of_specifications() -> set[str]:
    waiting, names = [BaseModel], set()
    while waiting:
        model = waiting.pop()
        waiting += model.__subclasses__()
        names |= model.model_fields.keys() if model.__module__.startswith("harness.") else set()
    return names


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to autodoc, before and after napoleon."""
    app.connect("autodoc-process-docstring", escape, priority=100)
    app.connect("autodoc-process-docstring", restore, priority=900)
    app.connect("autodoc-skip-member", skip)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
