"""The rooms import one way only, and the contract that says so can fail."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def lint_imports(folder: Path) -> subprocess.CompletedProcess:
    command = "import sys; sys.path.insert(0, ''); from importlinter.cli import lint_imports_command as c; c()"
    arguments = [sys.executable, "-c", command, "--no-cache"]
    return subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The package alone in another place, to be spoilt."""
    shutil.copytree(ROOT / "harness", tmp_path / "harness", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_imports_point_downwards() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "The pipeline reads downwards KEPT" in result.stdout


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("camera/lens.py", "import harness.simulation"),  # upwards
        ("matching/pair.py", "import harness.simulation"),  # between neighbours
        ("simulation/scene.py", "import harness.matching"),
        ("errors.py", "import harness.spec"),
    ],
)
def test_import_against_the_grain_is_found(copy: Path, module: str, line: str) -> None:
    path = copy / "harness" / module
    path.write_text(f"{path.read_text(encoding='utf-8')}\n{line}\n", encoding="utf-8")
    result = lint_imports(copy)
    assert result.returncode != 0
    assert "The pipeline reads downwards BROKEN" in result.stdout


def test_new_room_must_say_where_it_belongs(copy: Path) -> None:
    (copy / "harness" / "attic.py").touch()
    result = lint_imports(copy)
    assert result.returncode != 0
    assert "attic" in result.stdout
