"""Files read within limits, and written whole or not at all."""

import os
import stat
from pathlib import Path

from harness.errors import InputError


def read_regular(path: str | Path, limit_bytes: int, what: str = "file") -> bytes:
    """The contents of a regular file. A pipe, a device or a folder is refused before it is opened.

    Parameters
    ----------
    limit_bytes
        The largest size that is read.
    what
        What the file should be, for messages: `scene`, `image`, `mesh`.

    Raises
    ------
    InputError
        When there is no such file, it cannot be read, is not a regular file, or is larger than the limit.
    """
    try:
        if not stat.S_ISREG(Path(path).stat().st_mode):
            raise InputError(f"is not a regular file; give a {what} file", file=path)
        # A pipe that has taken the file's place since must not be waited for.
        with open(path, "rb", opener=_open_at_once) as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"is not a regular file; give a {what} file", file=path)
            # The size may be unknown (/proc) or have grown: what is read counts, and no more than the limit is.
            data = stream.read(limit_bytes + 1) if status.st_size <= limit_bytes else None
    except FileNotFoundError:
        raise InputError(f"no such {what}", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=_printable(path)) from error
    except ValueError as error:  # a null byte or a lone surrogate
        raise InputError("is not a file name", file=_printable(path)) from error
    if data is None or len(data) > limit_bytes:
        raise InputError(f"is larger than the {limit_bytes / 2**20:g} MiB that are read of a {what}", file=path)
    return data


def _open_at_once(name: str, flags: int) -> int:
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def _printable(path: str | Path) -> str:
    """A name without what no terminal shows, and not longer than a line."""
    text = ascii(str(path))[1:-1] if not str(path).isprintable() else str(path)
    return text if len(text) <= 200 else f"{text[:100]} ... {text[-50:]}"


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
