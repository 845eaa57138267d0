"""Files read within limits, and written whole or not at all."""

import os
import re
import secrets
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from harness.errors import InputError, with_article

PARTIAL = ".partial"
"""Suffix of the name of a file while it is written; the part before it is random."""
LEFTOVER = re.compile(rf"\.[0-9a-f]{{32}}{re.escape(PARTIAL)}")
"""The names that `replace_file` gives to files that it has not finished."""

_START_BYTES = 16
"""What is read of a file that is too large, to say what it is."""
_IMAGES = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG", b"II*\0": "TIFF", b"MM\0*": "TIFF"}
"""How files of images begin."""

PAGE_MARK = (
    b'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta name="generator" content="omnirange'
)
"""How the pages begin that this program writes."""
PICTURE_MARK = b"tEXtSoftware\0omnirange"
"""What is near the beginning of PNG files that this program writes where somebody else's may be; see
`harness.images.png_note`."""
_MARKED_BYTES = 4096
"""How much of a file is read to find our mark."""

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


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
            raise _not_regular(path, what)
        # Do not block on a pipe that has replaced the file since.
        with open(path, "rb", opener=_open_at_once) as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise _not_regular(path, what)
            # The size may be unknown (/proc) or have grown: the bytes read are checked against the limit.
            data = stream.read(limit_bytes + 1 if status.st_size <= limit_bytes else _START_BYTES)
    except FileNotFoundError:
        raise InputError("no such file", file=printable(path)) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=printable(path)) from error
    except ValueError as error:  # a null byte or a lone surrogate
        raise InputError("is not a file name", file=printable(path)) from error
    if status.st_size > limit_bytes or len(data) > limit_bytes:
        if what in {"sensor", "pose", "corner"} and _image_kind(data):
            raise InputError(not_text(data), file=path)
        raise InputError(f"is larger than the {limit_bytes / 2**20:g} MiB that are read of a {what}", file=path)
    return data


def not_text(data: bytes, wanted: str = "text file") -> str:
    """What is said of a file that is no text: what it is, if it is an image, as images and other files are mixed up."""
    if kind := _image_kind(data):
        return f"is {with_article(kind)} image; a {wanted} is read here"
    try:
        data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return f"is no {wanted} in UTF-8: byte {data[error.start]:#04x} in line {line}"
    return f"is no {wanted}: it has null bytes"


def _image_kind(data: bytes) -> str | None:
    return next((kind for start, kind in _IMAGES.items() if data.startswith(start)), None)


def _not_regular(path: str | Path, what: str) -> InputError:
    article = "an" if what[0] in "aeiou" else "a"
    advice = "" if what == "file" else f"; give {article} {what} file"
    return InputError(f"is not a regular file{advice}", file=path)


def _open_at_once(name: str, flags: int) -> int:
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def printable(path: str | Path) -> str:
    """A name without unprintable characters, and not longer than a line."""
    text = ascii(str(path))[1:-1] if not str(path).isprintable() else str(path)
    return text if len(text) <= 200 else f"{text[:100]} ... {text[-50:]}"


def cache_folder() -> Path | None:
    """`$OMNIRANGE_CACHE`, or `user_cache_folder`.

    Raises
    ------
    InputError
        When `OMNIRANGE_CACHE` names no folder.
    """
    path = os.environ.get("OMNIRANGE_CACHE")
    if not path:
        return user_cache_folder()
    return path_of(path, key="OMNIRANGE_CACHE")


