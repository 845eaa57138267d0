"""Third-party functions: found by name, checked for their parameters, and identified by their source.

A name is `package.module:function`, or a name from the entry point group `omnirange.matchers`.
"""

import hashlib
import importlib
import importlib.metadata
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from pathlib import Path
from typing import Any

from harness import interrupts
from harness.errors import InputError, described, nearest
from harness.matching.source_files import State, hash_of, imports, named_files, package_files, state_of

ENTRY_POINTS = "omnirange.matchers"


@lru_cache(maxsize=1)
def entry_points() -> Mapping[str, importlib.metadata.EntryPoint]:
    """Entry points of installed packages, by name."""
    return {each.name: each for each in importlib.metadata.entry_points(group=ENTRY_POINTS)}


def find(kind: str) -> Callable[..., Any]:
    """The function of this name; modules are also looked for in the current folder.

    Raises
    ------
    InputError
        When there is no such module or function. `error.file` is the name.
    """
    module_name, attributes = _address(kind)
    target = module = _module(module_name, kind)
    if module_name not in _loaded:  # from now on, its files are known to be those that it was made of
        _source(kind)
    for name in attributes.split("."):
        if not hasattr(target, name):
            there = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
            where = getattr(module, "__file__", None) or "built in"
            raise InputError(f"the module {module_name} ({where}) has no '{name}'; {nearest(name, there)}", file=kind)
        target = getattr(target, name)
    if not callable(target):
        raise InputError(f"is a {type(target).__name__}, not a function", file=kind)
    function: Callable[..., Any] = target
    return function


def check(kind: str, parameters: Mapping[str, Any]) -> None:
    """Check that a function can be called as `function(pair, limits, **parameters)`.

    Raises
    ------
    InputError
        When it cannot be found, or does not take these. `error.key` is `kind`, `parameters` or one of them.
    """
    try:
        function = find(kind)
    except InputError as error:
        raise InputError(f"{kind}: {error.problem}", key="kind") from error
    try:
        taken = _taken(function)
    except TypeError:
        raise InputError(f"{kind} must take (pair, limits, **parameters)", key="kind") from None
    if taken is None:
        return
    known, anything = taken
    for name in parameters:
        if name not in known and not anything:
            raise InputError(
                f"{kind} takes no parameter '{name}'; {nearest(name, list(known))}", key=f"parameters.{name}"
            )
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in parameters:
            raise InputError(f"{kind} needs the parameter '{name}'", key="parameters")
    for name, file in named_files(parameters.items()):
        if not file.is_file():
            raise InputError(f"no such file: {file}", key=f"parameters.{name}")


def takes(kind: str, name: str) -> bool:
    """Whether a function has a parameter of this name; true if that cannot be told."""
    try:
        taken = _taken(find(kind))
    except (InputError, TypeError):
        return True
    return taken is None or name in taken[0] or taken[1]


def digest(kind: str, parameters: Mapping[str, Any]) -> str:
    """SHA-256 of what name and parameters do not determine: the function's source, and the files in parameters.

    A function counts with its module; a module in a package with all files of the package, data too. What they import
    counts likewise: installed libraries by their version, anything else by its files. Nothing is imported.

    Raises
    ------
    InputError
        When there is no such module or file, or its source has changed since this process has loaded it.
    """
    files = [f"{name} {hash_of(file)}" for name, file in named_files(parameters.items())]
    return hashlib.sha256("\n".join([_source(kind), *files]).encode()).hexdigest()


def _address(kind: str) -> tuple[str, str]:
    """(module, function)."""
    value = entry_points()[kind].value if kind in entry_points() else kind
    module, _, function = value.partition("[")[0].partition(":")
    return module.strip(), function.strip()


def _taken(function: Callable[..., Any]) -> tuple[dict[str, inspect.Parameter], bool] | None:
    """The parameters after the pair and the limits, and whether there may be any others; None when it does not say.

    Raises
    ------
    TypeError
        When it does not take two arguments.
    """
    try:
        signature = inspect.signature(function)
    except ValueError:
        return None
    first_two = signature.bind_partial(None, None).arguments
    later = {name: each for name, each in signature.parameters.items() if name not in first_two}
    known = {name: each for name, each in later.items() if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY)}
    return known, any(each.kind == each.VAR_KEYWORD for each in later.values())


# --- What is run --------------------------------------------------------------------------------------------------


class _Exit(BaseException):
    """Third-party code tried to end the process."""


@contextmanager
def contained() -> Iterator[None]:
    """Run third-party code: the working folder is restored, and `os._exit` ends only that code.

    A run that ended there would leave no trace of the trial, and might even look successful.
    """
    process, end = os.getpid(), os._exit
    try:
        folder: Path | None = Path.cwd()
    except OSError:  # it has been removed
        folder = None

    def raise_instead(status: int) -> None:
        if os.getpid() != process:  # a process that it has forked itself
            end(status)
        raise _Exit(f"os._exit({status}) was called")

    os._exit = raise_instead  # type: ignore[assignment]
    try:
        yield
    finally:
        os._exit = end
        if folder is not None:
            with suppress(OSError):
                os.chdir(folder)


# --- Modules ------------------------------------------------------------------------------------------------------


def _look_here() -> str:
    """Let modules be found in the current folder; worker processes inherit the path."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: a user's file never hides a library
    return here


def _module(name: str, kind: str) -> Any:
    here = _look_here()
    if name == "__main__":
        raise InputError("must be in an importable module, so that workers can load it", file=kind)
    try:
        with contained():
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise _absent(name, kind) from error
        raise InputError(f"the module {name} needs {error.name}, which is not installed", file=kind) from error
    except BaseException as error:
        if interrupts.is_real(error):
            raise
        raise InputError(f"the module {name} fails: {described(error)} (in {here})", file=kind) from error


def _absent(name: str, kind: str) -> InputError:
    return InputError(f"there is no module {name}, neither installed nor in {Path.cwd()}", file=kind)


# --- Source -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Source:
    """The files that a function consists of."""

    digest: str
    """SHA-256 over the names and contents of all files that count, and the versions of libraries."""
    code: str
    """The same without data files, as a process that has loaded the module needs it."""
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
"""Each module that was loaded: as what it was, and the code that it was made of."""


def _source(kind: str) -> str:
    name, _ = _address(kind)
    if not (kind in _known and _known[kind].is_current):
        _known[kind] = _read(name, kind)
    source = _known[kind]
    module = sys.modules.get(name)
    if module is not None:
        spec, code = _loaded.setdefault(name, (module.__spec__, source.code))
        if module.__spec__ is not spec:  # loaded anew
            _loaded[name] = module.__spec__, source.code
        elif code != source.code:
            raise InputError("has been changed since it was loaded; start the session again", file=kind)
    return source.digest


def _read(name: str, kind: str) -> _Source:
    _look_here()
    importlib.invalidate_caches()
    if _spec(name) is None:
        raise _absent(name, kind)
    package = name.partition(".")[0]
    code: list[str] = []
    data: list[str] = []
    states: dict[Path, State] = {}
    visited, waiting = {package, __package__.partition(".")[0]} | sys.stdlib_module_names, [package]
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
    """Where a module would be loaded from; unlike `importlib.util.find_spec` it imports no parent package."""
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
