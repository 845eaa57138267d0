"""Pairs of trials of two runs: trials of one scene, pose and noise; the method may differ."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from harness.display import listed, shortened_labels
from harness.report.shipped_names import with_names
from harness.report.sweep import texts_of, value_text
from harness.report.written_runs import NONE, Run
from harness.runs.cases import CASE
from harness.runs.key_names import name_of

METHOD = "method"
"""Stands for all settings of the matcher where trials of different methods are pairs."""
_MATCHER = "matching."
_MOST = 6
"""Values, at most, that are listed."""

Conditions = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Pairs:
    """The pairs of two runs."""

    table: list[tuple[int, int]]
    """Numbers of trials, of the first run and of the second."""
    methods: list[str]
    """For each pair the two methods in words; empty where all pairs are of one kind."""
    differing: dict[str, tuple[str, str]]
    """Settings that no trial of one run shares with any of the other; a value in words, or several. Cases of different
    names in the place of what they set."""
    why_none: str
    """The reason in words, if nothing could be paired."""
    left_out: list[str] = field(default_factory=list)
    """A phrase for each run with trials that have no partner: how many, and what sets them apart."""


def pairs_of(first: Run, second: Run) -> Pairs:
    """The pairs: trials with equal settings, except for settings whose values in one run never occur in the other.

    Where that leaves a trial without a unique partner because a run has several methods, every method of one run is
    paired with every method of the other under all other settings.
    """
    runs = first, second = with_names(first, second)
    differing = _differing(first, second)
    if not (first.settings and second.settings):
        return Pairs([], [], _differences_in_words(first, second, differing), "One of the runs has no finished trial.")
    by_settings = [_by_settings(run, set(differing)) for run in runs]
    unique = all(len(distinct) == len(run.settings) for distinct, run in zip(by_settings, runs, strict=True))
    common = [each for each in by_settings[0] if each in by_settings[1]] if unique else []
    if common:
        table = [(by_settings[0][each], by_settings[1][each]) for each in common]
        return Pairs(table, [], _differences_in_words(first, second, differing), "", _left_out(first, second, table))
    of_methods = _by_method(first, second, differing)
    if of_methods is not None:
        return of_methods
    return Pairs(
        [], [], _differences_in_words(first, second, differing), _why_none(first, second, differing, unique=unique)
    )


def _by_method(first: Run, second: Run, differing: Sequence[str]) -> Pairs | None:
    """The pairs of every method with every method; None if nothing is paired, or a method has no unique trial."""
    other_settings = {key for key in differing if not key.startswith(_MATCHER)}
    methods = _method_names([*first.settings, *second.settings])
    trials: list[dict[Conditions, dict[str, int]]] = []
    for run in (first, second):
        conditions: dict[Conditions, dict[str, int]] = {}
        for index, settings in enumerate(run.settings):
            same = conditions.setdefault(_conditions(settings, other_settings, _MATCHER), {})
            method = methods[_method(settings)]
            if method in same:
                return None
            same[method] = index
        trials.append(conditions)
    matched = [
        (a, b, f"{other} against {one}")
        for conditions, mine in trials[0].items()
        for one, a in mine.items()
        for other, b in trials[1].get(conditions, {}).items()
    ]
    if not matched:
        return None
    order = list(dict.fromkeys(text for *_, text in matched))
    matched.sort(key=lambda each: order.index(each[2]))
    table = [(a, b) for a, b, _ in matched]
    of_runs = [list(dict.fromkeys(methods[_method(each)] for each in run.settings)) for run in (first, second)]
    in_words = {METHOD: (_first_few(of_runs[0]), _first_few(of_runs[1]))} | _differences_in_words(
        first, second, sorted(other_settings)
    )
    return Pairs(table, [text for *_, text in matched], in_words, "", _left_out(first, second, table))


def _method(settings: dict[str, str]) -> Conditions:
    return tuple(sorted((key, value) for key, value in settings.items() if key.startswith(_MATCHER)))


def _method_names(trials: Iterable[dict[str, str]]) -> dict[Conditions, str]:
    """A name for each method: its kind, and the settings by which methods of this kind differ."""
    methods = [dict(each) for each in dict.fromkeys(map(_method, trials))]
    names = []
    for method in methods:
        alike = [each for each in methods if each.get(_KIND) == method.get(_KIND)]
        varying = [key for key in method if len({each.get(key, NONE) for each in alike}) > 1]
        values = [_setting_text(key, method[key], alone=len(varying) == 1) for key in varying]
        kind = str(json.loads(method.get(_KIND, '"window"')))
        names.append(f"{kind} ({', '.join(values)})" if values else kind)
    return dict(zip([tuple(sorted(each.items())) for each in methods], shortened_labels(names), strict=True))


_KIND = "matching.kind"
_STEPS = {"none": "whole pixels", "parabola": "sub-pixel"}


def _setting_text(key: str, value: str, *, alone: bool) -> str:
    """A setting of a matcher in words; a step, or a word that stands alone, needs no key."""
    known = json.loads(value)
    if key == "matching.subpixel":
        return _STEPS.get(known, str(known))
    text = value_text(known)
    return text if alone and isinstance(known, str) else f"{key.rpartition('.')[2]} {text}"


def _why_none(first: Run, second: Run, differing: Sequence[str], *, unique: bool) -> str:
    if unique:
        return "Nothing can be paired: no trial of one run has the settings of a trial of the other."
    several = [name_of(key) for key in differing if len(_values(first, key)) > 1 or len(_values(second, key)) > 1]
    return (
        f"Nothing can be paired: {listed(several)} {'varies' if len(several) == 1 else 'vary'} within a run and "
        "has no value in common with the other, so that a trial has no unique partner."
    )


def _left_out(first: Run, second: Run, table: Sequence[tuple[int, int]]) -> list[str]:
    """The trials without a partner, a phrase for each run."""
    phrases = []
    for run, other, used in zip((first, second), (second, first), map(set, zip(*table, strict=True)), strict=True):
        alone = [settings for index, settings in enumerate(run.settings) if index not in used]
        if not alone:
            continue
        reasons = []
        for key in dict.fromkeys(key for settings in run.settings for key in settings):
            mine = {settings.get(key, NONE) for settings in alone}
            if not mine & _values(other, key) and len(_values(run, key)) > len(mine):
                reasons.append(f"{name_of(key)}: {_texts(mine)}")
        why = f" ({'; '.join(reasons[:3])})" if reasons else ""
        phrases.append(f"{len(alone)} of {len(run.settings)} trials of {run.name} have no partner{why}")
    return phrases


def _texts(values: set[str]) -> str:
    return _first_few(sorted(texts_of([json.loads(value) for value in sorted(values)])))


def _differing(first: Run, second: Run) -> list[str]:
    """Settings whose values in one run are none of those in the other; `scene.name` and the like among them."""
    keys = dict.fromkeys(key for run in (first, second) for settings in run.settings for key in settings)
    return [key for key in keys if not _values(first, key) & _values(second, key)]


def _differences_in_words(first: Run, second: Run, differing: Sequence[str]) -> dict[str, tuple[str, str]]:
    """The differing settings with their values in both runs; keys of cases as the cases, if these have other names."""
    of_cases = {*first.case_keys, *second.case_keys}
    names = [list(dict.fromkeys(filter(None, run.cases))) for run in (first, second)]
    if set(names[0]) == set(names[1]) or not of_cases & set(differing):
        of_cases = set()
    shown = [key for key in differing if key not in of_cases and not _of_another_matcher(first, second, key, differing)]
    words = {key: _both(_values(first, key), _values(second, key)) for key in shown}
    if not of_cases:
        return words
    one, other = ("; ".join(each[:_MOST]) + ("; …" if len(each) > _MOST else "") or "none" for each in names)
    return {CASE: (one, other), **words}


def _of_another_matcher(first: Run, second: Run, key: str, differing: Sequence[str]) -> bool:
    """Whether the kinds of the matchers, which differ, say why one of two runs does not have a setting."""
    missing = {NONE} in (_values(first, key), _values(second, key))
    return missing and key.startswith(_MATCHER) and _KIND in differing


def _values(run: Run, key: str) -> set[str]:
    return {settings.get(key, NONE) for settings in run.settings}


def _both(first: set[str], second: set[str]) -> tuple[str, str]:
    """The values of two runs, each text different from all others: the first few."""
    known = sorted(first | second)
    text_of = dict(zip(known, texts_of([json.loads(value) for value in known]), strict=True))
    one, other = (sorted(text_of[value] for value in values) for values in (first, second))
    return _first_few(one), _first_few(other)


def _first_few(texts: Sequence[str]) -> str:
    return f"{', '.join(texts[:_MOST])}, …" if len(texts) > _MOST else ", ".join(texts) or "none"


def _by_settings(run: Run, without: set[str]) -> dict[Conditions, int]:
    """Trials by all settings except some."""
    return {_conditions(settings, without): index for index, settings in enumerate(run.settings)}


def _conditions(settings: dict[str, str], without: set[str], prefix: str = "\0") -> Conditions:
    """Settings without some keys, and without keys that begin with `prefix`."""
    return tuple(sorted(each for each in settings.items() if each[0] not in without and not each[0].startswith(prefix)))
