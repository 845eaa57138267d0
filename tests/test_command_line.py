"""What the parser says: the option, what is wrong and what would be right, in the words of the rest of the program."""

import pytest

from harness.cli import main

PAIR = ("range", "a.png", "b.png", "--sensor", "s.toml", "--out", "o")
ONE_EACH = "--pose takes one value each time: --pose A --pose B; see omnirange range"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("range", "--pose", "a.toml", "b.toml"), f"RIGHT, --sensor, --out: missing; {ONE_EACH}"),
        (("range", "a.png"), "RIGHT, --sensor, --out: missing; see omnirange range"),
        ((*PAIR, "--pose", "a.toml", "b.toml"), f"'b.toml' is one argument too many; {ONE_EACH}"),
        ((*PAIR, "c.png"), "'c.png' stands apart; write each IMAGE beside the others; see omnirange range"),
        ((*PAIR, "--baseline", "1", "0"), "--baseline: must be followed by X Y Z; see omnirange range"),
        ((*PAIR, "--baseline", "1", "0", "x"), "--baseline: must be a number; found 'x'; see omnirange range"),
        (
            (*PAIR, "--baseline", "1", "0", "0", "--pose", "p"),
            "--pose: excludes --baseline; leave one of them out; see omnirange range",
        ),
        ((*PAIR, "--bits", "x"), "--bits: must be a whole number; found 'x'; see omnirange range"),
        (
            (*PAIR, "--basline", "1", "0", "0"),
            "unknown option '--basline'; did you mean '--baseline'? See omnirange range",
        ),
        (("run", "paper", "smoke"), "'smoke' is one argument too many; see omnirange run"),
        (("run",), "EXPERIMENT: missing; see omnirange run"),
        (("run", "paper", "--out"), "--out: must be followed by DIR; see omnirange run"),
        (("run", "paper", "--out", "--dry-run"), "--out: must be followed by DIR; see omnirange run"),
        (
            ("run", "paper", "--out", "-new"),
            "--out: must be followed by DIR; one that begins with a dash is written --out=-new; see omnirange run",
        ),
        (("run", "paper", "--dry-run=1"), "--dry-run: takes no value; found '1'; see omnirange run"),
        (
            ("run", "--", "paper", "--dry-run"),
            "'--dry-run' is behind --, after which nothing is an option; see omnirange run",
        ),
        (("run", "--", "paper", "-3"), "'-3' is one argument too many; see omnirange run"),
        (("run", ""), "EXPERIMENT: must not be empty; see omnirange run"),
        ((*PAIR[:-1], ""), "--out: must not be empty; see omnirange range"),
        (("cache", "clear"), "'clear' is one argument too many; did you mean '--clear'? See omnirange cache"),
        (("design", "--at"), "--at: must be followed by one M or more; see omnirange design"),
        (("--foo",), "unknown option '--foo'; see omnirange"),
        (("--set", "a=1"), "unknown option '--set'; a command's options follow its name; see omnirange"),
        (("--sot=1", "run"), "unknown option '--sot'; a command's options follow its name; see omnirange"),
        (("rn", "--foo"), "unknown command 'rn'; did you mean 'run'? See omnirange"),
        (("range", "a.png", "--basline"), "unknown option '--basline'; did you mean '--baseline'? See omnirange range"),
        (("run", "--dryrun"), "unknown option '--dryrun'; did you mean '--dry-run'? See omnirange run"),
        (
            ("render", "box", "--att", "-1", "0", "1"),
            "unknown option '--att'; did you mean '--at'? See omnirange render",
        ),
        (("render", "box", "--at", "-1", "-inf", "-.3"), "--out: missing; see omnirange render"),
    ],
)
def test_a_slip_of_the_command_line(arguments, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert capsys.readouterr() == ("", f"omnirange: {said} --help\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--baseline", "nan", "0", "0"], "--baseline: must be a finite number; found nan"),
        (["--baseline", "1", "0", "0", "--rotation-deg", "0", "inf", "0"], "--rotation-deg: must be a finite number"),
        (["--pose", "{}"], "{}: is not a regular file; give a pose file"),
        (["--pose", "{}", "--pose", "{}"], "{}: is not a regular file; give a pose file"),
        (["--pose", "{}/cut.toml"], "{}/cut.toml: not valid TOML: "),
    ],
)
def test_what_is_wrong_with_a_motion_that_is_given(words, said, tmp_path, capsys):
    (tmp_path / "cut.toml").write_text("position_m = [\n    0.0,\n")
    given = [each.format(tmp_path) for each in words]
    assert main(["range", "a.png", "b.png", "--sensor", "mirror", *given, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {said.format(tmp_path)}")


def test_a_sensors_file_is_blamed_for_its_own_keys(tmp_path, capsys):
    file = tmp_path / "pose.toml"
    file.write_text("position_m = [0.0, 0.0, 1.0]\n")
    out = str(tmp_path / "out")
    assert main(["render", "box", "--at", "0", "0", "1", "--sensor", str(file), "--out", out]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {file}: position_m: unknown key 'position_m'; valid: camera")


def test_a_folder_that_is_none_is_called_so(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for name, said in (("none", "no such folder"), ("file", "is no folder")):
        assert main(["report", str(tmp_path / name)]) == 2
        assert capsys.readouterr().err == f"omnirange: {tmp_path / name}: {said}; give the output folder of a run\n"
