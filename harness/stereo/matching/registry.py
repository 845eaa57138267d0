"""Which matchers there are: settings by their `kind`, and what runs them.

A `kind` is one of the matchers here, `program` for one in any language, a name that an installed package gives in the
entry point group `omnirange.matchers`, or `package.module:function`.
"""

import hashlib
import importlib
import importlib.metadata
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import Discriminator, Field, Tag, field_validator

from harness.errors import InputError
from harness.spec import nearest
from harness.stereo.matching import window
from harness.stereo.matching.contract import Limits, Matches, as_matches
from harness.stereo.matching.window_settings import WindowMatcher
from harness.stereo.pair import Pair

ENTRY_POINTS = "omnirange.matchers"

Parameter = bool | int | float | str | list[Any] | dict[str, Any]


class Plugin(Limits):
    """A matcher that is not part of this program.

    `kind` is `package.module:function` or the name of an entry point. The function is called with the pair, the
    limits and the `parameters` as keywords: `matcher(pair, limits, **parameters)`; see `contract.as_matches` for what
    it may return.
    """

    kind: str
    parameters: Annotated[dict[str, Parameter], Field(default_factory=dict)]

    @field_validator("kind")
    @classmethod
    def _named(cls, kind: str) -> str:
        if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", kind) and kind not in _entry_points():
            known = [*BUILT_IN, *_entry_points()]
            raise ValueError(
                f"'{kind}' is neither a matcher nor written package.module:function; {nearest(kind, known)}"
            )
        return kind

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


_MATCHERS: dict[type[Limits], Callable[[Pair, Any], Matches]] = {
    WindowMatcher: window.match_pair,
}

BUILT_IN: dict[str, type[Limits]] = {
    kind: settings for settings in _MATCHERS for kind in get_args(settings.model_fields["kind"].annotation)
}
"""The settings of every matcher of this program, by `kind`."""


def _tag(value: Any) -> str:
    kind = value.get("kind", "window") if isinstance(value, Mapping) else getattr(value, "kind", "window")
    return BUILT_IN.get(kind, Plugin).__name__ if isinstance(kind, str) else WindowMatcher.__name__


Matcher = Annotated[
    Annotated[WindowMatcher, Tag("WindowMatcher")] | Annotated[Plugin, Tag("Plugin")],
    Discriminator(_tag),
]
"""The settings of any matcher, told apart by `kind`."""


def match_pair(pair: Pair, matcher: Limits) -> Matches:
    """Run a matcher.

    Raises
    ------
    InputError
        When the matcher cannot be found, does not take its parameters, or returns what is no answer.
    """
    if not isinstance(matcher, Plugin):
        return _MATCHERS[type(matcher)](pair, matcher)
    function = find(matcher.kind)
    try:
        inspect.signature(function).bind(pair, matcher, **matcher.parameters)
    except TypeError as error:
        raise InputError(f"cannot be called with (pair, limits, **parameters): {error}", file=matcher.kind) from error
    return as_matches(function(pair, matcher, **matcher.parameters), pair.grid, matcher.kind)


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
    return {key: value for key, value in settings.items() if key in known} | {"kind": kind}


def find(kind: str) -> Callable[..., Any]:
    """The function that a plug-in's `kind` names; modules are also looked for in the current folder.

    Raises
    ------
    InputError
        When there is no such module or function.
    """
    if kind in _entry_points():
        try:
            return _callable(_entry_points()[kind].load(), kind)
        except Exception as error:
            raise InputError(f"cannot be loaded: {type(error).__name__}: {error}", file=kind) from error
    module_name, _, name = kind.partition(":")
    module = _module(module_name, kind)
    if not hasattr(module, name):
        functions = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
        raise InputError(f"the module {module_name} has no '{name}'; {nearest(name, functions)}", file=kind)
    return _callable(getattr(module, name), kind)


def fingerprint(matcher: Limits) -> str:
    """What of a matcher its settings do not tell: the contents of a plug-in's own files; empty for those here.

    Raises
    ------
    InputError
        As `find`.
    """
    if not isinstance(matcher, Plugin):
        return ""
    function = inspect.unwrap(find(matcher.kind))
    module = sys.modules.get(getattr(function, "__module__", "") or "")
    file = getattr(module, "__file__", None)
    if not file:
        return ""
    # A package counts with all of its source: the function may lean on any of it.
    top = sys.modules.get((module.__name__ if module else "").partition(".")[0])
    root = Path(file).parent if top is None or not hasattr(top, "__path__") else Path(next(iter(top.__path__)))
    files = sorted(root.rglob("*.py")) if top is not None and hasattr(top, "__path__") else [Path(file)]
    return _digest(tuple((path.relative_to(root).as_posix(), path.stat().st_mtime_ns, str(path)) for path in files))


@lru_cache(maxsize=16)
def _digest(files: tuple[tuple[str, int, str], ...]) -> str:
    digest = hashlib.sha256()
    for name, _, path in files:
        digest.update(name.encode() + b"\0" + Path(path).read_bytes() + b"\0")
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _entry_points() -> dict[str, importlib.metadata.EntryPoint]:
    return {each.name: each for each in importlib.metadata.entry_points(group=ENTRY_POINTS)}


def _module(name: str, kind: str) -> Any:
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: a user's file never hides a library
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise InputError(f"there is no module {name}, neither installed nor in {here}", file=kind) from error
        raise InputError(f"the module {name} needs {error.name}, which is not installed", file=kind) from error
    except Exception as error:
        raise InputError(f"the module {name} fails: {type(error).__name__}: {error}", file=kind) from error


def _callable(found: Any, kind: str) -> Callable[..., Any]:
    if not callable(found):
        raise InputError(f"is a {type(found).__name__}, not a function", file=kind)
    function: Callable[..., Any] = found
    return function
