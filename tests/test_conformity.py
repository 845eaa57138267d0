"""The checks for matchers: those of this program pass, every check is broken by a matcher that deserves it, and the
command and the pytest fixture say so."""

import importlib.util
import io
import itertools
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from harness import shipped
from harness.cli import main
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.matching import registry
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import SecondView, Trial
from harness.pipeline.trial import run_trial
from harness.runs.load import load_matcher
from harness.simulation.scene import load_scene
from harness.testing.conformity import CHECKS, Finding, Subject, conformity, examine
from harness.testing.pairs import GRID, quarter_turn, scenery

pytest_plugins = "pytester"
ROOT = Path(__file__).parent.parent

KINDS = [kind for kind in registry.BUILT_IN if kind != "program"]
"""A program is what its command makes of it."""

MATCHER = """
import numpy as np
import plane_sweep

calls = []


def match(pair, limits):
    alpha_2, confidence = plane_sweep.match(pair, limits, steps=32)
    {change}
    return alpha_2, confidence
"""

Write = Callable[..., str]
names = (f"candidate_{number}" for number in itertools.count())


@pytest.fixture
def candidate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes a matcher, the tutorial's with something changed, and gives its kind."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "examples")
    monkeypatch.syspath_prepend(tmp_path)

    def write(change: str = "pass", folder: Path = tmp_path) -> str:
        name = next(names)
        lines = "\n    ".join(change.strip().split("\n"))
        (folder / f"{name}.py").write_text(MATCHER.format(change=lines), encoding="utf-8")
        return f"{name}:match"

    return write


def finding(kind: str, name: str) -> Finding:
    return examine(Subject(load_matcher(kind)), next(check for check in CHECKS if check.name == name))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_matcher_of_this_program_passes(kind: str) -> None:
    if kind.startswith("opencv") and importlib.util.find_spec("cv2") is None:
        pytest.skip("needs OpenCV")
    broken = [f"{each.check.name}: {each.text}" for each in conformity(load_matcher(kind)) if not each.passed]
    assert not broken


