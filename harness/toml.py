"""TOML read within limits, so that no file and no argument can take long or need much."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.errors import InputError
from harness.files import not_text, read_regular

MOST_BYTES = 4 * 2**20
"""The largest file: about a hundred thousand lines."""
MOST_LEVELS = 64
"""Tables and lists inside each other. The deepest key of a specification is at level 8; a matcher's parameters may go
deeper."""

_QUOTED_OR_COMMENT = re.compile(
    r'''"""(?:[^\\]|\\.)*?(?:"""|\Z)|"(?:[^"\\\n]|\\[^\n])*+"?|#[^\n]*''' + r"""|'{3}.*?(?:'{3}|\Z)|'[^'\n]*+'?""",
    re.DOTALL,
)
"""Text without an end goes to the end of its line or of the file: each letter is looked at once."""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MOST_LEVELS}}}")
_TOO_DEEP = f"tables and lists are nested more than {MOST_LEVELS} deep"


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; a byte order mark before it does no harm.

    Raises
    ------
    InputError
        When the file is missing, no regular file, larger than `MOST_BYTES`, not TOML, or too deep.
    """
    data = read_regular(path, MOST_BYTES)
    try:
        return parse_toml(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(not_text(data, "TOML file"), file=path) from error
    except ValueError as error:  # TOMLDecodeError, or a number of too many digits
        raise InputError(f"not valid TOML: {error}", file=path) from error
    except InputError as error:
        raise InputError(error.problem, file=path) from error


def parse_toml(text: str) -> dict[str, Any]:
    """The table in a TOML text.

    Raises
    ------
    ValueError
        When it is not TOML, or a number in it has thousands of digits.
    InputError
        When it is too deep.
    """
    # Before it is parsed: the parser recurses at each bracket, and copies the whole of a dotted key at each dot.
    bare = _QUOTED_OR_COMMENT.sub("q", text)
    if _LONG_KEY.search(bare) or _bracket_levels(bare) > MOST_LEVELS:
        raise InputError(_TOO_DEEP)
    table = tomllib.loads(text)
    if levels(table) > MOST_LEVELS:
        raise InputError(_TOO_DEEP)
    return table


def levels(value: Any) -> int:
    """The depth of nested tables and lists, the value itself included; 0 for a plain value."""
    deepest, waiting = 0, [(value, 1)]
    while waiting:
        one, level = waiting.pop()
        if isinstance(one, Mapping | list | tuple):
            deepest = max(deepest, level)
            if deepest > MOST_LEVELS:
                break
            waiting += [(each, level + 1) for each in (one.values() if isinstance(one, Mapping) else one)]
    return deepest


def _bracket_levels(bare: str) -> int:
    """The largest number of brackets that are open at once."""
    level = deepest = 0
    for bracket in re.findall(r"[][{}]", bare):
        level = level + 1 if bracket in "[{" else max(0, level - 1)
        deepest = max(deepest, level)
    return deepest
