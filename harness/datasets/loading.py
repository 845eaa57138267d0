"""Read a data set's specification: a shipped one by its name, a TOML file, or a table."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness import shipped
from harness.datasets.specification import DatasetSpec
from harness.errors import InputError
from harness.runs.dotted import changed
from harness.runs.overrides import read_values
from harness.spec import parse
from harness.toml import read_toml


def load_spec(source: str | Path | Mapping[str, Any] | DatasetSpec, sets: Sequence[str] = ()) -> DatasetSpec:
    """Read a specification.

    Parameters
    ----------
    sets
        `key=value`: changed keys, such as `rig.width_px=320`.

    Raises
    ------
    InputError
        Names the file or the option, the key and what would be right.
    """
    if isinstance(source, DatasetSpec):
        return source
    if isinstance(source, Mapping):
        file, table = None, dict(source)
    else:
        file = shipped.find("datasets", str(source))
        table = read_toml(file)
    settings = read_values("--set", sets)
    if not settings:
        return parse(DatasetSpec, table, file=file)
    try:
        return parse(DatasetSpec, changed(table, settings, file="--set"), file=file)
    except InputError as error:
        if error.key in settings:
            raise InputError(error.problem, file="--set", key=error.key) from error
        raise
