"""Shell completion of arguments."""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from harness import shipped

Completer = Callable[..., list[str]]
"""`completer(prefix, **_)`: the words that begin with the prefix."""


def offer(action: argparse.Action, *completers: Completer) -> None:
    """Let an argument be completed by the words of several completers."""

    def complete(prefix: str, **_: Any) -> list[str]:
        return [word for completer in completers for word in completer(prefix)]

    action.completer = complete  # type: ignore[attr-defined] # where argcomplete looks


def experiments(prefix: str, **_: Any) -> list[str]:
    """Shipped experiments."""
    return _beginning(prefix, shipped.names("experiments"))


def scenes(prefix: str, **_: Any) -> list[str]:
    """Shipped scenes."""
    return _beginning(prefix, shipped.names("scenes"))


def sensors(prefix: str, **_: Any) -> list[str]:
    """Shipped sensors."""
    return _beginning(prefix, shipped.names("sensors"))


def datasets(prefix: str, **_: Any) -> list[str]:
    """Shipped data sets."""
    return _beginning(prefix, shipped.names("datasets"))


def files(*endings: str) -> Completer:
    """A completer of files with some endings (all files by default) and of folders, which end in a slash."""

    def complete(prefix: str, **_: Any) -> list[str]:
        stem, slash, _name = prefix.rpartition("/")
        folder = Path(f"{stem}{slash}" or ".").expanduser()
        names = []
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            word = f"{stem}{slash}{path.name}"
            if path.is_dir():
                names.append(f"{word}/")
            elif not endings or path.suffix in endings:
                names.append(word)
        return _beginning(prefix, names)

    return complete


def folders(prefix: str, **_: Any) -> list[str]:
    """Folders."""
    return [word for word in files()(prefix) if word.endswith("/")]


def kinds(prefix: str, **_: Any) -> list[str]:
    """The kinds of matcher, including those of installed packages."""
    from harness.matching.plugins import entry_points
    from harness.matching.registry import BUILT_IN

    return _beginning(prefix, [*BUILT_IN, *entry_points()])


def keys(prefix: str, **_: Any) -> list[str]:
    """The keys of a trial."""
    from harness.runs.settings_reference import settings_reference

    return _beginning(prefix, dict.fromkeys(each.key for each in settings_reference()))


def changes(prefix: str, **_: Any) -> list[str]:
    """`KEY=` for every key of a trial; after `matching.kind=` the kinds of matcher, one or several."""
    key, equals, value = prefix.partition("=")
    if not equals:
        return [f"{each}=" for each in keys(prefix)]
    if key != "matching.kind":
        return []
    before, comma, last = value.rpartition(",")
    return [f"{key}={before}{comma}{kind}" for kind in kinds(last)]


def _beginning(prefix: str, words: Iterable[str]) -> list[str]:
    return [word for word in words if word.startswith(prefix)]
