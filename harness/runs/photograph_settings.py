"""The settings of a matcher from a command line that has no experiment."""

from collections.abc import Sequence

from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.matching.registry import Matcher
from harness.matching.window.settings import WindowMatcher
from harness.runs.overrides import read_values
from harness.spec import Spec, parse

DEFAULT_KIND = "slanted"


class OwnSettings(Spec):
    """The settings of an estimate from given images, sensor and poses."""

    matching: Matcher = WindowMatcher()
    """The matcher and its settings."""
    panorama: Grid = Grid()
    """The panorama on which ranges are estimated; where no key of it is given, the command takes one that suits the
    sensors."""


def own_settings(kind: str, sets: Sequence[str]) -> OwnSettings:
    """Read `--matcher` and `--set`.

    Raises
    ------
    InputError
        Names the option and the key, and what would be right.
    """
    table: dict[str, dict[str, object]] = {"matching": {"kind": kind or DEFAULT_KIND}}
    given = {("matching", "kind"): "--matcher"} if kind else {}
    for key, value in read_values("--set", sets).items():
        room, _, name = key.partition(".")
        if room in OwnSettings.model_fields and not name:
            raise InputError(f"is a table; write {room}.KEY=VALUE", file="--set", key=key)
        if room not in OwnSettings.model_fields:
            room, name = "matching", key
        if (room, name) in given:
            raise InputError(f"is given as {given[room, name]} too; leave one out", file="--set", key=key)
        given[room, name] = key
        target = table.setdefault(room, {})
        *above, last = name.split(".")
        for part in above:
            inside = target.setdefault(part, {})
            if not isinstance(inside, dict):
                raise InputError(f"there is no key '{last}' in a plain value", file="--set", key=key)
            target = inside
        target[last] = value
    try:
        return parse(OwnSettings, table)
    except InputError as error:
        room, _, name = (error.key or "").partition(".")
        option = given.get((room, name), "")
        if option == "--matcher":
            raise InputError(error.problem, file=option) from error
        raise InputError(
            error.problem, file="--set" if option else "--matcher, --set", key=option or error.key
        ) from error
