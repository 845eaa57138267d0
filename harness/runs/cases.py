"""Named cases: settings of a trial that change together, under one name."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from harness.display import brief, shortened
from harness.errors import InputError, Notice
from harness.runs.methods import METHOD_KEYS, MethodName
from harness.runs.values import Settings

CASE = "case"
"""The coordinate of a trial that holds its case's name; no key of a trial."""
NAME = "name"
"""The key of a case that holds its name."""
LONGEST = 60
"""Most letters of a name: labels are shown whole up to this length."""
NAME_MEANING = (
    "The case's name: the label of its trials in tables, legends and files. Each case has one of its own, of at most "
    f'{LONGEST} letters, such as "1280x960, 0.3 m". All other keys of a case are dotted keys of a trial.'
)


def settings_of(case: Settings) -> Settings:
    """The settings that a case changes: dotted keys of a trial and their values, without its name."""
    return {key: value for key, value in case.items() if key != NAME}


def named(cases: Mapping[str, Mapping[str, Any]]) -> list[Settings]:
    """Cases as a file has them, from the settings of each name."""
    return [{NAME: name, **settings} for name, settings in cases.items()]


def label(case: Settings, number: int) -> str:
    """A case in a message: its place in the file, and its name if it has one."""
    return f"cases[{number}]" + (f" ('{case[NAME]}')" if isinstance(case.get(NAME), str) else "")


def key_of_name(key: str, cases: Sequence[Settings]) -> str:
    """A key such as `cases[1].seed` with the case's name instead of its number, for cases that are given by name."""
    number, _, remainder = key.removeprefix("cases[").partition("]")
    below = remainder.removeprefix(".")
    return below if below == NAME else ": ".join(filter(None, (str(cases[int(number)][NAME]), below)))


def check_cases(cases: Sequence[Settings], axes: Mapping[str, Any]) -> None:
    """Check that every case has a name of its own, and none of the keys of an axis.

    Raises
    ------
    InputError
        With the key in the experiment.
    """
    known: dict[str, int] = {}
    for number, case in enumerate(cases):
        where = f"cases[{number}].{NAME}"
        if NAME not in case:
            raise InputError('is missing; give the case a name, such as name = "1280x960, 0.3 m"', key=where)
        name = case[NAME]
        if not isinstance(name, str):
            raise InputError(f"must be text; found {brief(name)}", key=where)
        if not (name.strip() == name and name.isprintable() and 0 < len(name) <= LONGEST):
            problem = f"must have 1 to {LONGEST} letters in one line, without space at its ends; found {name!r}"
            raise InputError(shortened(problem), key=where)
        if name in known:
            raise InputError(f"'{name}' is the name of cases[{known[name]}] too; give each its own", key=where)
        known[name] = number
        for key in settings_of(case):
            if key in axes:
                raise InputError("this key is also an axis; give it only once", key=f"cases[{number}].{key}")


def with_names(cases: Sequence[Settings]) -> list[Settings]:
    """The cases, nameless ones named after their settings, with a notice that the next version will refuse these."""
    complete: list[Settings] = []
    nameless: list[str] = []
    for number, case in enumerate(cases):
        if isinstance(case, Mapping) and case and NAME not in case:
            nameless.append(f"cases[{number}]")
            complete.append({NAME: _name_of(case, number, [each.get(NAME) for each in complete]), **case})
        else:
            complete.append(case)
    if nameless:
        text = f"{shortened(', '.join(nameless))}: without a name; the next version will ask for one, such as name = "
        warnings.warn(f'{text}"1280x960, 0.3 m"', Notice, stacklevel=2)
    return complete


def _name_of(case: Settings, number: int, taken: Sequence[Any]) -> str:
    text = ", ".join(f"{key.rpartition('.')[2]} {brief(value)}" for key, value in case.items())
    return text if len(text) <= LONGEST and text.isprintable() and text not in taken else f"case {number + 1}"


def keys_of(cases: Sequence[Settings]) -> tuple[str, ...]:
    """The keys of a trial that any of the cases sets."""
    return tuple(dict.fromkeys(key for case in cases for key in settings_of(case)))


def may_be_methods(cases: Sequence[Settings], axes: Mapping[str, Any]) -> bool:
    """Whether cases set nothing but the matcher, and which one among that."""
    keys = keys_of(cases)
    return (
        all(key.startswith("matching.") for key in keys)
        and not set(METHOD_KEYS).isdisjoint(keys)
        and set(METHOD_KEYS).isdisjoint(axes)
    )


def method_labels(
    cases: Sequence[Settings], axes: Mapping[str, Any], methods: Iterable[tuple[str, MethodName]]
) -> dict[MethodName, str]:
    """The names that cases give to methods; empty unless each case is a method of its own.

    Parameters
    ----------
    methods
        The case and the method of each trial.
    """
    if not may_be_methods(cases, axes):
        return {}
    pairs = dict.fromkeys(methods)
    labels = {method: case for case, method in pairs}
    return labels if len(labels) == len(pairs) == len({case for case, _ in pairs}) else {}


def without(coordinates: Settings, case_keys: Sequence[str], is_left_out: Callable[[str], bool]) -> Settings:
    """Coordinates without some keys. The case goes with them where it sets none but these.

    Parameters
    ----------
    case_keys
        The keys that a case stands for.
    """
    return {
        key: value
        for key, value in coordinates.items()
        if not (is_left_out(key) or (key == CASE and case_keys and all(map(is_left_out, case_keys))))
    }
