"""Compiled loops: the decorator that makes them, and the folder that keeps their machine code between runs.

numba's own cache looks at a function's file alone to tell whether its machine code is fresh. A loop that another file's
function was compiled into would be served stale after an edit there. Here machine code is kept in a folder named by the
contents of *all* files of compiled code, so loops may call each other across files: after any edit all is compiled
anew. Each compiled function is a file of its own, named by the types of its arguments and the kind of CPU, and checked
when it is read; any number of processes share the folder.

Compiled code is in files that match `SOURCES`; a file outside this package may use the decorator too, and is compiled
in every process.
"""

import hashlib
import os
import pickle
import platform
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numba
from numba.core import config
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.core.types import BaseTuple

from harness.errors import InputError, Notice
from harness.files import cache_folder, replace_file, user_cache_folder

SOURCES = ("*/_*kernels.py", "*/*/_*kernels.py", "camera/models/*.py")
"""Files of compiled code, below the package. What is compiled takes nothing from other files of the package, constants
included."""
VERSIONS_ON_DISK = 8
"""Folders kept of other states of the sources; those used least recently go first."""
LEAST_FREE_MB = 16
"""Least free disk space, megabytes: all machine code together needs less than half of it."""

_PACKAGE = Path(__file__).parent
_DIGEST = hashlib.sha256().digest_size
_HASH = re.compile(r"[0-9a-f]{32}")
_NO_CODE_CHANGED_BY = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_THREADING_LAYER", "NUMBA_DEBUG_CACHE")


def kernel(function: Any = None, *, inline: bool = False) -> Any:
    """A loop compiled by numba, without the interpreter's lock and with IEEE divisions; its machine code is kept.

    Parameters
    ----------
    inline
        Whether numba itself inlines it, before types are inferred. LLVM inlines small functions in any case.
    """
    if function is None:
        return lambda each: _compiled(each, "always" if inline else "never")
    return _compiled(function, "never")


def folder() -> Path | None:
    """The folder of the machine code of these sources; None if none can be written."""
    return _store().folder


def contents() -> tuple[Path | None, int, int]:
    """The folder of machine code, how many states of the sources it has, and its size in bytes."""
    current = folder()
    if current is None:
        return None, 0, 0
    parent = current.parent
    versions = _versions(parent)
    sizes = [path.stat().st_size for each in versions for path in each.glob("*") if path.is_file()]
    return parent, len(versions), sum(sizes)


def clear() -> None:
    """Remove the machine code of all states of the sources, and nothing else that may be in its folder."""
    parent = contents()[0]
    if parent is not None:
        for each in _versions(parent):
            shutil.rmtree(each, ignore_errors=True)


def _versions(parent: Path) -> list[Path]:
    """The folders of states of the sources, known by their names: the user may keep other things beside them."""
    if not parent.is_dir():
        return []
    return [each for each in parent.iterdir() if _HASH.fullmatch(each.name) and each.is_dir() and not each.is_symlink()]


# -- Where machine code is kept ----------------------------------------------------------------------------------------


class _Store:
    """A folder of machine code, for the sources as they were when this was made."""

    def __init__(self) -> None:
        self.hashes = {path: _sha(path.read_bytes()) for pattern in SOURCES for path in _PACKAGE.glob(pattern)}
        self.folder: Path | None = None
        self._is_announced = False
        reasons = {parent: _not_writable(parent / name) for parent in _parents() for name in [self._name()]}
        usable = [parent for parent, reason in reasons.items() if not reason]
        if not reasons:
            self.give_up("there is no home folder")
            return
        first, reason = next(iter(reasons.items()))
        self.folder = (usable[0] if usable else first) / self._name()
        if reason and usable:
            self.tell(f"compiled code is kept in {self.folder.parent}: {reason}")
        elif reason:
            self.tell(_again(reason))
        with suppress(OSError):
            os.utime(self.folder)  # for the order of removal

    def _name(self) -> str:
        parts = [f"{path.relative_to(_PACKAGE).as_posix()} {digest}" for path, digest in sorted(self.hashes.items())]
        parts += [_sha(Path(__file__).read_bytes()), numba.__version__, platform.python_version()]
        parts += [
            f"{name}={value}"
            for name, value in sorted(os.environ.items())
            if name.startswith("NUMBA_") and name not in _NO_CODE_CHANGED_BY
        ]
        return _sha("\n".join(parts).encode())[:32]

    def holds(self, source: Path) -> bool:
        """Whether a file is among the sources, and unchanged since they were hashed."""
        if source not in self.hashes:
            return False
        if self.folder is not None and self.hashes[source] != _sha(source.read_bytes()):
            self.give_up(f"{source} was edited while the program ran")
        return self.folder is not None

    def give_up(self, reason: str) -> None:
        """Stop writing and reading machine code."""
        self.folder = None
        self.tell(_again(reason))

    def tell(self, text: str) -> None:
        """Tell the user, once; workers leave it to the process that began them."""
        if not self._is_announced and "OMNIRANGE_WORKER" not in os.environ:
            warnings.warn(text, Notice, stacklevel=2)
        self._is_announced = True

    def read(self, name: str) -> bytes | None:
        """The contents written under this name; None if they are missing or damaged."""
        if self.folder is None:
            return None
        try:
            data = (self.folder / name).read_bytes()
        except OSError:
            return None
        content = data[_DIGEST:]
        return content if hashlib.sha256(content).digest() == data[:_DIGEST] else None

    def write(self, name: str, content: bytes) -> None:
        """Write contents under a name; if that fails, tell the user and continue."""
        if self.folder is None:
            return
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                _prune(self.folder)
            replace_file(self.folder / name, hashlib.sha256(content).digest() + content, durable=False)
        except OSError as error:
            self.tell(_again(error.strerror or str(error)))


