"""What Tab offers, asked as a shell asks, and once through bash itself."""

import io
import shutil
import subprocess
import sys
from pathlib import Path

import argcomplete
import pytest

from harness import shipped
from harness.cli import main
from harness.cli.completion import SHELLS
from harness.cli.parser import _parser
from harness.matching.registry import BUILT_IN


def offered(line: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The words that may stand at the end of a line."""
    for name, value in (
        ("_ARGCOMPLETE", "1"),
        ("_ARGCOMPLETE_IFS", "\013"),
        ("_ARGCOMPLETE_SUPPRESS_SPACE", "1"),
        ("_ARGCOMPLETE_SHELL", "fish"),  # which breaks words at spaces alone
        ("COMP_LINE", line),
        ("COMP_POINT", str(len(line))),
    ):
        monkeypatch.setenv(name, value)

    # Its messages go to descriptor 9, which in this process is somebody else's.
    monkeypatch.setattr(argcomplete.CompletionFinder, "_init_debug_stream", lambda _: None)
    answer = io.StringIO()
    with pytest.raises(SystemExit):
        argcomplete.autocomplete(_parser(), exit_method=sys.exit, output_stream=answer)
    return [word.partition("\t")[0] for word in answer.getvalue().split("\013") if word]


def test_commands_and_options(monkeypatch: pytest.MonkeyPatch) -> None:
    commands = {"run", "report", "compare", "cache", "render", "range", "check", "settings", "completion"}
    assert commands <= set(offered("omnirange ", monkeypatch))
    assert {"render", "report"} <= set(offered("omnirange re", monkeypatch))
    assert "run" not in offered("omnirange re", monkeypatch)
    options = offered("omnirange run paper --", monkeypatch)
    assert {"--set", "--axis", "--workers", "--keep-arrays", "--dry-run"} <= set(options)


def test_names_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").touch()
    (tmp_path / "mine.txt").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "deep.toml").touch()
    assert set(offered("omnirange run ", monkeypatch)) >= {*shipped.names("experiments"), "mine.toml", "folder/"}
    assert offered("omnirange run pap", monkeypatch) == ["paper"]
    assert offered("omnirange run mine", monkeypatch) == ["mine.toml"]
    assert offered("omnirange run folder/", monkeypatch) == ["folder/deep.toml"]
    assert offered("omnirange render corr", monkeypatch) == ["corridor"]
    assert offered("omnirange report ", monkeypatch)[-1:] == ["folder/"]
    assert "mine.toml" not in offered("omnirange report ", monkeypatch)
    assert offered("omnirange run nowhere/x", monkeypatch) == []


def test_kinds_of_matcher_and_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(BUILT_IN) <= set(offered("omnirange range a.png b.png --matcher ", monkeypatch))
    assert offered("omnirange check slan", monkeypatch) == ["slanted"]
    assert offered("omnirange settings view_2.base", monkeypatch) == ["view_2.baseline_m"]
    assert offered("omnirange run paper --set matching.window", monkeypatch) == ["matching.window_px="]
    assert offered("omnirange run paper --axis matching.kind=sgm,slan", monkeypatch) == ["matching.kind=sgm,slanted"]
    assert offered("omnirange run paper --set noise.sigma_grey=", monkeypatch) == []


@pytest.mark.parametrize("shell", SHELLS)
def test_a_script_for_each_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "omnirange" in script
    if shutil.which(shell):
        checked = subprocess.run([shell, "-n"], input=script, capture_output=True, text=True, timeout=60, check=False)
        assert (checked.returncode, checked.stderr) == (0, "")


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_bash_completes(tmp_path: Path) -> None:
    program = tmp_path / "omnirange"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m harness "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    script = r"""
        PATH="$1:$PATH"
        eval "$(omnirange completion bash)"
        handler=$(complete -p omnirange | sed 's/.*-F \([^ ]*\).*/\1/')
        for line in "omnirange run pap" "omnirange run paper --keep" "omnirange comp"; do
            COMP_LINE=$line COMP_POINT=${#line} COMP_TYPE=9
            read -r -a COMP_WORDS <<< "$line"
            COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMPREPLY=()
            "$handler" omnirange "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
            echo "${COMPREPLY[@]}"
        done
    """
    ran = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", str(tmp_path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert [sorted(line.split()) for line in ran.stdout.splitlines()] == [
        ["paper"],
        ["--keep-arrays"],
        ["compare", "completion"],
    ]
