"""Compiled code: never served stale, and a folder that cannot be used costs time alone."""

import ast
import errno
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from harness import compiled
from harness.compiled import SOURCES, _Store
from harness.errors import Notice

PACKAGE = Path(compiled.__file__).parent
CALLER = """
from harness.compiled import kernel
from harness.inner._callee_kernels import answer

@kernel
def ask(x):
    return answer(x) + 1
"""
CALLEE = """
from harness.compiled import kernel

@kernel
def answer(x):
    return x * {factor}
"""
ASK = """
from harness.outer._caller_kernels import ask
from harness.inner._callee_kernels import answer
print(ask(10), len(ask.stats.cache_hits), ask.stats.cache_path)
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A package of what keeps compiled code and two loops, of which one calls the other from another file."""
    for name in ("compiled", "files", "errors"):
        (tmp_path / "harness").mkdir(exist_ok=True)
        (tmp_path / "harness" / "__init__.py").touch()
        shutil.copy(PACKAGE / f"{name}.py", tmp_path / "harness")
    for name, text in (("outer/_caller_kernels", CALLER), ("inner/_callee_kernels", CALLEE.format(factor=2))):
        path = tmp_path / "harness" / f"{name}.py"
        path.parent.mkdir()
        path.write_text(text, encoding="utf-8")
    return tmp_path


def ask(folder: Path, **environment: str) -> tuple[list[str], str]:
    """What the caller answers, how often its machine code was read, and where it is kept; and what was said."""
    taken = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "OMNIRANGE_", "XDG_"))}
    taken |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": str(folder / "cache")}
    command = [sys.executable, "-c", ASK]
    done = subprocess.run(command, env=taken | environment, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.split(), done.stderr


@pytest.mark.slow
def test_an_edit_of_a_loop_that_another_file_calls_is_seen(small: Path) -> None:
    assert ask(small)[0][:2] == ["21", "0"]
    assert ask(small)[0][:2] == ["21", "1"]  # kept, and read again
    callee = small / "harness" / "inner" / "_callee_kernels.py"
    before = callee.stat()
    callee.write_text(CALLEE.format(factor=3), encoding="utf-8")
    os.utime(callee, ns=(before.st_atime_ns, before.st_mtime_ns))  # of the same size and age as before
    assert ask(small)[0][:2] == ["31", "0"]
    callee.write_text(CALLEE.format(factor=2), encoding="utf-8")
    assert ask(small)[0][:2] == ["21", "1"]
    assert len(list((small / "cache" / "omnirange" / "kernels").iterdir())) == 2


@pytest.mark.slow
def test_runs_with_no_folder_to_write_to_and_says_so_once(small: Path) -> None:
    shutil.copytree(small / "harness", small / "copy" / "harness")
    blocked = small / "blocked"
    blocked.touch()
    answer, said = ask(small / "copy", XDG_CACHE_HOME=str(blocked), HOME=str(blocked), OMNIRANGE_CACHE=f"{blocked}/x")
    assert answer[:2] == ["21", "0"]
    assert said.count("compiled code cannot be kept, so every run compiles it again") == 1
    answer, said = ask(small / "copy", XDG_CACHE_HOME=str(blocked), OMNIRANGE_WORKER="1")
    assert (answer[0], said) == ("21", "")


def store(monkeypatch: pytest.MonkeyPatch, **environment: str) -> tuple[_Store, list[str]]:
    """The folder chosen in an environment, and what was said."""
    for name in ("OMNIRANGE_CACHE", "XDG_CACHE_HOME", "OMNIRANGE_WORKER"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        made = _Store()
    assert {each.category for each in said} <= {Notice}
    return made, [str(each.message) for each in said]


def test_the_first_folder_that_can_be_written_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "blocked"
    blocked.touch()
    good = {"XDG_CACHE_HOME": str(tmp_path / "home"), "OMNIRANGE_CACHE": str(tmp_path / "renders")}
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    chosen, said = store(monkeypatch, **good)
    assert (chosen.folder.parent, said) == (tmp_path / "home" / "omnirange" / "kernels", [])
    chosen, said = store(monkeypatch, **good | {"XDG_CACHE_HOME": str(blocked)})
    assert chosen.folder.parent == tmp_path / "renders" / "kernels"
    assert said == [f"compiled code is kept in {chosen.folder.parent}: {blocked} is no folder"]
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "numba"))
    chosen, said = store(monkeypatch, **good)
    assert (chosen.folder.parent, said) == (tmp_path / "numba" / "omnirange", [])


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    monkeypatch.setattr(Path, "home", staticmethod(nobody))
    chosen, said = store(monkeypatch)
    assert chosen.folder is None
    assert said == ["compiled code cannot be kept, so every run compiles it again: there is no home folder"]
    assert chosen.read("name") is None
    chosen.write("name", b"content")


@pytest.mark.parametrize("fault", ["full", "read-only"])
def test_a_folder_that_may_only_be_read_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    chosen, _ = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    chosen.write("name", b"content")
    if fault == "full":
        monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
    else:
        monkeypatch.setattr(os, "access", lambda *_: False)
    again, said = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    assert again.read("name") == b"content"
    assert len(said) == 1


def test_a_disk_that_fills_up_costs_time_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    chosen, _ = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    monkeypatch.setattr(compiled, "replace_file", full)
    with pytest.warns(Notice, match="No space left"):
        chosen.write("one", b"content")
    chosen.write("two", b"content")  # a second warning would be an error here


@pytest.mark.parametrize("harm", [b"", b"short", b"x" * 100])
def test_a_file_that_is_harmed_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: bytes) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    chosen, _ = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    chosen.write("name", b"content")
    assert chosen.read("name") == b"content"
    (chosen.folder / "name").write_bytes(harm)
    assert chosen.read("name") is None


def test_a_source_edited_after_the_program_began_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    chosen, _ = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    source = next(iter(chosen.hashes))
    assert chosen.holds(source)
    assert not chosen.holds(tmp_path / "another.py")
    chosen.hashes[source] = "what it was"
    with pytest.warns(Notice, match="was edited while the program ran"):
        assert not chosen.holds(source)
    assert chosen.folder is None


def test_the_newest_versions_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    monkeypatch.setattr(compiled, "VERSIONS_ON_DISK", 2)
    chosen, _ = store(monkeypatch, XDG_CACHE_HOME=str(tmp_path))
    for age in range(5):
        old = chosen.folder.with_name(f"{age:032x}")
        old.mkdir(parents=True)
        os.utime(old, (1e9 - age, 1e9 - age))
    chosen.write("name", b"content")
    assert {each.name for each in chosen.folder.parent.iterdir()} == {f"{0:032x}", f"{1:032x}", chosen.folder.name}


def test_files_of_compiled_code_take_nothing_from_python_beside_them() -> None:
    """Else an edit there would be compiled in and not be seen: constants count too."""
    sources = {path for pattern in SOURCES for path in PACKAGE.glob(pattern)}
    models = set(PACKAGE.glob("camera/models/*.py"))
    assert sources == set(PACKAGE.rglob("_*kernels.py")) | models
    modules = {".".join(("harness", *path.relative_to(PACKAGE).with_suffix("").parts)) for path in sources}
    for path in sources - models:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            names = [name for name in names if name.partition(".")[0] not in ("numba", "llvmlite")]
            wrong = set(names) - modules - {"math", "operator", "typing", "numpy", "harness.compiled"}
            assert not wrong, f"{path.name} imports {wrong}"
