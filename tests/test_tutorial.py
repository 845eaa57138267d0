"""docs/matchers.md does what it says: its files are those of docs/examples, its commands run, and its code is short."""

import ast
import csv
import re
import shlex
import shutil
import sys
from importlib import metadata
from pathlib import Path

import pytest

from harness.cli import main
from harness.testing.conformity import CHECKS

pytest_plugins = "pytester"
ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "docs" / "examples"
PAGE = (ROOT / "docs" / "matchers.md").read_text(encoding="utf-8")

FILES = dict(re.findall(r"^`([\w.]+)`:\n\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
COMMANDS = [
    line for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL) for line in block.splitlines()
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The page's files in a folder of their own, which is the current one."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    return tmp_path


def command(beginning: str) -> list[str]:
    (line,) = (line for line in COMMANDS if line.startswith(beginning))
    return shlex.split(line)[1:]


def table(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_the_page_shows_the_examples() -> None:
    assert {path.name: path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.*")} == FILES


def test_a_matcher_is_less_than_thirty_lines() -> None:
    """Without blank lines and docstrings."""
    tree = ast.parse(FILES["plane_sweep.py"])
    documented = [node for node in ast.walk(tree) if isinstance(node, ast.Module | ast.FunctionDef)]
    words = {
        line
        for node in documented
        if ast.get_docstring(node)
        for line in range(node.body[0].lineno, node.body[0].end_lineno + 1)
    }
    lines = FILES["plane_sweep.py"].splitlines()
    code = [line for number, line in enumerate(lines, 1) if line.strip() and number not in words]
    assert 10 < len(code) < 30


def test_every_command_is_tried_here() -> None:
    tried = (
        "omnirange check plane_sweep:match",
        "omnirange run beside",
        "omnirange run smoke",
        "omnirange check block_match:match",
        "omnirange run program",
    )
    assert [next(each for each in tried if line.startswith(each)) for line in COMMANDS] == list(tried)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_check_says_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command("omnirange check plane_sweep")) == 0
    said = capsys.readouterr().out
    shown = re.search(r"^```text\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL).group(1)
    assert len(shown.splitlines()) == len(CHECKS) + 1
    # Figures may differ in their last digit on another machine.
    assert re.sub(r"\d+\.\d+", "#", said) == re.sub(r"\d+\.\d+", "#", shown)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_matcher_of_rectified_images_passes_every_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command("omnirange check block_match")) == 0
    said = capsys.readouterr().out
    assert "disparity_px, confidence on a rectified image of 360 x 180 pixels" in said
    # It searches along epipolar curves in steps of a column, with a parabola: better than half a column in a box.
    assert float(re.search(r"median error (\S+) columns", said).group(1)) < 0.5


@pytest.mark.slow
def test_scored_beside_others(folder: Path) -> None:
    assert main([*command("omnirange run beside"), "--no-report"]) == 0
    rows = table(folder / "results" / "beside" / "trials.csv")
    assert [(row["matching.kind"], row["state"]) for row in rows] == [
        ("window", "done"),
        ("column", "done"),
        ("plane_sweep:match", "done"),
    ]
    errors = {row["matching.kind"]: float(row["disparity_median_abs_px"]) for row in rows}
    assert errors["plane_sweep:match"] < 1.0
    assert len(set(errors.values())) == 3


@pytest.mark.slow
def test_parameters_as_axes(folder: Path) -> None:
    assert main([*command("omnirange run smoke"), "--no-report"]) == 0
    rows = table(folder / "results" / "windows" / "trials.csv")
    assert len(rows) == 16
    assert {row["matching.parameters.window"] for row in rows} == {"5", "9"}
    assert not {"matching.window_px", "matching.subpixel"} & rows[0].keys()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("python3") is None, reason="the page's program is started with python3")
def test_as_a_program(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")  # the python3 that has NumPy and SciPy
    assert main([*command("omnirange run program"), "--no-report"]) == 0
    function, program = (
        float(row["disparity_median_abs_px"]) for row in table(folder / "results" / "program" / "trials.csv")
    )
    # The same sweep without the filter, on images of the same brightness: neither is twice as good as the other.
    assert 0.5 < program / function < 2


@pytest.mark.slow
def test_the_tests_of_the_page(folder: Path, pytester: pytest.Pytester) -> None:
    shutil.copy(folder / "test_plane_sweep.py", pytester.path)
    installed = any(each.value == "omnirange_pytest" for each in metadata.entry_points(group="pytest11"))
    plugin = [] if installed else ["-p", "omnirange_pytest"]
    pytester.runpytest_inprocess(*plugin, "-p", "no:cacheprovider").assert_outcomes(passed=len(CHECKS))
