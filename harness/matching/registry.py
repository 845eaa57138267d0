"""Which matchers there are: settings by their `kind`, and what runs them.

A `kind` is one of the matchers here, `program` for one in any language, a name that an installed package gives in the
entry point group `omnirange.matchers`, or `package.module:function`.
"""

import copy
import inspect
import re
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import Discriminator, Tag, field_validator

from harness.errors import InputError
from harness.matching import plugins, program
from harness.matching.interface import Limits, Matches, Parametrised, as_matches
from harness.matching.opencv import match as peers
from harness.matching.opencv.settings import StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.pair import Pair
from harness.matching.program import Program
from harness.matching.semi_global import match as semi_global
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted import match as slanted
from harness.matching.slanted.match import Slanted
from harness.matching.window import match as window
from harness.matching.window.settings import WindowMatcher
from harness.spec import nearest


class Plugin(Parametrised):
    """A matcher that is not part of this program.

    `kind` is `package.module:function` or the name of an entry point. The function is called with the pair, the
    limits and the `parameters` as keywords: `matcher(pair, limits, **parameters)`; see `contract.faults` for what
    it may return. A parameter named `file`, or ending in `_file`, names a file: a relative path is relative to the
    experiment's file, and the contents count as settings do.
    """

    kind: str
    """`package.module:function`, or the name of an installed entry point of the group `omnirange.matchers`."""

    @field_validator("kind")
    @classmethod
    def _named(cls, kind: str) -> str:
        offered = plugins.entry_points()
        if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", kind) and kind not in offered:
            known = [*BUILT_IN, *offered]
            raise ValueError(
                f"'{kind}' is neither a matcher nor written package.module:function; {nearest(kind, known)}"
            )
        return kind


_MATCHERS: dict[type[Limits], Callable[[Pair, Any], Matches]] = {
    WindowMatcher: window.match_pair,
    SemiGlobal: semi_global.match_pair,
    Slanted: slanted.match_pair,
    Program: program.match_pair,
    StereoBM: peers.match_pair,
    StereoSGBM: peers.match_pair,
    StereoReconstruct: peers.match_pair,
}

BUILT_IN: dict[str, type[Limits]] = {
    kind: settings for settings in _MATCHERS for kind in get_args(settings.model_fields["kind"].annotation)
}
"""The settings of every matcher of this program, by `kind`."""


def _tag(value: Any) -> str:
    kind = value.get("kind", "window") if isinstance(value, Mapping) else getattr(value, "kind", "window")
    return BUILT_IN.get(kind, Plugin).__name__ if isinstance(kind, str) else WindowMatcher.__name__


Matcher = Annotated[
    Annotated[WindowMatcher, Tag("WindowMatcher")]
    | Annotated[SemiGlobal, Tag("SemiGlobal")]
    | Annotated[Slanted, Tag("Slanted")]
    | Annotated[Program, Tag("Program")]
    | Annotated[StereoBM, Tag("StereoBM")]
    | Annotated[StereoSGBM, Tag("StereoSGBM")]
    | Annotated[StereoReconstruct, Tag("StereoReconstruct")]
    | Annotated[Plugin, Tag("Plugin")],
    Discriminator(_tag),
]
"""The settings of any matcher, told apart by `kind`."""


def match_pair(pair: Pair, matcher: Limits) -> Matches:
    """Run a matcher.

    Raises
    ------
    InputError
        When somebody else's matcher cannot be found, does not take its parameters, fails, or returns what is no answer.
    """
    if isinstance(matcher, Plugin):
        return as_matches(answer(pair, matcher), pair.grid, matcher.kind)
    return _MATCHERS[type(matcher)](pair, matcher)


def answer(pair: Pair, matcher: Limits) -> Any:
    """What a matcher returns, not yet checked; errors as in `match_pair`."""
    if isinstance(matcher, Program):
        return program.answer(pair, matcher)
    if not isinstance(matcher, Plugin):
        return _MATCHERS[type(matcher)](pair, matcher)
    check(matcher)
    function = plugins.find(matcher.kind)
    try:
        with np.errstate():  # what it sets is its own
            return function(replace(pair, owner=matcher.kind), matcher, **copy.deepcopy(matcher.parameters))
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        hint = "; a pair's arrays are everybody's: change a copy" if "read-only" in str(error) else ""
        raise InputError(
            f"fails: {type(error).__name__}: {error}{_place_in(function, error)}{hint}", file=matcher.kind
        ) from error


def _place_in(function: Callable[..., Any], error: BaseException) -> str:
    """Where in the function's own file an error came up."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    lines = [each for each in traceback.extract_tb(error.__traceback__) if code and each.filename == code.co_filename]
    return f" ({lines[-1].filename}, line {lines[-1].lineno})" if lines else ""


def check(matcher: Limits) -> None:
    """See what can be seen of a matcher before it is run: that it is there, and takes its parameters.

    Raises
    ------
    InputError
        `error.key` is the key in the matcher's table.
    """
    if isinstance(matcher, Plugin):
        plugins.check(matcher.kind, matcher.parameters)
    elif isinstance(matcher, Program):
        program.check(matcher)


def fingerprint(matcher: Limits) -> str:
    """What of a matcher its settings do not tell: the contents of files; empty for a matcher of this program.

    Raises
    ------
    InputError
        When a file cannot be read, or there is no such module.
    """
    if isinstance(matcher, Plugin):
        return plugins.digest(matcher.kind, matcher.parameters)
    return program.digest(matcher) if isinstance(matcher, Program) else ""


def method_of(matcher: Limits) -> tuple[str, str]:
    """What tells methods apart in tables: the matcher's kind and its sub-pixel step.

    `own` stands for the step of a matcher that has no choice of them.
    """
    return str(getattr(matcher, "kind", "matcher")), str(getattr(matcher, "subpixel", "own"))


def carried_over(settings: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    """The table of a matcher after its `kind` was changed: what the new one knows stays."""
    model = BUILT_IN.get(kind, Plugin) if isinstance(kind, str) else Plugin
    if settings.get("kind") == kind:
        return dict(settings)
    same = BUILT_IN.get(str(settings.get("kind", "window")), Plugin) is model
    known = model.model_fields if same else Limits.model_fields
    kept = {key: value for key, value in settings.items() if key in known} | {"kind": kind}
    if same and model is Plugin and isinstance(kept.get("parameters"), Mapping):
        kept["parameters"] = {name: value for name, value in kept["parameters"].items() if plugins.takes(kind, name)}
    return kept


def knows(kind: Any, key: str) -> bool:
    """Whether the settings of a matcher have a key."""
    return key in (BUILT_IN.get(kind, Plugin) if isinstance(kind, str) else Plugin).model_fields
