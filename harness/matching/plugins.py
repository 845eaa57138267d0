"""Third-party functions, and classes that are loaded once: found by name, checked for their parameters, and identified
by their source.

A name is `package.module:function`, or a name from the entry point group `omnirange.matchers`.
"""

import copy
import hashlib
import importlib
import importlib.metadata
import inspect
import json
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness import interrupts
from harness.errors import InputError, described, nearest
from harness.source_files import hash_of, named_files
from harness.third_party import absent, is_known, look_here, source_of

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
    if not is_known(module_name):  # record the files that it was made of
        source_of(module_name, kind)
    for name in attributes.split("."):
        if not hasattr(target, name):
            available = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
            where = getattr(module, "__file__", None) or "built in"
            raise InputError(
                f"the module {module_name} ({where}) has no '{name}'; {nearest(name, available)}", file=kind
            )
        target = getattr(target, name)
    if not callable(target):
        raise InputError(f"is a {type(target).__name__}, not a function", file=kind)
    function: Callable[..., Any] = target
    return function


def runner(kind: str, parameters: Mapping[str, Any]) -> Callable[[Any, Any], Any]:
    """The callable that takes a pair and limits: a function with its parameters bound, or an instance of a class.

    Each thread keeps the `MOST_LOADED` instances that it used last, and makes one again only when its source or a file
    among its parameters has changed. So what is slow to load, such as a network, is loaded once in each worker.

    Raises
    ------
    InputError
        When it cannot be found.
    """
    target = find(kind)
    if not inspect.isclass(target):
        return lambda pair, limits: target(pair, limits, **copy.deepcopy(dict(parameters)))
    if not hasattr(_of_thread, "loaded"):
        _of_thread.loaded = OrderedDict()
    loaded: OrderedDict[tuple[str, str, str], Any] = _of_thread.loaded
    key = kind, json.dumps(dict(parameters), sort_keys=True), digest(kind, parameters)
    if key not in loaded:
        while len(loaded) >= MOST_LOADED:
            loaded.popitem(last=False)  # before the new one is made: two networks need not fit
        loaded[key] = target(**copy.deepcopy(dict(parameters)))
    loaded.move_to_end(key)
    instance: Callable[[Any, Any], Any] = loaded[key]
    return instance


MOST_LOADED = 4
"""Most instances of classes that a thread keeps: networks may be large, and a run may compare a few."""

_of_thread = threading.local()


def check(kind: str, parameters: Mapping[str, Any]) -> None:
    """Check that a function can be called as `function(pair, limits, **parameters)`, or a class so that
    `Class(**parameters)` can be called as `(pair, limits)`.

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
        taken = _parameters_of(function)
    except TypeError:
        must = "have a method __call__(self, pair, limits)" if inspect.isclass(function) else "take (pair, limits, "
        must += "" if inspect.isclass(function) else "**parameters)"
        raise InputError(f"{kind} must {must}", key="kind") from None
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
        taken = _parameters_of(find(kind))
    except (InputError, TypeError):
        return True
    return taken is None or name in taken[0] or taken[1]


def digest(kind: str, parameters: Mapping[str, Any]) -> str:
    """SHA-256 of the function's source and of the files in parameters, which name and parameters do not determine.

    A function counts with its module; a module in a package with all files of the package, data too. What they import
    counts likewise: installed libraries by their version, anything else by its files. Nothing is imported.

    Raises
    ------
    InputError
        When there is no such module or file, or its source has changed since this process has loaded it.
    """
    files = [f"{name} {hash_of(file)}" for name, file in named_files(parameters.items())]
    return hashlib.sha256("\n".join([source_of(_address(kind)[0], kind), *files]).encode()).hexdigest()


def _address(kind: str) -> tuple[str, str]:
    """(module, function)."""
    value = entry_points()[kind].value if kind in entry_points() else kind
    module, _, function = value.partition("[")[0].partition(":")
    return module.strip(), function.strip()


def _parameters_of(function: Callable[..., Any]) -> tuple[dict[str, inspect.Parameter], bool] | None:
    """The parameters after the pair and the limits, and whether any others are taken; None without a signature.

    The parameters of a class are those of its constructor; its instances take the pair and the limits.

    Raises
    ------
    TypeError
        When it does not take two arguments.
    """
    first_two: Mapping[str, Any] = {}
    try:
        signature = inspect.signature(function)
        if inspect.isclass(function):
            inspect.signature(_call_of(function)).bind(None, None, None)
        else:
            first_two = signature.bind_partial(None, None).arguments
    except ValueError:
        return None
    later = {name: each for name, each in signature.parameters.items() if name not in first_two}
    known = {name: each for name, each in later.items() if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY)}
    return known, any(each.kind == each.VAR_KEYWORD for each in later.values())


def _call_of(target: type) -> Callable[..., Any]:
    """The `__call__` method of a class.

    Raises
    ------
    TypeError
        When it cannot be called.
    """
    for each in target.__mro__:
        if callable(call := vars(each).get("__call__")):
            return call
    raise TypeError


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


def _module(name: str, kind: str) -> Any:
    here = look_here()
    if name == "__main__":
        raise InputError("must be in an importable module, so that workers can load it", file=kind)
    try:
        with contained():
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise absent(name, kind) from error
        raise InputError(f"the module {name} needs {error.name}, which is not installed", file=kind) from error
    except BaseException as error:
        if interrupts.is_real(error):
            raise
        raise InputError(f"the module {name} fails: {described(error)} (in {here})", file=kind) from error