def test_a_quarter_turn_is_the_rig_turned_by_a_quarter() -> None:
    """Against a rendering of the turned rig, whose rays differ in their last digits."""
    still = scenery().pair
    turned = quarter_turn(still)
    scene = load_scene(str(shipped.find("scenes", "box")))
    view_1, view_2 = Pose(position_m=(0.0, 0.0, 1.0), yaw_deg=-90), SecondView(yaw_deg=-90)
    rendered = run_trial(Trial(scene=scene, sensor=still.sensor, panorama=GRID, view_1=view_1, view_2=view_2)).pair
    np.testing.assert_allclose(turned.t_v1, rendered.t_v1, atol=1e-15)
    np.testing.assert_allclose(turned.motion.R_v2_from_v1, rendered.motion.R_v2_from_v1, atol=1e-15)
    for one, other in zip(turned.images, rendered.images, strict=True):
        # A ray may fall to the other side of an edge, a sixteenth of a pixel.
        assert np.mean(np.abs(one - other) > 0.01) < 0.001
    before, after = (pair.panoramas()[0].values for pair in (still, turned))
    # Positions differ by 1e-13 px and greys of single precision by 1e-5.
    np.testing.assert_allclose(np.roll(before, GRID.width_px // 4, axis=1), after, atol=1e-4)


BAD = {
    "answers": ("return 3", "it returned int"),
    "shape": ("return alpha_2[1:]", "(66, 240); it has (65, 240)"),
    "dtype": ("return alpha_2 > 1", "its dtype is bool"),
    "angles": ("return np.degrees(alpha_2)", "alpha_2 must lie within 0 .. pi"),
    "mixed-up": (
        "return pair.answer(range_m=np.where(alpha_2 > 0, alpha_2, np.nan))",
        "range_m looks like alpha_2 in radians: are these metres? Then answer(alpha_2=...) says so",
    ),
    "missing": ("alpha_2[:] = np.nan", "confidence must be NaN where there is no match"),
    "repeats": (
        "calls.append(1)\nalpha_2 += 1e-9 * len(calls)",
        "called again, it returns a different alpha_2 at 15840 of 15840",
    ),
    "memory": (
        "calls.append(pair.motion.R_v2_from_v1.tobytes())\nalpha_2 += 1e-9 * len(set(calls))",
        "after another pair, it returns a different alpha_2",
    ),
    "threads": (
        "confidence *= pair.available_threads",
        "with 2 threads instead of 1, it returns a different confidence",
    ),
    "inputs": (
        "image = pair.images[1].base\nimage.flags.writeable = True\nimage[3, 4] += 1",
        "it has changed image 2, which other matchers get too",
    ),
    "grids": (
        "alpha_2 = np.resize(alpha_2, (66, 240))\nreturn alpha_2",
        "on a panorama of 30 rows and 96 columns: alpha_2 must have the panorama's shape (30, 96)",
    ),
    "baselines": ("alpha_2 / (1 // int(abs(pair.t_v1[2]) < 0.4))", "with the second view straight up: "),
    "limits": (
        "return plane_sweep.match(pair, limits.model_copy(update={'d_min_m': 1, 'd_max_m': 10}), steps=32)",
        "asked for 2 to 3 m, ",
    ),
    "seam": (
        "alpha_2[:, :10] = confidence[:, :10] = np.nan",
        "8.3% of pixels get another result (at most 2% may), most o",
    ),
    "one-image": (
        "alpha_2 = pair.alpha_1 + 0.2 * np.sin(pair.alpha_1)",
        "of the more confident half of its matches, 100.0% have a dis",
    ),
    "blank": (
        "if pair.images[0].max() == 128:\n    return pair.alpha_1 + 0.2 * np.sin(pair.alpha_1), confidence + 1000",
        "it reports something nearer than d_max_m (at most 10% may), and is more confident there than for the least",
    ),
    "easy": ("alpha_2 -= pair.alpha_1", "; it looks like the disparity alpha_2 - alpha_1"),
    "turned": (
        "if pair.motion.R_v2_from_v1[0, 0] < 1:\n    alpha_2 = np.pi - alpha_2",
        "it looks like the angle to -t",
    ),
    "sensors": ("pair.sensor", "the views have different sensors"),
}


def test_every_check_is_tried() -> None:
    assert list(BAD) == [check.name for check in CHECKS]


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_matcher_that_breaks_it(name: str, candidate: Write) -> None:
    change, said = BAD[name]
    result = finding(candidate(change), name)
    assert result.passed is False
    assert said in result.text


def test_nothing_else_is_looked_at_without_an_answer(candidate: Write) -> None:
    result = list(conformity(load_matcher(candidate("raise KeyError('x')"))))
    assert [each.passed for each in result] == [False] + [None] * (len(CHECKS) - 1)
    assert "fails: KeyError: 'x' (" in result[0].text
    assert {each.text for each in result[1:]} == {"not tested: it returns no result"}


def test_a_blank_answer_without_confidence(candidate: Write) -> None:
    result = finding(candidate("return pair.alpha_1 + 0.2 * np.sin(pair.alpha_1)"), "blank")
    assert "and gives no confidence that would mark them" in result.text


# --- omnirange check ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command(candidate: Write, capsys: pytest.CaptureFixture[str]) -> None:
    kind = candidate()
    assert main(["check", kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[0] for line in lines[:-1]] == ["✓"] * len(CHECKS)
    assert all(check.title in line for check, line in zip(CHECKS, lines, strict=False))
    assert lines[-1] == f"{kind}: all {len(CHECKS)} checks passed"


def test_the_command_with_something_broken(candidate: Write, capsys: pytest.CaptureFixture[str]) -> None:
    kind = candidate("return alpha_2[1:]")
    assert main(["check", kind]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line[0] for line in lines[:3]] == ["✓", "✗", "✓"]
    assert {line[0] for line in lines[3:-1]} == {"-"}
    assert lines[-1] == f"{kind}: 2 of {len(CHECKS)} checks passed"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["absent:match"], "matching.kind: absent:match: there is no module absent"),
        (["pkg.mine.py:match"], "matching.kind: pkg.mine.py:match: a module is named without .py: pkg.mine:match"),
        (["./mine.py"], "matching.kind: './mine.py' is a file; write its module and function: mine:match"),
        (
            ["windw"],
            "matching.kind: 'windw' is neither a matcher nor written package.module:function; did you mean 'win",
        ),
        (["absent.toml"], "absent.toml: no such file"),
        (
            ["window", "--set", "matching.windw=1"],
            "--set: matching.windw: unknown key 'windw'; did you mean 'window_px'?",
        ),
        (["window", "--set", "matching.window_px"], "--set: must be written key=value; found 'matching.window_px'"),
    ],
)
def test_a_matcher_that_cannot_be_found(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"omnirange: {said}")
    assert printed.err.count("\n") == 1


