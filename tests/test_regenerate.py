"""The script that measures the reference numbers anew: its runs go on, and it says what is not as it was."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

PATH = Path(__file__).parents[1] / "results" / "reference" / "regenerate.py"


@pytest.fixture
def script(monkeypatch, tmp_path):
    """The script, with its runs in a folder of the test's own."""
    spec = importlib.util.spec_from_file_location("regenerate", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "RUNS", tmp_path)
    return module


def test_what_is_not_as_it_was_is_told_with_the_largest_change_first(script):
    before = {"a": 1.0, "b": [1.0, 2.0, "fine"], "gone": 3, "made_by": {"python": "3.11"}}
    after = {"a": 1.0 + 1e-9, "b": [1.1, 4.0, "bad"], "new": None, "made_by": {"python": "3.13"}}
    assert script.differences(before, after) == [
        "b.2: fine -> bad",
        "gone: 3 -> absent",
        "new: absent -> None",
        "b.1: 2 -> 4",
        "b.0: 1 -> 1.1",
    ]
    assert script.differences(before, before) == []


def test_every_reference_file_is_made_by_it(script):
    assert {f"{name}.json" for name in script.FILES} == {path.name for path in PATH.parent.glob("*.json")}


@pytest.mark.slow
def test_it_goes_on_where_it_was_stopped(script, monkeypatch, tmp_path, capsys):
    """The same numbers from the same rows, and no trial is run twice; references stay as they are."""
    known = (PATH.parent / "paper.json").read_bytes()
    monkeypatch.setattr(sys, "argv", ["regenerate.py", "--quick", "paper"])
    with monkeypatch.context() as patch:
        patch.setitem(script.FILES, "paper", script.FILES["paper"]._replace(numbers=_stop))
        with pytest.raises(KeyboardInterrupt):
            script.main()
    assert "4 of 4 trials run" in capsys.readouterr().out
    assert script.main() == 0
    said = capsys.readouterr().out
    assert "trials run" not in said
    assert "paper.json: " in said
    assert "values are not what they were" in said  # these are of small panoramas
    assert set(json.loads((tmp_path / "quick" / "paper.json").read_text())["scenes"]) == {"box", "corridor", "room"}
    assert (PATH.parent / "paper.json").read_bytes() == known


def _stop(_results):
    raise KeyboardInterrupt
