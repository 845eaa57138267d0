"""The table of matchers: their settings by `kind`.

A `kind` is one of the matchers here, `program` for one in any language, a name that an installed package gives in the
entry point group `omnirange.matchers`, or `package.module:function`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, get_args

from pydantic import Discriminator, Tag

from harness.matching import plugins
from harness.matching.interface import MatcherSettings
from harness.matching.opencv.settings import StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.plugin import Plugin
from harness.matching.program import Program
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted.settings import Slanted
from harness.matching.window.settings import WindowMatcher

BUILT_IN: dict[str, type[MatcherSettings]] = {
    kind: settings
    for settings in (WindowMatcher, SemiGlobal, Slanted, Program, StereoBM, StereoSGBM, StereoReconstruct)
    for kind in get_args(settings.model_fields["kind"].annotation)
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
"""The settings of any matcher, chosen by `kind`."""


def method_of(matcher: MatcherSettings) -> tuple[str, str]:
    """The name of a method in tables: the matcher's kind and its sub-pixel step."""
    return matcher.kind, matcher.step


def carried_over(settings: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    """The table of a matcher after its `kind` was changed, with the keys that the new kind has too."""
    model = BUILT_IN.get(kind, Plugin) if isinstance(kind, str) else Plugin
    if settings.get("kind") == kind:
        return dict(settings)
    same = BUILT_IN.get(str(settings.get("kind", "window")), Plugin) is model
    known = model.model_fields if same else MatcherSettings.model_fields
    taken = {key: value for key, value in settings.items() if key in known} | {"kind": kind}
    if same and model is Plugin and isinstance(taken.get("parameters"), Mapping):
        taken["parameters"] = {name: value for name, value in taken["parameters"].items() if plugins.takes(kind, name)}
    return taken


def knows(kind: Any, key: str) -> bool:
    """Whether the settings of a matcher have a key."""
    return key in (BUILT_IN.get(kind, Plugin) if isinstance(kind, str) else Plugin).model_fields
