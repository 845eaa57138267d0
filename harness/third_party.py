"""Third-party modules, identified by their source: all files of theirs that a result may depend on."""

import hashlib
import importlib
import importlib.metadata
import sys
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from pathlib import Path

from harness.errors import InputError
from harness.source_files import State, hash_of, imports, package_files, script_files, state_of


@dataclass(frozen=True)
class _Source:
    """The files that a module consists of."""

    digest: str
    """SHA-256 over the names and contents of all files that count, and the versions of libraries."""
    code: str
    """SHA-256 like `digest`, but without data files: of the code that a process has loaded."""
    states: Mapping[Path, State]
    """States of all files, and of the folders of packages."""

    @property
    def is_current(self) -> bool:
        """Whether nothing has changed since."""
        try:
            return all(state is not None and state_of(path) == state for path, state in self.states.items())
        except InputError:
            return False


_known: dict[str, _Source] = {}
_loaded: dict[str, tuple[ModuleSpec | None, str]] = {}
"""The spec of each module that was loaded, and the hash of the code that it was made of."""


def source_of(module: str, name: str) -> str:
    """SHA-256 of a module's source; of all of its package if it is in one, data too, and of what they import.

    Installed libraries count by their version, anything else by its files. Nothing is imported.

    Parameters
    ----------
    name
        Its name in messages.

    Raises
    ------
    InputError
        When there is no such module, or its source has changed since this process has loaded it.
    """
    if not (module in _known and _known[module].is_current):
        _known[module] = _read(module, name)
    source = _known[module]
    loaded = sys.modules.get(module)
    if loaded is not None:
        spec, code = _loaded.setdefault(module, (loaded.__spec__, source.code))
        if loaded.__spec__ is not spec:  # loaded anew
            _loaded[module] = loaded.__spec__, source.code
        elif code != source.code:
            raise InputError("has been changed since it was loaded; start the session again", file=name)
    return source.digest


def is_known(module: str) -> bool:
    """Whether it is known which files a module was made of when it was loaded."""
    return module in _loaded


def look_here() -> str:
    """Let modules be found in the current folder; worker processes inherit the path."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: a user's file never hides a library
    return here


def absent(module: str, name: str) -> InputError:
    """The complaint that there is no such module; `name` is what asked for it."""
    if module.endswith(".py"):
        return InputError(f"a module is named without .py: {name.replace('.py:', ':', 1)}", file=name)
    return InputError(f"there is no module {module}, neither installed nor in {Path.cwd()}", file=name)


def identity_of(thing: type) -> str:
    """SHA-256 of the source that a third-party class depends on: `source_of` its module.

    For a class of the script that is run: the script, and what it imports from its own folder. For one that was typed
    in: a word that is another one in every process, so that nothing made by it is ever taken for another's.

    Raises
    ------
    InputError
        As of `source_of`.
    """
    module = thing.__module__
    if module != "__main__":
        return source_of(module, f"{module}.{thing.__qualname__}")
    script = getattr(sys.modules["__main__"], "__file__", None)
    if script is None or not Path(script).is_file():
        return _ONCE
    files = [Path(script), *script_files(Path(script))]
    return _hash([f"{file.relative_to(Path(script).parent).as_posix()} {hash_of(file)}" for file in files])


_ONCE = uuid.uuid4().hex


def _read(name: str, called: str) -> _Source:
    look_here()
    importlib.invalidate_caches()
    if _spec(name) is None:
        raise absent(name, called)
    package = name.partition(".")[0]
    code: list[str] = []
    data: list[str] = []
    states: dict[Path, State] = {}
    visited, waiting = {package, __name__.partition(".")[0]} | sys.stdlib_module_names, [package]
    while waiting:
        module = waiting.pop()
        folder, files = _files(_spec(module))
        if module != package and {"site-packages", "dist-packages"} & set(folder.parts):
            code.append(f"{module} {_version(module)}")
            continue
        states |= {path: state_of(path) for file in files for path in (file, file.parent)}
        for file in files:
            is_code = file.name.endswith((".py", *EXTENSION_SUFFIXES))
            (code if is_code else data).append(f"{file.relative_to(folder).as_posix()} {hash_of(file)}")
            imported = imports(file) - visited if file.suffix == ".py" else frozenset()
            visited |= imported
            waiting.extend(imported)
    return _Source(_hash(code + data), _hash(code), states)


def _hash(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()


def _spec(name: str) -> ModuleSpec | None:
    """The spec from which a module would be loaded; unlike `importlib.util.find_spec` it imports no parent package."""
    path = None
    spec = None
    parts = name.split(".")
    for i in range(len(parts)):
        full = ".".join(parts[: i + 1])
        if i and path is None:
            return None
        specs = (finder.find_spec(full, path) for finder in sys.meta_path if hasattr(finder, "find_spec"))
        spec = next((each for each in specs if each is not None), None)
        if spec is None:
            return None
        path = spec.submodule_search_locations
    return spec


def _files(spec: ModuleSpec | None) -> tuple[Path, list[Path]]:
    """The folder that a top module lies in, and its files: a package's are all below it."""
    if spec is not None and spec.submodule_search_locations:
        package = Path(next(iter(spec.submodule_search_locations)))
        return package.parent, package_files(package)
    if spec is not None and spec.origin and spec.has_location:
        return Path(spec.origin).parent, [Path(spec.origin)]
    return Path(), []


def _version(module: str) -> str:
    """The version of the package that brought an installed module."""
    try:
        return importlib.metadata.version(module)
    except importlib.metadata.PackageNotFoundError:
        return " ".join(
            f"{name} {importlib.metadata.version(name)}" for name in sorted(set(_distributions().get(module, [])))
        )


@lru_cache(maxsize=1)
def _distributions() -> Mapping[str, list[str]]:
    return importlib.metadata.packages_distributions()
