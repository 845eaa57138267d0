"""The files that a third-party matcher consists of, and their contents, as far as can be found without running it."""

import ast
import hashlib
import time
from collections.abc import Iterable, Iterator
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from harness.errors import InputError

State = tuple[int, int, int, int] | None
"""Size, inode and times of a file: equal ones mean that it has not been written to. None for one that has just been."""

_JUST_NOW_NS = 2_000_000_000
"""A file that was changed within this time may change again without another time: clocks of file systems are coarse."""


def state_of(path: Path) -> State:
    """The state of a file or folder, by which a later change is detected.

    Raises
    ------
    InputError
        When it is not there.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    is_old = time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _JUST_NOW_NS
    return (status.st_size, status.st_ino, status.st_mtime_ns, status.st_ctime_ns) if is_old else None


def hash_of(path: Path) -> str:
    """SHA-256 of a file, read again when it has changed.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    state = state_of(path)
    try:
        return _hash_of.__wrapped__(path, state) if state is None else _hash_of(path, state)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error


@lru_cache(maxsize=4096)
def _hash_of(path: Path, _state: State) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def named_files(parameters: Iterable[tuple[str, object]]) -> list[tuple[str, Path]]:
    """The parameters that name a file: those called `file`, or with a name that ends in `_file`."""
    return [
        (name, Path(value))
        for name, value in sorted(parameters)
        if isinstance(value, str) and (name == "file" or name.endswith("_file"))
    ]


def is_python(path: Path) -> bool:
    """Whether a file is a Python script: by its ending, or by its first line."""
    if path.suffix:
        return path.suffix in {".py", ".pyw"}
    with path.open("rb") as stream:
        first = stream.read(80).partition(b"\n")[0]
    return first.startswith(b"#!") and b"python" in first


def script_files(script: Path) -> list[Path]:
    """The files that a Python script imports from its own folder, directly or not: modules, and whole packages."""
    files, waiting = {script}, [script]
    while waiting:
        for name in imports(waiting.pop()):
            new = set(_module_files(script.parent, name)) - files
            files |= new
            waiting += [each for each in new if each.suffix == ".py"]
    return sorted(files - {script})


def package_files(package: Path) -> list[Path]:
    """All files of a package: source, compiled modules and data, except caches and hidden files."""
    return sorted(path for path in package.rglob("*") if path.is_file() and not _is_left_out(path.relative_to(package)))


def _is_left_out(path: Path) -> bool:
    return any(part == "__pycache__" or part.startswith(".") for part in path.parts)


def _module_files(folder: Path, module: str) -> list[Path]:
    """The files of a top module that lies in a folder; none if it does not."""
    if (folder / module).is_dir():
        return package_files(folder / module)
    return [path for end in (".py", *EXTENSION_SUFFIXES) if (path := folder / f"{module}{end}").is_file()]


def imports(file: Path) -> frozenset[str]:
    """The top modules that a source file imports anywhere; none when it is not valid Python."""
    return _imports(hash_of(file), file)


@lru_cache(maxsize=4096)
def _imports(_hash: str, file: Path) -> frozenset[str]:
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return frozenset()
    return frozenset(name.partition(".")[0] for node in ast.walk(tree) for name in _imported(node))


def _imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (each.name for each in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        yield node.module
