"""The meanings of a specification's keys: the docstrings below them, read from the source."""

import ast
import inspect
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from textwrap import dedent

from pydantic import BaseModel

from harness.spec import Spec


@lru_cache
def key_meanings(spec: type[BaseModel]) -> Mapping[str, str]:
    """Meanings by key, each on one line; a key without a docstring, or whose class has no source, is not there."""
    meanings: dict[str, str] = {}
    for base in reversed(spec.__mro__):
        if issubclass(base, BaseModel) and base not in (BaseModel, Spec):
            meanings |= _documented(base)
    return meanings


def _documented(spec: type) -> dict[str, str]:
    try:
        (statement,) = ast.parse(dedent(inspect.getsource(spec))).body
    except OSError:  # made without a file
        return {}
    body = statement.body if isinstance(statement, ast.ClassDef) else []
    return {
        key.target.id: " ".join(below.value.value.split())
        for key, below in pairwise(body)
        if isinstance(key, ast.AnnAssign)
        and isinstance(key.target, ast.Name)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }
