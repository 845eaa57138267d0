"""Functions of other people: found by name, asked what they take, and known again by their source.

A name is `package.module:function`, or what an installed package gives in the entry point group `omnirange.matchers`.
"""

import ast
import hashlib
import importlib
import importlib.metadata
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from pathlib import Path
from typing import Any

from harness.errors import InputError
from harness.spec import nearest

ENTRY_POINTS = "omnirange.matchers"


@lru_cache(maxsize=1)
def entry_points() -> Mapping[str, importlib.metadata.EntryPoint]:
    """What installed packages offer, by name."""
    return {each.name: each for each in importlib.metadata.entry_points(group=ENTRY_POINTS)}


def find(kind: str) -> Callable[..., Any]:
    """The function of this name; modules are also looked for in the current folder.

    Raises
    ------
    InputError
        When there is no such module or function. `error.file` is the name.
    """
    module_name, attributes = _address(kind)
    found = module = _module(module_name, kind)
    for name in attributes.split("."):
        if not hasattr(found, name):
            there = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
            where = getattr(module, "__file__", None) or "built in"
            raise InputError(f"the module {module_name} ({where}) has no '{name}'; {nearest(name, there)}", file=kind)
        found = getattr(found, name)
    if not callable(found):
        raise InputError(f"is a {type(found).__name__}, not a function", file=kind)
    function: Callable[..., Any] = found
    return function


def check(kind: str, parameters: Mapping[str, Any]) -> None:
    """See whether a function can be called as `function(pair, limits, **parameters)`.

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
    for name, value in parameters.items():
        if _names_a_file(name, value) and not Path(value).is_file():
            raise InputError(f"no such file: {value}", key=f"parameters.{name}")


def takes(kind: str, name: str) -> bool:
    """Whether a function has a parameter of this name; one that cannot be asked has."""
    try:
        taken = _taken(find(kind))
    except (InputError, TypeError):
        return True
    return taken is None or name in taken[0] or taken[1]


def digest(kind: str, parameters: Mapping[str, Any]) -> str:
    """SHA-256 of what the name and the parameters do not tell: the function's source, and the files in parameters.

    A function counts with its module; a module in a package with all of the package. What they import counts too:
    installed libraries by their version, anything else by its source. Nothing is imported. Source is read
    once in the life of the process, as modules are loaded once.

    Raises
    ------
    InputError
        When there is no such module or file.
    """
    files = [
        f"{name} {hash_of(Path(value))}" for name, value in sorted(parameters.items()) if _names_a_file(name, value)
    ]
    return hashlib.sha256("\n".join([_source(kind), *files]).encode()).hexdigest()


def hash_of(path: Path) -> str:
    """SHA-256 of a file, read again when it has changed.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    try:
        state = path.stat()
        return _hash_of(path, state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error


@lru_cache(maxsize=64)
def _hash_of(path: Path, _modified_ns: int, _size: int) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _names_a_file(name: str, value: Any) -> bool:
    return isinstance(value, str) and (name == "file" or name.endswith("_file"))


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
        raise InputError("must lie in a module of its own, which workers can load too", file=kind)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise _absent(name, kind) from error
        raise InputError(f"the module {name} needs {error.name}, which is not installed", file=kind) from error
    except (Exception, SystemExit) as error:
        raise InputError(f"the module {name} fails: {type(error).__name__}: {error} (in {here})", file=kind) from error


def _absent(name: str, kind: str) -> InputError:
    return InputError(f"there is no module {name}, neither installed nor in {Path.cwd()}", file=kind)


# --- Source -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def _source(kind: str) -> str:
    """SHA-256 over the names and contents of all files that count, and the versions of libraries."""
    _look_here()
    importlib.invalidate_caches()
    name, _ = _address(kind)
    if _spec(name) is None:
        raise _absent(name, kind)
    own = name.partition(".")[0]
    parts: list[str] = []
    seen, waiting = {own, __package__.partition(".")[0]} | sys.stdlib_module_names, [own]
    while waiting:
        module = waiting.pop()
        folder, files = _files(_spec(module))
        if module != own and {"site-packages", "dist-packages"} & set(folder.parts):
            parts.append(f"{module} {_version(module)}")
            continue
        for file in files:
            parts.append(f"{file.relative_to(folder).as_posix()} {hash_of(file)}")
            imported = _imports(file) - seen if file.suffix == ".py" else set()
            seen |= imported
            waiting.extend(imported)
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()


def _spec(name: str) -> ModuleSpec | None:
    """Where a module would be loaded from; unlike `importlib.util.find_spec` it imports no parent package."""
    path = None
    spec = None
    parts = name.split(".")
    for i in range(len(parts)):
        full = ".".join(parts[: i + 1])
        if i and path is None:
            return None
        found = (finder.find_spec(full, path) for finder in sys.meta_path if hasattr(finder, "find_spec"))
        spec = next((each for each in found if each is not None), None)
        if spec is None:
            return None
        path = spec.submodule_search_locations
    return spec


def _files(spec: ModuleSpec | None) -> tuple[Path, list[Path]]:
    """The folder that a top module lies in, and its source files: a package's are all below it."""
    if spec is not None and spec.submodule_search_locations:
        package = Path(next(iter(spec.submodule_search_locations)))
        endings = (".py", *EXTENSION_SUFFIXES)
        return package.parent, sorted(path for path in package.rglob("*") if path.name.endswith(endings))
    if spec is not None and spec.origin and spec.has_location:
        return Path(spec.origin).parent, [Path(spec.origin)]
    return Path(), []


def _imports(file: Path) -> set[str]:
    """The top modules that a source file imports anywhere; none when it is not valid Python."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return set()
    return {name.partition(".")[0] for node in ast.walk(tree) for name in _imported(node)}


def _imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (each.name for each in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        yield node.module


def _version(module: str) -> str:
    """Of the package that brought an installed module."""
    try:
        return importlib.metadata.version(module)
    except importlib.metadata.PackageNotFoundError:
        return " ".join(
            f"{name} {importlib.metadata.version(name)}" for name in sorted(set(_distributions().get(module, [])))
        )


@lru_cache(maxsize=1)
def _distributions() -> Mapping[str, list[str]]:
    return importlib.metadata.packages_distributions()
