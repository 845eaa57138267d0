"""The documentation's own machinery: formulas that show without the network, and numbers that are computed."""

import doctest
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, visit

import harness
from harness.cli import main
from harness.geometry.triangulation import paper_law, range_from_angles, sensitivity_to_alpha_2

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"

PAGE = r"""# Page

Inline $\alpha_2$ in a line.

$$
\frac{d_2^2}{|t|\,\sin\alpha_1}
$$ (eq-law)

See {eq}`eq-law`.
"""
CONF = f"""
import sys
sys.path.insert(0, {str(DOCS / "_extensions")!r})
extensions = ["myst_parser", "offline_math"]
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "svg"
html_theme = "basic"
"""


@pytest.mark.slow
@pytest.mark.browser
def test_formulas_show_without_scripts_or_network(tmp_path: Path) -> None:
    (tmp_path / "conf.py").write_text(CONF, encoding="utf-8")
    (tmp_path / "index.md").write_text(PAGE, encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", str(tmp_path), str(tmp_path / "html")]
    subprocess.run(command, check=True, timeout=120)
    page = tmp_path / "html" / "index.html"
    with chromium(tmp_path / "profile", scripts=False) as context:
        visited = visit(context, page, width=800)
        assert not [each for each in visited.requests if not each.startswith("file:")]
        formulas = visited.page.locator("svg[role=img]")
        assert formulas.count() == 2
        # TeX for screen readers, and ink: glyphs of a size that is like the text's.
        assert [formulas.nth(i).get_attribute("aria-label") for i in (0, 1)] == [
            r"\alpha_2",
            r"\frac{d_2^2}{|t|\,\sin\alpha_1}",
        ]
        inline, block = (formulas.nth(i).bounding_box() for i in (0, 1))
        line = visited.page.locator("p").first.bounding_box()
        assert 0.3 * line["height"] < inline["height"] < 1.1 * line["height"]
        assert block["height"] > 1.5 * inline["height"]
        assert visited.page.locator("svg path").count() > 5
        assert visited.page.locator(".formula-block .eqno").inner_text() == "(1)"


def test_the_theory_page_compares_the_laws_rightly() -> None:
    page = (DOCS / "theory.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+)° \| ([\d.]+) m \| ([\d.]+) m \|$", page, re.MULTILINE)
    assert len(rows) == 3
    baseline_m, range_m = 0.5, 3.0  # the page's
    for degrees, exact, short in rows:
        alpha_1 = np.radians(float(degrees))
        point = range_m * np.array([np.cos(alpha_1), np.sin(alpha_1)])
        alpha_2 = np.arctan2(point[1], point[0] - baseline_m)
        law = abs(sensitivity_to_alpha_2(alpha_1, alpha_2, baseline_m)) * np.radians(1)
        # The page has three decimals.
        assert float(exact) == pytest.approx(law, abs=5e-4)
        assert float(short) == pytest.approx(paper_law(range_m, baseline_m) * np.radians(1), abs=5e-4)


def python_blocks(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/quick-start.md"])
@pytest.mark.usefixtures("undrawn")
def test_python_on_a_page_gives_what_the_page_shows(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = python_blocks(page)
    sessions = "\n".join(block for block in blocks if block.startswith(">>>"))
    test = doctest.DocTestParser().get_doctest(sessions, {}, page, page, 0)
    complaints: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=complaints.append)
    assert test.examples
    assert not complaints
    for block in blocks:
        if not block.startswith(">>>"):
            exec(compile(block, page, "exec"), {})


def test_the_api_page_has_every_public_name() -> None:
    page = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"auto(?:function|class|exception):: harness\.(\w+)$", page, re.MULTILINE))
    assert named == set(harness.__all__) - {"__version__"}


def test_the_drawing_shows_the_geometry_of_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    import make_concepts as drawing

    point = drawing.towards(drawing.ALPHA_1, drawing.RANGE_1)
    # Both rays meet in p, and the wrong one meets ray 1 where the program would put the point: three roundings each.
    assert point == pytest.approx(drawing.V2 + drawing.towards(drawing.ALPHA_2, drawing.RANGE_2), abs=1e-14)
    for alpha_2, drawn in ((drawing.ALPHA_2, drawing.RANGE_1), (drawing.ALPHA_2 - drawing.ERROR, drawing.RANGE_1_OFF)):
        assert drawn == pytest.approx(float(range_from_angles(drawing.ALPHA_1, alpha_2, 1.0)), rel=1e-14)
    # x_1 is on the cylinder, in the epipolar plane and in the direction of p.
    x_1 = drawing.on_cylinder(drawing.ALPHA_1)
    assert np.hypot(x_1[0], x_1[1]) == pytest.approx(drawing.RADIUS, rel=1e-14)
    assert np.cross(x_1, point) == pytest.approx(np.zeros(3), abs=1e-14)


def test_the_command_line_page_has_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    commands = re.findall(r"^    ([a-z]+)(?: |$)", capsys.readouterr().out, re.MULTILINE)
    page = (DOCS / "reference" / "command-line.md").read_text(encoding="utf-8")
    assert sorted(commands) == sorted(re.findall(r"^## (\w+)$", page, re.MULTILINE))
    assert len(commands) > 5
