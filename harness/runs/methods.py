"""The methods that trials compare, identified by their settings and named uniquely."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath
from types import MappingProxyType

from harness.display import shortened_labels
from harness.matching.interface import MatcherSettings

MethodId = tuple[str, str, tuple[str, ...]]
"""The identity of a method: the matcher's kind, its sub-pixel step, and the command of a program."""
MethodName = tuple[str, str]
"""The name of a method in tables: the matcher and its sub-pixel step. Unique within an experiment."""

METHOD_KEYS = ("matching.kind", "matching.subpixel", "matching.command")
"""The keys of a trial that distinguish methods; they are neither axes nor conditions."""


WINDOWS = ("window", "column")
"""The matchers whose sub-pixel step is a choice: they are known by it."""
_STEPS = {"none": "whole pixels", "own": ""}
_LONGEST = 60
"""Characters of a name."""


def names_for_people(
    methods: Iterable[MethodName], labels: Mapping[MethodName, str] = MappingProxyType({})
) -> dict[MethodName, str]:
    """The name of each method in legends, tables and sentences; unique among these methods.

    Parameters
    ----------
    labels
        The names that cases give to methods.
    """
    pairs = list(dict.fromkeys(methods))
    steps = [step_for_people(pair, pairs) for pair in pairs]
    several = len({matcher for matcher, _ in pairs}) > 1
    names = [
        labels.get((matcher, step), f"{matcher}, {word}" if several and word != matcher else word)
        for (matcher, step), word in zip(pairs, steps, strict=True)
    ]
    return dict(zip(pairs, shortened_labels(names, _LONGEST), strict=True))


def step_for_people(method: MethodName, methods: Sequence[MethodName]) -> str:
    """The name of a method's step alone, among others of its matcher; the matcher's where it has one step."""
    matcher, step = method
    if step == "own" or (matcher not in WINDOWS and sum(other == matcher for other, _ in methods) == 1):
        return matcher
    refined = {each for other, each in methods if other in WINDOWS} - {"none"}
    # "Sub-pixel" is enough where there is one such step.
    return {"none": "whole pixels"}.get(step) or ("sub-pixel" if step == "parabola" and refined == {step} else step)


def in_words(method: MethodName, names: Mapping[MethodName, str]) -> str:
    """The name of a method in a sentence: one of these, or else all that is known of it."""
    if method in names:
        return names[method]
    matcher, step = method
    word = _STEPS.get(step, step)
    return f"{matcher} ({word})" if word else matcher


def method_id(matcher: MatcherSettings) -> MethodId:
    """The identity of the method."""
    return matcher.kind, matcher.step, matcher.command_words


def method_names(matchers: Iterable[MatcherSettings]) -> Mapping[MethodId, MethodName]:
    """A name for each method: kind and step, and where these are shared the words in which the commands differ."""
    alike: dict[MethodName, dict[MethodId, None]] = {}
    for matcher in matchers:
        kind, step, _ = identity = method_id(matcher)
        alike.setdefault((kind, step), {})[identity] = None
    names: dict[MethodId, MethodName] = {}
    for (kind, step), identities in alike.items():
        words = [""] if len(identities) == 1 else shortened_labels(_differing([command for *_, command in identities]))
        names |= {each: (f"{kind} {word}".rstrip(), step) for each, word in zip(identities, words, strict=True)}
    return names


def _differing(commands: Sequence[tuple[str, ...]]) -> list[str]:
    """The words in which commands differ: files by their names, where these differ too."""
    if len({len(command) for command in commands}) > 1:
        return [" ".join(command) for command in commands]
    columns = [column for column in zip(*commands, strict=True) if len(set(column)) > 1]
    named = [[PurePath(word).name for word in column] for column in columns]
    chosen = [
        names if len(set(names)) == len(set(column)) else column for names, column in zip(named, columns, strict=True)
    ]
    return [" ".join(words) for words in zip(*chosen, strict=True)]
