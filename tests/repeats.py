"""Many examples of one property, of which `make test` tries some."""

from collections.abc import Iterable
from typing import Any

import pytest


def few(count: int, values: Iterable[Any]) -> list[Any]:
    """Values of a parameter, those after the first few marked `long`: the same property again, with other numbers."""
    return [each if i < count else pytest.param(each, marks=pytest.mark.long) for i, each in enumerate(values)]