@pytest.mark.parametrize("table", ["matching", "trial.matching"])
def test_a_matcher_from_a_file(table: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'[{table}]\nkind = "column"\nwindow_px = 7\n')
    matcher = load_matcher(str(file), ["matching.d_min_m=0.5"])
    assert matcher == WindowMatcher(kind="column", window_px=7, d_min_m=0.5)
    file.write_text("[trial]\nseed = 1\n")
    with pytest.raises(InputError, match=r"mine.toml: has no table \[matching\], nor \[trial.matching\]"):
        load_matcher(str(file))


def test_marks_where_the_terminal_knows_letters_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    from harness.cli.check import marks

    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert "".join(marks().values()).isascii()


# --- The fixture --------------------------------------------------------------------------------------------------


def plugin() -> list[str]:
    """Its name for pytest, unless it is installed so that pytest finds it."""
    result = metadata.entry_points(group="pytest11")
    return [] if any(each.value == "omnirange_pytest" for each in result) else ["-p", "omnirange_pytest"]


def run_suite(pytester: pytest.Pytester, call: str) -> pytest.RunResult:
    pytester.makepyfile(f"def test_mine(omnirange_check):\n    omnirange_check({call})\n")
    return pytester.runpytest_inprocess(*plugin(), "-p", "no:cacheprovider", "-rs")


@pytest.mark.slow
def test_a_test_for_every_check(pytester: pytest.Pytester, candidate: Write) -> None:
    result = run_suite(pytester, f"{candidate('alpha_2[:, :10] = confidence[:, :10] = np.nan')!r}")
    result.assert_outcomes(passed=len(CHECKS) - 1, failed=1)
    result.stdout.fnmatch_lines(["*test_mine?seam?*", "*: is periodic in azimuth: with the whole rig turned by*"])


@pytest.mark.slow
def test_what_was_not_reached_is_skipped(pytester: pytest.Pytester, candidate: Write) -> None:
    result = run_suite(pytester, f"{candidate('return 3')!r}")
    result.assert_outcomes(failed=1, skipped=len(CHECKS) - 1)


def test_parameters_that_a_matcher_does_not_take(pytester: pytest.Pytester, candidate: Write) -> None:
    kind = candidate()
    result = run_suite(pytester, f"{kind!r}, window=5")
    result.assert_outcomes(failed=len(CHECKS))
    result.stdout.fnmatch_lines([f"matching.parameters.window: {kind} takes no parameter 'window'; *"])


def test_other_suites_pay_nothing(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        "import sys\ndef test_other():\n    assert not {'numpy', 'pydantic', 'numba'} & set(sys.modules)\n"
    )
    options = ["-m", "pytest", *plugin(), "-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-q"]
    done = subprocess.run([sys.executable, *options], cwd=pytester.path, capture_output=True, text=True, check=False)
    assert "1 passed" in done.stdout, done.stdout


def test_pytest_finds_it_in_an_installed_program() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["pytest11"] == {"omnirange": "omnirange_pytest"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["package", "module"])
def test_suites_beside_a_package_of_the_same_name_run(pytester: pytest.Pytester, kind: str) -> None:
    """A folder `harness` of another project comes first on the path; only who asks for the fixture is told."""
    if kind == "package":
        pytester.mkpydir("harness")
    else:
        pytester.makepyfile(harness="")
    pytester.makepyfile(
        test_other="def test_other():\n    pass\n", test_mine="def test_mine(omnirange_check):\n    pass\n"
    )
    paths = os.pathsep.join([str(pytester.path), str(ROOT)])
    line = [sys.executable, "-m", "pytest", "-p", "omnirange_pytest", "-p", "no:cacheprovider", "-q"]
    environment = os.environ | {"PYTHONPATH": paths, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    for file, code, says in (("test_other.py", 0, "1 passed"), ("test_mine.py", 2, "hides omnirange's package")):
        done = subprocess.run(
            [*line, file], cwd=pytester.path, env=environment, capture_output=True, text=True, check=False
        )
        assert says in done.stdout + done.stderr
        assert (done.returncode == 0) == (code == 0)
