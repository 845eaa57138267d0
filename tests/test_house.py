"""The house in order: what is tracked by git, the lock, the version, and the tools' settings."""

import ast
import os
import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import harness

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LOCK = ROOT / "requirements.lock"

# Spelt in pieces, so that this file does not find itself.
HOME_FOLDERS = "|".join(["/wor" + "k/", "/roo" + "t/", "/ho" + "me/[a-z]", "/Use" + "rs/[a-z]", r"C:\\Use" + "rs"])
REGISTRY_HOSTS = "|".join(["pypi" + r"\.org", "python" + r"hosted\.org", "conda" + r"\.anaconda", "arti" + "factory"])
INDEX_OPTIONS = "|".join(["file:" + "//", "--index" + "-url", "--find" + "-links"])


def tracked() -> list[Path]:
    """The files that git tracks; a source archive has no git, and there is nothing to look at then."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    return [path for name in listing.split(b"\0") if name and (path := ROOT / os.fsdecode(name)).is_file()]


def text_of(path: Path) -> str:
    data = path.read_bytes()
    return "" if b"\0" in data[:8192] else data.decode("utf-8")


def offences(text: str) -> list[str]:
    return re.findall(f"{HOME_FOLDERS}|{REGISTRY_HOSTS}|{INDEX_OPTIONS}", text)


def locked() -> dict[str, list[str]]:
    """Requirement -> its hashes."""
    entries: dict[str, list[str]] = {}
    for line in LOCK.read_text(encoding="utf-8").splitlines():
        if line.startswith("    --hash="):
            entries[list(entries)[-1]].append(line.strip(" \\").removeprefix("--hash="))
        elif line and not line.lstrip().startswith("#"):
            entries[line.strip(" \\")] = []
    return entries


def names(requirements: list[str]) -> set[str]:
    """The normalised names of requirements, without versions and markers."""
    return {re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", one).group().lower()) for one in requirements}


def test_nothing_tracked_knows_of_a_machine_or_a_registry() -> None:
    result = {str(path.relative_to(ROOT)): bad for path in tracked() if (bad := offences(text_of(path)))}
    assert not result


@pytest.mark.parametrize(
    "text", ["see /wor" + "k/main", "/ho" + "me/me/x", "https://py" + "pi.org/simple", "--index" + "-url x"]
)
def test_the_search_for_them_finds_them(text: str) -> None:
    assert offences(text)


def test_tracked_text_is_utf8_with_a_last_newline() -> None:
    wrong = [
        str(path.relative_to(ROOT))
        for path in tracked()
        if (text := text_of(path)) and (not text.endswith("\n") or "\r" in text)
    ]
    assert not wrong


def sources() -> list[Path]:
    return [path for path in tracked() if path.suffix == ".py"]


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    waiting: list[ast.AST] = [ast.parse(text_of(path))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node
        # No expression has a function inside, and most of a file is expressions.
        inside = ast.iter_child_nodes(node)
        waiting += [each for each in inside if isinstance(each, ast.stmt | ast.excepthandler | ast.match_case)]


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    asked = function.args
    return len([*asked.posonlyargs, *asked.args, *asked.kwonlyargs, *filter(None, (asked.vararg, asked.kwarg))])


def test_files_fit_a_sitting() -> None:
    assert not {str(path.relative_to(ROOT)): n for path in sources() if (n := text_of(path).count("\n")) > 500}


@pytest.mark.slow
def test_functions_fit_a_screen_and_take_a_dozen_parameters() -> None:
    """But for compiled loops, which live in `_*_kernels.py`: what they call is inlined, and they take arrays."""
    checked = [path for path in sources() if not path.name.endswith("_kernels.py")]
    long = [
        f"{path.relative_to(ROOT)}: {each.name}: {lines} lines, {parameters(each)} parameters"
        for path in checked
        for each in functions(path)
        if (lines := each.end_lineno - each.lineno + 1) > 80 or parameters(each) > 12
    ]
    assert not long


def test_no_docstring_begins_with_of() -> None:
    """A docstring says what comes back or is done."""
    of = "^\\s*" + 3 * '"' + "Of "
    assert not [str(path.relative_to(ROOT)) for path in sources() if re.search(of, text_of(path), re.MULTILINE)]


def test_nothing_tracked_is_large() -> None:
    """A clone stays quick: half a megabyte a file holds every mesh, texture and figure so far."""
    assert not [str(path.relative_to(ROOT)) for path in tracked() if path.stat().st_size > 500_000]


def test_every_locked_requirement_is_pinned_and_hashed() -> None:
    entries = locked()
    assert len(entries) > 20  # the parser found the file's lines
    assert not [entry for entry in entries if not re.fullmatch(r"[\w.-]+==[\w.!+]+( ; .+)?", entry)]
    assert not [entry for entry, hashes in entries.items() if not hashes]
    assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for hashes in entries.values() for one in hashes)


def test_lock_has_no_addresses() -> None:
    assert "://" not in LOCK.read_text(encoding="utf-8")


def test_lock_covers_what_the_project_asks_for() -> None:
    project = PROJECT["project"]
    wanted = names([*project["dependencies"], *project["optional-dependencies"]["dev"]])
    wanted |= names(PROJECT["build-system"]["requires"])  # the install builds from the lock alone
    assert not wanted - names(list(locked()))


def test_one_version() -> None:
    assert "version" not in PROJECT["project"]  # not stated twice
    home = ROOT / PROJECT["tool"]["hatch"]["version"]["path"]
    assert re.findall(r'^__version__ = "(.+)"$', home.read_text(encoding="utf-8"), re.MULTILINE) == [
        harness.__version__
    ]


def test_warnings_are_errors() -> None:
    assert PROJECT["tool"]["pytest"]["ini_options"]["filterwarnings"] == ["error"]


def test_every_ignored_rule_says_why() -> None:
    """One comment a line, or the one of a neighbour that is ignored for the same reason."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    block = re.search(r"\nignore = \[\n(.*?)\n\]", text, re.DOTALL).group(1)
    reasons = [line for line in block.splitlines() if "#" in line]
    assert len(reasons) > 0.5 * len(block.splitlines())


def test_pre_commit_runs_what_make_lint_runs() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    lint = re.search(r"^lint:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE).group(1)
    for command in re.findall(r"\$\(BIN\)/([\w-]+(?: (?!\.)[a-z]+)?)", lint):
        assert f"entry: {command}" in hooks


def test_ci_runs_the_commands_of_the_makefile() -> None:
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    text = script.read_text(encoding="utf-8")
    assert all(f"\nmake {target}\n" in text for target in ("lint", "test", "paper"))
    subprocess.run(["bash", "-n", script], check=True)
