"""What is given twice, under one name or two, is refused: which of the two holds would be anybody's guess."""

import pytest

from harness.cli import main
from harness.errors import InputError
from harness.runs.load import load_experiment, load_matcher
from harness.runs.photograph_settings import own_settings


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "smoke", "--dry-run", "--set", "seed=1", "--set", "seed = 2"),
        ("check", "slanted", "--set", "seed=1", "--set", "seed=1"),
        ("dataset", "rooms", "--out", "o", "--set", "seed=1", "--set", "seed=2"),
    ],
)
def test_a_key_that_is_set_twice(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert capsys.readouterr().err == "omnirange: --set: seed: is given twice; leave one out\n"


def test_a_setting_of_photographs_that_is_given_twice():
    with pytest.raises(InputError, match=r"^--set: window_px: is given twice; leave one out$"):
        own_settings("window", ["window_px=7", "window_px=9"])
    with pytest.raises(InputError, match=r"^--set: matching\.window_px: is given as window_px too; leave one out$"):
        own_settings("window", ["window_px=7", "matching.window_px=9"])


@pytest.mark.parametrize(
    ("kind", "setting", "said"),
    [
        ("sgmm", [], r"^--matcher: 'sgmm' is neither a matcher nor"),
        ("", ["kind=sgmm"], r"^--set: kind: 'sgmm' is neither a matcher nor"),
        ("sgm", ["foo=1"], r"^--set: foo: unknown key 'foo'; valid: "),
        ("sgm", ["panorama=1"], r"^--set: panorama: is a table; write panorama\.KEY=VALUE$"),
        ("sgm", ["panorama.width_px=1"], r"^--set: panorama\.width_px: must be at least 16; found 1$"),
        ("window", ["window_px=8"], r"^--matcher, --set: matching: window_px must be odd"),
    ],
)
def test_a_setting_of_photographs_names_its_option(kind, setting, said):
    with pytest.raises(InputError, match=said):
        own_settings(kind, setting)


def test_a_matcher_that_two_options_name():
    with pytest.raises(InputError, match=r"^--set: kind: is given as --matcher too; leave one out$"):
        own_settings("sgm", ["kind=slanted"])
    assert own_settings("", ["kind=sgm"]).matching.kind == "sgm"


def test_the_matcher_that_is_named_is_the_one_that_is_checked():
    with pytest.raises(InputError, match=r"^--set: matching\.kind: the matcher is given already: slanted; leave this"):
        load_matcher("slanted", ["matching.kind=column"])


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("window_px=7", r"^--set: window_px: must begin with 'matching\.', such as matching\.window_px=7$"),
        ("matching.window_px=x", r"^--set: matching\.window_px: must be a whole number; found 'x'$"),
    ],
)
def test_a_checked_matchers_setting_names_its_option(setting, said):
    with pytest.raises(InputError, match=said):
        load_matcher("window", [setting])


@pytest.mark.parametrize(
    ("setting", "axis", "said"),
    [
        ("seed=3", "seed=1,2", "3 is none of the values of --axis seed; add it there, or leave one out"),
        (
            "view_2.baseline_m=1",
            "view_2={baseline_m=2},{baseline_m=3}",
            "is replaced by each value of --axis view_2; write it there",
        ),
    ],
)
def test_a_setting_that_an_axis_makes_void(setting, axis, said, capsys):
    assert main(["run", "smoke", "--dry-run", "--set", setting, "--axis", axis]) == 2
    assert capsys.readouterr().err == f"omnirange: --set: {setting.partition('=')[0]}: {said}\n"


def test_a_setting_that_is_one_of_an_axiss_values_is_that_of_the_base_trial():
    for sets, axes in ((["seed=2.0"], ["seed=1,2"]), ({"seed": 2}, {"seed": (1, 2)})):
        experiment = load_experiment("smoke", sets=sets, axes=axes)
        assert experiment.trial.seed == 2
        assert {each.trial.seed for each in experiment.planned} == {1, 2}
    assert load_experiment("smoke", sets=["scene=box"], axes=["scene=room,box"]).trial.scene.name == "box"


@pytest.mark.parametrize("option", [("--out", "a", "--out=b"), ("--workers", "1", "--out", "a", "--workers", "2")])
def test_an_option_that_is_given_twice(option, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["run", "smoke", *option])
    said = f"omnirange: {option[0]}: is given twice; leave one out; see omnirange run --help\n"
    assert capsys.readouterr().err == said
