"""A third-party matcher is identified by its source and the files that it names."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest
from plugin_modules import Write
from sweeps import write_small

from harness.errors import InputError
from harness.matching import plugins
from harness.runs.load import load_experiment, load_matcher


def digest(kind: str, folder: Path) -> str:
    """In a process of its own, as each run is; and without a module of the matcher being loaded."""
    program = (
        "import sys; from harness.matching import plugins; before = set(sys.modules); "
        f"print(plugins.digest({kind!r}, {{}})); "
        "sys.exit([each for each in set(sys.modules) - before if each.startswith(('top', 'beside', 'pack.'))])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)
    assert done.stderr.strip() in {"", "[]"}
    return done.stdout.strip()


@pytest.mark.slow
def test_a_change_of_source_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "top.py").write_text("def f(pair, limits):\n    import beside\n    return beside.g(pair)\n")
    (tmp_path / "beside.py").write_text("import scipy.optimize\nfrom pack.inner import h as g\n")
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").touch()
    (tmp_path / "pack" / "inner.py").write_text("from . import other\n")
    (tmp_path / "pack" / "other.py").write_text("x = 1\n")
    (tmp_path / "stranger.py").write_text("x = 1\n")
    before = digest("top:f", tmp_path)
    (tmp_path / "stranger.py").write_text("x = 2\n")
    assert digest("top:f", tmp_path) == before
    for changed in ("top.py", "beside.py", "pack/inner.py", "pack/other.py"):
        with (tmp_path / changed).open("a") as file:
            file.write("# changed\n")
        after = digest("top:f", tmp_path)
        assert after != before, changed
        before = after


def test_files_in_parameters_count_by_their_contents(module: Write, tmp_path: Path) -> None:
    kind = f"{module('def f(pair, limits, weights_file, name): ...')}:f"
    (tmp_path / "weights.bin").write_bytes(b"one")
    (tmp_path / "copy.bin").write_bytes(b"one")

    def told(file: str) -> str:
        return plugins.digest(kind, {"weights_file": str(tmp_path / file), "name": file})

    one = told("weights.bin")
    assert told("copy.bin") == one
    (tmp_path / "weights.bin").write_bytes(b"other")
    assert told("weights.bin") != one


def test_files_in_parameters_lie_beside_the_experiment(module: Write, tmp_path: Path) -> None:
    kind = f"{module('def f(pair, limits, weights_file, name): ...')}:f"
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "w.bin").touch()
    matching = f'[trial.matching]\nkind = "{kind}"\nparameters = {{ weights_file = "w.bin", name = "w.bin" }}\n'
    trial = load_experiment(str(write_small(tmp_path / "deep" / "e.toml", matching))).trial
    assert trial.matching.parameters == {"weights_file": str(tmp_path / "deep" / "w.bin"), "name": "w.bin"}


def test_a_matcher_of_this_program_has_no_fingerprint() -> None:
    assert load_matcher("window").identity() == ""


def _module(folder: Path, monkeypatch: pytest.MonkeyPatch, content: str) -> str:
    """A new module in the current folder."""
    name = f"edited_{abs(hash(folder)):x}"
    (folder / f"{name}.py").write_text(content)
    monkeypatch.chdir(folder)
    return name


def test_a_module_edited_after_it_was_loaded_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = _module(tmp_path, monkeypatch, "def f(pair, limits): return 1\n")
    matcher = load_matcher(f"{name}:f")
    before = matcher.identity()
    assert matcher.identity() == before
    (tmp_path / f"{name}.py").write_text("def f(pair, limits): return 2\n")  # of the same size, within the same second
    with pytest.raises(InputError, match="has been changed since it was loaded; start the session again"):
        matcher.identity()
    importlib.invalidate_caches()
    sys.dont_write_bytecode, stored = True, sys.dont_write_bytecode
    importlib.reload(sys.modules[name])
    sys.dont_write_bytecode = stored
    assert matcher.identity() != before


def test_a_helper_edited_after_it_was_loaded_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / f"helper_{abs(hash(tmp_path)):x}.py").write_text("a = 1\n")
    name = _module(tmp_path, monkeypatch, f"import helper_{abs(hash(tmp_path)):x}\ndef f(pair, limits): ...\n")
    matcher = load_matcher(f"{name}:f")
    (tmp_path / f"helper_{abs(hash(tmp_path)):x}.py").write_text("a = 2\n")
    with pytest.raises(InputError, match="has been changed since it was loaded"):
        matcher.identity()


def test_data_of_a_package_counts_and_needs_no_new_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"packed_{abs(hash(tmp_path)):x}"
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("def f(pair, limits): ...\n")
    (tmp_path / name / "weights.bin").write_text("1")
    monkeypatch.chdir(tmp_path)
    matcher = load_matcher(f"{name}:f")
    before = matcher.identity()
    (tmp_path / name / "weights.bin").write_text("2")
    assert matcher.identity() != before
