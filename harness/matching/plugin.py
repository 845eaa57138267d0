"""A matcher that is a third-party function."""

import inspect
import re
import traceback
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import field_validator

from harness import interrupts
from harness.errors import InputError, described, nearest
from harness.matching import plugins
from harness.matching.interface import Matches, Parametrised, as_matches
from harness.matching.pair import Pair


class Plugin(Parametrised):
    """A matcher that is not part of this program.

    `kind` is `package.module:function` or the name of an entry point. The function is called with the pair, the
    limits and the `parameters` as keywords: `matcher(pair, limits, **parameters)`; see `interface.faults` for what
    it may return. A class is made of the parameters once a worker, and its instance is called with pair and limits.
    A parameter named `file`, or ending in `_file`, names a file: a relative path is relative to the experiment's file,
    and the contents count as settings do.
    """

    kind: str
    """`package.module:function`, or the name of an installed entry point of the group `omnirange.matchers`."""

    @field_validator("kind")
    @classmethod
    def _named(cls, kind: str) -> str:
        offered = plugins.entry_points()
        if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", kind) and kind not in offered:
            from harness.matching.registry import BUILT_IN

            if file := re.fullmatch(r"(?:\./)?([A-Za-z_]\w*)\.py(?::([A-Za-z_]\w*))?", kind):
                raise ValueError(f"'{kind}' is a file; write its module and function: {file[1]}:{file[2] or 'match'}")
            known = [*BUILT_IN, *offered]
            raise ValueError(
                f"'{kind}' is neither a matcher nor written package.module:function; {nearest(kind, known)}"
            )
        return kind

    def match(self, pair: Pair) -> Matches:
        """The function's return value, checked."""
        return as_matches(self.answer(pair), pair.grid, self.kind)

    def answer(self, pair: Pair) -> Any:
        """The function's return value, unchecked."""
        return answer(pair, self)

    def match_seconds(self, image_mp: float, curve_mp: float) -> None:
        """None: the time of third-party code is not known."""

    def check(self) -> None:
        """Check that the function exists, and takes its parameters."""
        plugins.check(self.kind, self.parameters)

    def identity(self) -> str:
        """A hash of the function's source and of the files among its parameters."""
        return plugins.digest(self.kind, self.parameters)


def answer(pair: Pair, matcher: Plugin) -> Any:
    """The function's return value, unchecked.

    Raises
    ------
    InputError
        When it cannot be found, does not take its parameters, or fails.
    """
    matcher.check()
    function = plugins.find(matcher.kind)
    try:
        with plugins.contained(), np.errstate():  # its changes of NumPy's error state end here
            run = plugins.runner(matcher.kind, matcher.parameters)
            return run(replace(pair, owner=matcher.kind), matcher)
    except InputError:
        raise
    except BaseException as error:  # asyncio's and Rust's errors too are no Exception
        if interrupts.is_real(error):
            raise
        text = described(error)
        hint = "; a pair's arrays are shared: change a copy" if "read-only" in text else ""
        raise InputError(f"fails: {text}{_place_in(function, error)}{hint}", file=matcher.kind) from error


def _place_in(function: Callable[..., Any], error: BaseException) -> str:
    """The line of the function's, or class's, own file at which an error was raised."""
    try:
        file = inspect.getsourcefile(inspect.unwrap(function))
    except TypeError:  # built in, or made at run time
        return ""
    lines = [each for each in traceback.extract_tb(error.__traceback__) if file and each.filename == file]
    return f" ({lines[-1].filename}, line {lines[-1].lineno})" if lines else ""
