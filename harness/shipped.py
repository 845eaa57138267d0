"""The folders of the scenes, sensors, experiments and data sets that come with the program."""

import difflib
from pathlib import Path
from typing import Literal

from harness.errors import InputError
from harness.files import path_of
from harness.toml import read_toml

Kind = Literal["scenes", "sensors", "experiments", "datasets"]

_PACKAGE = Path(__file__).parent


def folder(kind: Kind) -> Path:
    """The folder of the shipped files of a kind: inside an installed package, beside it in a checkout."""
    installed = _PACKAGE / "_shipped" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def names(kind: Kind) -> list[str]:
    """The names that can be given instead of a path, in alphabetical order."""
    return sorted(path.stem for path in folder(kind).glob("*.toml"))


def find(kind: Kind, name_or_path: str, *, relative_to: Path | None = None) -> Path:
    """The TOML file that a name or a path means.

    A word without a slash or an ending is a shipped name; anything else is a path, relative to
    `relative_to` (the folder of the file that names it) or to the working directory.

    Raises
    ------
    InputError
        When there is no such file (the message says what may have been meant), or there can be none of this name.
    """
    if "/" not in name_or_path and "\\" not in name_or_path and not name_or_path.endswith(".toml"):
        path = path_of(f"{name_or_path}.toml", folder(kind))
    else:
        path = path_of(name_or_path, relative_to or Path())
    if not path.is_file():
        raise InputError(f"no such {kind[:-1]}; {_hint(kind, name_or_path)}", file=name_or_path)
    return path


def or_shipped(kind: Kind, path: Path) -> Path:
    """The shipped file that a bare name means, if there is no file of that name; else the path as it is.

    For what may also be a file of another program, with any ending or none.
    """
    return folder(kind) / f"{path}.toml" if str(path) in names(kind) and not path.exists() else path


def _hint(kind: Kind, name: str) -> str:
    """A hint at what was meant by a name or path that does not exist."""
    if name in names("scenes" if kind == "experiments" else "experiments"):
        if kind == "experiments":
            return f"it is a scene: see `omnirange render`, or give `--set scene={name}` with an experiment"
        return f"it is an experiment: `omnirange run {name}`"
    advice = f"give the path of a TOML file or one of the shipped names: {', '.join(names(kind))}"
    close = difflib.get_close_matches(name, names(kind), n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'? Otherwise {advice}" if close else advice


def descriptions(kind: Kind) -> dict[str, str]:
    """A one-line description of each shipped file, by its name: its `description`, or a sensor's first comment."""
    files = {name: folder(kind) / f"{name}.toml" for name in names(kind)}
    if kind == "sensors":
        return {name: file.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ") for name, file in files.items()}
    return {name: str(read_toml(file).get("description", "")) for name, file in files.items()}
