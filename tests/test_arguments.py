"""What is written on a command line and cannot be meant: one line each, and numbers are numbers."""

from pathlib import Path

import pytest
from sweeps import write_small

from harness.cli import main
from harness.cli.parser import _parser
from harness.errors import InputError
from harness.files import path_of
from harness.runs.load import load_experiment


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that is said."""
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert len(said.err) < 500
    return said.err.removeprefix("omnirange: ").strip()


LONG = "x" * 5000


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("run", f"{LONG}.toml"), "cannot be used as a file name (File name too long)"),
        (("run", LONG), "cannot be used as a file name (File name too long)"),
        (("run", "loop.toml"), "cannot be used as a file name (Too many levels of symbolic links)"),
        (("run", "~nobody-here/x.toml"), "there is no user nobody-here, or no home folder"),
        (("run", "a\0b.toml"), "an argument must be UTF-8, without null bytes"),
        (("run", "a\udcffb.toml"), r"'a\udcffb.toml': an argument must be UTF-8, without null bytes"),
        (("run", "deep.toml"), "deep.toml: tables and lists are nested more than 64 deep"),
        (("run", "pipe.toml"), "no such experiment"),
        (("run", "small.toml", "--set", "seed=" + "[" * 3000), "seed: tables and lists are nested more than 64 deep"),
        (("run", "small.toml", "--axis", "seed=" + "[" * 3000), "seed: tables and lists are nested more than 64 deep"),
        (("run", "small.toml", "--set", f"seed={LONG}"), "--set: seed: must be a whole number; found 'xxx"),
        (("run", "small.toml", "--set", f"{LONG}=1"), "unknown key 'xxx"),
        (("run", "small.toml", "--set", "seed=1\nnoise=5"), "--set: seed: must be a whole number; found"),
        (("run", "small.toml", "--set", "scene=~nobody-here/x.toml"), "there is no user nobody-here"),
        (("run", "small.toml", "--set", f"sensor={LONG}"), "sensor: 'xxx"),
        (("run", "small.toml", "--set", 'sensor="a\\u0000b"'), "is not a file name"),
        (("run", "huge.toml", "--dry-run"), "axes: 1000000000 trials are more than the 100000"),
        (("render", "~nobody-here/x.toml", "--at", "0", "0", "1", "--out", "o"), "there is no user nobody-here"),
        (("render", "null.toml", "--at", "0", "0", "1", "--out", "o"), "objects[0].file: 'a\\x00b.ply': is not a file"),
        (
            ("render", "box", "--at", "0", "0", "1", "--sensor", "deep.toml", "--out", "o"),
            "deep.toml: tables and lists",
        ),
        (
            ("render", "box", "--at", "0", "0", "-inf", "--out", "o"),
            "--at: must be a finite number",
        ),
        (
            ("render", "box", "--at", "0", "0", "1", "--yaw-deg", "nan", "--out", "o"),
            "--yaw-deg: must be a finite number",
        ),
    ],
    ids=lambda each: " ".join(each)[:50].replace("\0", "0") if isinstance(each, tuple) else "",
)
def test_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple, problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_small(tmp_path / "small.toml")
    thousand = list(range(1000))
    axes = f'[axes]\nseed = {thousand}\n"view_2.yaw_deg" = {thousand}\n"view_2.roll_deg" = {thousand}\n'
    write_small(tmp_path / "huge.toml", axes)
    (tmp_path / "deep.toml").write_text("a = " + "[" * 3000 + "]" * 3000)
    (tmp_path / "null.toml").write_text('name = "n"\n[[objects]]\nkind = "mesh"\nfile = "a\\u0000b.ply"\n')
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    assert problem in answer(capsys, *arguments)


@pytest.mark.parametrize("number", ["-1e-3", "-.5", "-1", "-1.", "-2E3", "-inf", "-nan", "-.5e-3"])
def test_negative_numbers_are_numbers(number: str) -> None:
    options = _parser().parse_args(["render", "box", "--at", number, number, "0", "--yaw-deg", number, "--out", "o"])
    assert str(options.at[0]) == str(options.yaw_deg) == str(float(number))
    options = _parser().parse_args(
        ["range", "a", "b", "--sensor", "s", "--baseline", number, "0", number, "--out", "o"]
    )
    assert str(options.baseline[2]) == str(float(number))


def test_a_setting_takes_a_negative_number(tmp_path: Path) -> None:
    path = str(write_small(tmp_path / "small.toml"))
    assert load_experiment(path, ["view_2.yaw_deg=-1e-3"]).trial.view_2.yaw_deg == -1e-3
    planned = load_experiment(path, [], ["view_2.yaw_deg=-.5,-1e-3"]).planned
    assert [each.trial.view_2.yaw_deg for each in planned] == [-0.5, -1e-3]


def test_a_misspelt_option_stays_an_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "smoke", "--nan-yaw", "1"])
    assert capsys.readouterr().err == "omnirange: unknown option '--nan-yaw'; see omnirange run --help\n"


@pytest.mark.parametrize("odd", ["seed=1\nseed=5", LONG, "\t\r\n"])
def test_what_is_no_option_is_answered_in_one_short_line(capsys: pytest.CaptureFixture[str], odd: str) -> None:
    with pytest.raises(SystemExit):
        main(["run", "smoke", "--sets", odd])
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert len(said) < 300


def test_a_path_is_relative_to_its_folder_and_need_not_be_there(tmp_path: Path) -> None:
    assert path_of("a/b.toml", tmp_path) == tmp_path / "a" / "b.toml"
    assert path_of("/a/b.toml", tmp_path) == Path("/a/b.toml")
    assert path_of("~/x") == Path.home() / "x"
    with pytest.raises(InputError, match=r"^f\.toml: k: 'a\\x00b': is not a file name"):
        path_of("a\0b", file="f.toml", key="k")