def user_cache_folder() -> Path | None:
    """`omnirange` in the user's cache folder; None for a user who has no home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omnirange"
    except RuntimeError:  # neither HOME nor an entry for this user
        return None


def make_folder(folder: Path, option: str = "--out") -> None:
    """Make a folder and those above it.

    Raises
    ------
    InputError
        When it cannot be made or written to; names the option that gave it.
    """
    check_folder(folder, option)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be used as the output folder ({error.strerror})"
        raise InputError(problem, file=folder, key=option) from error


def check_folder(folder: Path, option: str | None = "--out") -> None:
    """Refuse, without making it, a folder that `make_folder` could not make or that could not be written to.

    Raises
    ------
    InputError
        Names the option that gave it.
    """
    try:
        there = next((each for each in (folder, *folder.absolute().parents) if os.path.lexists(each)), folder)
        problem = "" if there.is_dir() else "it" if there == folder else printable(there)
        if problem:
            problem += " is a link that leads nowhere" if there.is_symlink() and not there.exists() else " is no folder"
        elif not os.access(there, os.W_OK | os.X_OK):
            problem = f"{'it' if there == folder else printable(there)} cannot be written to"
    except (OSError, ValueError) as error:  # the second is Python's for a null byte
        problem = str(getattr(error, "strerror", None) or error)
    if problem:
        raise InputError(f"cannot be used as the output folder ({problem})", file=folder, key=option)


def make_folder_of(path: Path | None, option: str = "--out") -> None:
    """Make the folder of a file that is to be written, before the work that it is for.

    Raises
    ------
    InputError
        When it cannot be made or written to, or the file's name is that of a folder; names the option that gave it.
    """
    if path is None:
        return
    make_folder(path.parent, option)
    if path.is_dir():
        raise InputError("is a folder; give the name of a file", file=path, key=option)
    check_unprotected([path], option)


def check_unprotected(files: Iterable[Path], option: str | None = "--out") -> None:
    """Refuse to write over files that are write-protected.

    Raises
    ------
    InputError
        Names one of them, and the option that gave it.
    """
    for path in filter(_is_protected, files):
        raise InputError("is write-protected; give another place, or allow writing", file=path, key=option)


def _is_protected(path: Path) -> bool:
    """Whether a file is there that its owner lets nobody change. A rename would replace it all the same."""
    return path.is_file() and not path.is_symlink() and not os.access(path, os.W_OK)


def check_replaces_none(written: Iterable[Path | None], read: Iterable[Path | None], option: str = "--out") -> None:
    """Refuse to write over a file that is read.

    Parameters
    ----------
    written, read
        Files, there or not; None is none.

    Raises
    ------
    InputError
        Names the file, the option that gave it, and that another name would be right.
    """
    there = [each for each in read if each is not None and each.exists()]
    for file in written:
        if file is not None and any(is_same(file, each) for each in there):
            raise InputError("would be written over, and is read; give another name", file=file, key=option)


def is_same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file, there or not."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return one.resolve() == other.resolve()


@dataclass(frozen=True)
class OwnFiles:
    """The files that a command writes into a folder, and how those show that it has written them.

    Other commands, other programs and people have files of the same names: a name alone shows nothing.
    """

    what: str
    """What they are together: `range of two images`."""
    marks: Mapping[str, bytes | None]
    """By name, how each begins, or how its first line ends if the mark ends with a newline (the first columns of a
    table may vary); None for a file that does not say whose it is, such as an array, which is ours where another file
    beside it is."""
    also: Mapping[str, bytes] = field(default_factory=dict)
    """By name, what is somewhere near the beginning of files and shows that the folder is ours; they may be ours
    without it, since earlier versions did not write it."""

    def are_in(self, folder: Path) -> bool:
        """Whether a file in a folder shows that this command has written there."""
        if any(_is_ours(folder / name, mark) for name, mark in self.marks.items()):
            return True
        return any(mark in (_start_of(folder / name) or b"") for name, mark in self.also.items())


def check_empty_or_own(folder: Path, own: OwnFiles) -> None:
    """Refuse to write among other people's files.

    Parameters
    ----------
    own
        The marks of files that each show that a folder is ours.

    Raises
    ------
    InputError
        When the folder has files and is none of ours.
    """
    if folder.is_dir() and any(folder.iterdir()) and not own.are_in(folder):
        problem = f"holds files, and nothing shows that they are from an earlier {own.what}"
        raise InputError(f"{problem}; give an empty folder, or a new one", file=folder, key="--out")


def check_no_others(
    folder: Path,
    own: OwnFiles,
    *,
    option: str | None = "--out",
    advice: str = "give another folder",
) -> None:
    """Refuse to write over files that have the names of ours, and are not.

    One of ours that was cut short, or emptied, is ours.

    Parameters
    ----------
    option
        The option that gave the folder, for messages.
    advice
        What would be right, for messages.

    Raises
    ------
    InputError
        Names one of the files.
    """
    paths = {name: folder / name for name in own.marks}
    check_unprotected(paths.values(), option)
    ours = {name: _is_ours(path, own.marks[name]) for name, path in paths.items() if os.path.lexists(path)}
    is_known = own.are_in(folder)
    for name, is_ours in ours.items():
        if is_ours is False or (is_ours is None and not is_known and not _is_empty(paths[name])):
            problem = f"is there already, and nothing shows that it is from an earlier {own.what}; {advice}"
            raise InputError(problem, file=paths[name], key=option)


def is_marked(path: Path, mark: bytes) -> bool:
    """Whether a file has our mark, as in `OwnFiles.marks`; one of ours that was cut short, or emptied, counts."""
    return _is_ours(path, mark) is not False


def _is_ours(path: Path, mark: bytes | None) -> bool | None:
    """Whether a file is ours by how it begins; None if it does not say."""
    if not path.is_file():  # a folder, a device, a link to nothing
        return False
    if mark is None or (start := _start_of(path)) is None:
        return None
    if start.startswith(mark) or (mark.endswith(b"\n") and start[: start.find(b"\n") + 1].endswith(mark)):
        return True
    return None if mark.startswith(start) else False


def _start_of(path: Path) -> bytes | None:
    """The first bytes of a file; None if there is none, or it cannot be read."""
    try:
        if not path.is_file():  # a pipe would have us wait
            return None
        with path.open("rb") as stream:
            return stream.read(_MARKED_BYTES)
    except OSError:
        return None


def _is_empty(path: Path) -> bool:
    return path.is_file() and not path.stat().st_size


def write(path: Path, content: str | bytes) -> None:
    """Write a file as `replace_file` does. Text becomes UTF-8; invalid characters are written as escapes.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    try:
        replace_file(path, encoded(content) if isinstance(content, str) else content)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be written ({getattr(error, 'strerror', None) or error})", file=path) from error