@lru_cache(maxsize=1)
def _store() -> _Store:
    return _Store()


def _parents() -> list[Path]:
    """Folders that may keep machine code, the best first: numba's if one is set, the user's cache, the renders' cache.

    The user's cache comes before `OMNIRANGE_CACHE`, as it is small and the same for all caches of renders.
    """
    numbas = getattr(config, "CACHE_DIR", "")
    given = [Path(numbas) / "omnirange"] if numbas else []
    with suppress(InputError):  # reported by the render cache
        given += [folder / "kernels" for folder in (user_cache_folder(), cache_folder()) if folder]
    return given


def _again(reason: str) -> str:
    return f"compiled code cannot be kept, so every run compiles it again: {reason}"


def _not_writable(path: Path) -> str:
    """The reason why a folder, which may not exist yet, cannot be written to; empty if it can."""
    try:
        there = next(each for each in (path, *path.absolute().parents) if each.exists())
        if not there.is_dir():
            return f"{there} is no folder"
        if not os.access(there, os.W_OK | os.X_OK):
            return f"{there} cannot be written to"
        if shutil.disk_usage(there).free < LEAST_FREE_MB * 2**20:
            return f"less than {LEAST_FREE_MB} MB are free in {there}"
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    return ""


def _prune(newest: Path) -> None:
    """Remove the folders of other states of the sources except the latest; a process that uses one compiles again."""
    with suppress(OSError):
        others = [each for each in _versions(newest.parent) if each != newest]
        others.sort(key=lambda each: each.stat().st_mtime)
        for old in others[: -VERSIONS_ON_DISK or None]:
            shutil.rmtree(old, ignore_errors=True)


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


# -- How numba reads and writes it -------------------------------------------------------------------------------------


def _compiled(function: Callable[..., Any], inline: Literal["always", "never"]) -> Any:
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", inline=inline)(function)
    if hasattr(dispatcher, "enable_caching") and _store().holds(Path(function.__code__.co_filename)):
        dispatcher._cache = _Cache(function)  # noqa: SLF001 - as numba's own `enable_caching` does
    return dispatcher


class _Cache(NullCache):
    """The cache that a numba dispatcher asks for machine code before it compiles, and saves it to afterwards."""

    def __init__(self, function: Callable[..., Any]) -> None:
        module = function.__module__.rpartition("harness.")[2]
        self._name = f"{module}.{function.__qualname__}".replace("<locals>.", "")
        self._code = _sha(function.__code__.co_code)

    @property
    def cache_path(self) -> str | None:
        return str(_store().folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for these types of arguments; None if it is not stored."""
        target_context.refresh()
        if not _is_of_package(normalize_signature(sig)[0]):
            return None
        content = _store().read(self._file(sig, target_context.codegen()))
        return None if content is None else CompileResult._rebuild(target_context, *pickle.loads(content))  # noqa: S301, SLF001

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, unless it holds addresses of this process."""
        if (
            _store().folder is None
            or data.library.has_dynamic_globals
            or any(not each.can_cache for each in data.lifted)
        ):
            return
        _store().write(self._file(sig, data.codegen), dumps(data._reduce()))  # noqa: SLF001

    def _file(self, sig: Any, codegen: Any) -> str:
        parts = [repr(codegen.magic_tuple()), self._code, *_described(normalize_signature(sig)[0])]
        return f"{self._name}-{_sha(repr(parts).encode())[:32]}"


def _described(types: Any) -> Iterator[str]:
    """Texts that distinguish types: their names, and the fields' names of named tuples, anywhere in them."""
    for each in types:
        yield f"{each} {getattr(each, 'fields', '')}"
        yield from _described(each if isinstance(each, BaseTuple) else ())


def _is_of_package(types: Any) -> bool:
    """Whether no class among them is of another file than the sources, which may give it other functions."""
    for each in types:
        named = getattr(each, "instance_class", None)
        if named is not None:
            file = getattr(sys.modules.get(named.__module__), "__file__", None)
            if file is None or not _store().holds(Path(file)):
                return False
        if isinstance(each, BaseTuple) and not _is_of_package(each):
            return False
    return True
