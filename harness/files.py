"""Files written whole or not at all."""

import os
from pathlib import Path

from harness.errors import InputError


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises
    ------
    InputError
        When it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be used as the output folder ({error.strerror})", file=folder, key="--out") from error
    if not os.access(folder, os.W_OK):
        raise InputError("the output folder cannot be written to", file=folder, key="--out")


def write(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all: a reader never sees half of it.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(f"cannot be written ({error.strerror})", file=path) from error