def encoded(text: str) -> bytes:
    """A text as `write` writes it."""
    return text.encode(errors="backslashreplace")


def replace_file(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write a file whole or not at all: a reader never sees half of it, and nothing half-written is left behind.

    It is written under a random name in the same folder, and renamed. So no link is followed: a link at `path` is
    replaced, and its target stays unchanged.

    Parameters
    ----------
    durable
        Whether the file is on the disk, rather than on its way there, when this returns. A file that is checked when it
        is read has no need of that.

    Raises
    ------
    OSError
        When it cannot be written, is write-protected, or is a device, a pipe or a folder.
    """
    with suppress(FileNotFoundError):
        kind = path.lstat().st_mode
        if not stat.S_ISREG(kind) and not stat.S_ISLNK(kind):
            raise OSError(0, "it is there already and is not a regular file")
    if _is_protected(path):
        raise OSError(0, "it is write-protected")
    partial = path.with_name(f".{secrets.token_hex(16)}{PARTIAL}")
    try:
        with os.fdopen(os.open(partial, _NEW, 0o666), "wb") as stream:
            stream.write(data)
            stream.flush()
            if durable:
                os.fsync(stream.fileno())
        partial.replace(path)
    except BaseException:  # Ctrl-C too leaves nothing behind
        with suppress(OSError):
            partial.unlink()
        raise
    if durable:
        _sync_folder(path.parent)


def clear_leftovers(folder: Path) -> None:
    """Remove what `replace_file` left half-written in a folder because the process was ended at once.

    For a folder that no other process writes to.
    """
    for path in folder.glob(f".*{PARTIAL}"):
        if LEFTOVER.fullmatch(path.name):
            with suppress(OSError):
                path.unlink()


def _sync_folder(folder: Path) -> None:
    """Bring a rename onto the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def path_of(text: str, folder: Path = Path(), *, file: str | Path | None = None, key: str | None = None) -> Path:
    """The path that a text names, `~` filled in, relative to a folder; whether anything is there is not asked.

    Parameters
    ----------
    file, key
        Where the text stands, for messages; without them the message begins with the text itself.

    Raises
    ------
    InputError
        When no file can have this name: a user that is not there, a null byte, too many letters, links in a circle.
    """
    try:
        text.encode()
        path = folder / Path(text).expanduser()
        path.stat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return path
    except RuntimeError:
        problem = f"there is no user {Path(text).parts[0].removeprefix('~')}, or no home folder"
    except ValueError:
        problem = "is not a file name: it has a null byte, or is no Unicode"
    except OSError as error:
        problem = f"cannot be used as a file name ({error.strerror})"
    else:
        return path
    if file is None and key is None:
        raise InputError(problem, file=printable(text))
    raise InputError(f"'{printable(text)}': {problem}", file=file, key=key)
