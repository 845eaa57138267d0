"""Third-party matchers: how they are found, and refused before a run."""

from pathlib import Path

import pytest
from plugin_modules import FAR, Write
from sweeps import write_small

from harness.cli import main
from harness.errors import InputError
from harness.matching import plugins, registry
from harness.matching.registry import Plugin
from harness.runs.load import load_experiment, load_matcher


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    assert (code, said.out, said.err.count("\n")) == (2, "", 1)
    return said.err.removeprefix("omnirange: ").strip()


# --- Found, or refused before anything is run ---------------------------------------------------------------------


@pytest.mark.slow
def test_chosen_in_any_experiment_with_parameters_as_axes(module: Write) -> None:
    """The paper's axes over window settings go: another matcher has none."""
    name = module(FAR)
    experiment = load_experiment("paper", sets=[f"matching.kind={name}:match"], axes=["matching.parameters.window=5,7"])
    assert [key for key in experiment.axes if key.startswith("matching.")] == ["matching.parameters.window"]
    windows = [each.coordinates["matching.parameters.window"] for each in experiment.planned]
    assert {window: windows.count(window) for window in (5, 7)} == {5: 12, 7: 12}  # a trial for each of 12 seeds
    matcher = experiment.planned[-1].trial.matching
    assert isinstance(matcher, Plugin)
    assert (matcher.kind, matcher.parameters, matcher.d_max_m) == (f"{name}:match", {"window": 7}, 10.0)


def test_what_the_next_matcher_knows_is_carried_over(module: Write) -> None:
    one = module(FAR)
    other = module("def match(pair, limits, *, share): ...")
    table = {"kind": f"{one}:match", "d_min_m": 2.0, "parameters": {"window": 3, "share": 0.5}}
    assert registry.carried_over(table, f"{other}:match") == {
        "kind": f"{other}:match",
        "d_min_m": 2.0,
        "parameters": {"share": 0.5},
    }
    assert registry.carried_over(table, "window") == {"kind": "window", "d_min_m": 2.0}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            ["matching.kind=windw"],
            "--set: matching.kind: 'windw' is neither a matcher nor written package.module:functi",
        ),
        (["matching.kind=no_such:f"], "--set: matching.kind: no_such:f: there is no module no_such, neither installed"),
        (["matching.kind={name}:mach"], "--set: matching.kind: {name}:mach: the module {name} ("),
        (["matching.kind={name}:np"], "--set: matching.kind: {name}:np: is a module, not a function"),
        (
            ["matching.kind={name}:match", "matching.parameters.windw=3"],
            "--set: matching.parameters.windw: {name}:match takes no parameter 'windw'; did you mean 'window'?",
        ),
        (
            ["matching.kind={name}:one_argument"],
            "--set: matching.kind: {name}:one_argument must take (pair, limits, **par",
        ),
        (
            ["matching.kind={name}:demanding"],
            "--set: matching.parameters: {name}:demanding needs the parameter 'a",
        ),
        (
            ["matching.kind={name}:demanding", "matching.parameters.a_file=none.bin"],
            "--set: matching.parameters.a_file: no such file: ",
        ),
    ],
)
def test_refused_before_a_run(
    settings: list[str], said: str, module: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = module(FAR + "def one_argument(pair): ...\ndef demanding(pair, limits, a_file): ...\n")
    small = write_small(tmp_path / "small.toml")
    arguments = [part for each in settings for part in ("--set", each.format(name=name))]
    line = refusal(capsys, "run", small, "--out", tmp_path / "out", *arguments)
    assert line.startswith(said.format(name=name, small=small))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("rest", "where"),
    [
        ('[trial.matching]\nkind = "absent:f"', "{file}: trial.matching.kind: absent:f: there is no module absent"),
        (
            '[axes]\n"matching.kind" = ["window", "absent:f"]',
            "{file}: axes.matching.kind: absent:f: there is no module",
        ),
        (
            '[[cases]]\nname = "a"\n"matching.kind" = "absent:f"',
            "{file}: cases[0].matching.kind: absent:f: there is no module abse",
        ),
    ],
)
def test_the_place_in_the_file_is_named(
    rest: str, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_small(tmp_path / "small.toml", rest)
    assert refusal(capsys, "run", file, "--out", tmp_path / "out").startswith(where.format(file=file))


def test_an_axis_is_named(module: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, file = module(FAR), write_small(tmp_path / "small.toml")
    chosen = ["--set", f"matching.kind={name}:match", "--axis", "matching.parameters.windw=3,5"]
    line = refusal(capsys, "run", file, "--out", tmp_path / "out", *chosen)
    assert line.startswith(f"--axis: matching.parameters.windw: {name}:match takes no parameter 'windw'")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("import not_there_at_all", "needs not_there_at_all, which is not installed"),
        ("1 / 0", "fails: ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", "fails: SystemExit: 3"),
        ("def f(:", "fails: SyntaxError: invalid syntax"),
    ],
)
def test_a_module_that_cannot_be_loaded(source: str, said: str, module: Write) -> None:
    name = module(source)
    with pytest.raises(InputError) as caught:
        plugins.find(f"{name}:f")
    assert said in str(caught.value)


def test_the_running_script_is_no_module() -> None:
    with pytest.raises(InputError, match="must be in an importable module"):
        plugins.find("__main__:f")


def test_functions_that_do_not_say_what_they_take(module: Write) -> None:
    name = module(
        "def anything(*given, **more): ...\nclass Caller:\n    def __call__(self, pair, limits, a=1): ...\nc = Caller()"
    )
    plugins.check(f"{name}:anything", {"whatever": 1})
    plugins.check(f"{name}:c", {"a": 1})
    with pytest.raises(InputError, match="takes no parameter 'b'"):
        plugins.check(f"{name}:c", {"b": 1})


def test_settings_are_told_apart_by_their_parameters() -> None:
    one = Plugin(kind="a:f", parameters={"x": 1, "y": [1, {"z": "w"}]})
    same = Plugin(kind="a:f", parameters={"y": [1, {"z": "w"}], "x": 1})
    assert one == same
    assert hash(one) == hash(same)
    assert one != Plugin(kind="a:f", parameters={"x": 2})


def test_entry_points_of_installed_packages(module: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint

    name = module(FAR)
    offered = {"sweep": EntryPoint("sweep", f"{name}:match", plugins.ENTRY_POINTS)}
    monkeypatch.setattr(plugins, "entry_points", lambda: offered)
    assert load_matcher("sweep", parameters={"window": 3}) == Plugin(kind="sweep", parameters={"window": 3})
    assert plugins.digest("sweep", {}) == plugins.digest(f"{name}:match", {})
    with pytest.raises(InputError, match="did you mean 'sweep'"):
        load_matcher("sweeb")
