"""The report where something goes wrong late: names that look like markup, settings of others, a figure that fails."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from test_report import SMALL, Document, run_small

from harness.cli.parser import main
from harness.report import images, theme
from harness.report.build import build_report
from harness.runs.run import Result

HOSTILE = ("$\\frac{$", "b$$c", "$x$ [/b] <i>", "\\$", "50 $")


@pytest.fixture(scope="module")
def named() -> Result:
    """Trials whose names on an axis look like mathematics and markup."""
    return run_small(axes={"scene.name": list(HOSTILE), "matching.subpixel": ["parabola"]})


@pytest.fixture(scope="module")
def page(named: Result) -> str:
    failures: list[str] = []
    html = build_report(named, failures)
    assert failures == []
    return html


def toml(folder: Path, **settings: Any) -> Path:
    """A file with a small experiment."""
    import tomli_w

    file = folder / "small.toml"
    file.write_text(tomli_w.dumps({"name": "small", "trial": {"scene": "box", **SMALL} | settings}), encoding="utf-8")
    return file


# --- Names --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_names_are_drawn_as_they_are(page):
    text = Document(page).text
    assert all(name in text for name in HOSTILE)


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_is_mathematics(name):
    with theme.style():
        fig = theme.figure(100, 100)
        drawn = fig.text(0, 0, theme.plain(name))
        shown, is_mathematics = drawn._preprocess_math(drawn.get_text())
        assert (shown, is_mathematics) == (name, False)


def test_a_name_beside_mathematics_of_our_own_stays_a_name():
    with theme.style():
        fig = theme.figure(200, 100)
        fig.text(0, 0, theme.plain("5 $ and 6 $") + r" against $\alpha_1$")
        assert theme.picture(fig, "").source


# --- Figures that fail --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_figure_that_fails_says_so_in_its_place_and_costs_no_other(monkeypatch, tmp_path, capsys):
    def broken(*_):
        raise ZeroDivisionError("the <b>scene</b> has\nno middle")

    monkeypatch.setattr(images, "_overview_image", broken)
    assert main(["run", str(toml(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    reason = "ZeroDivisionError: the <b>scene</b> has no middle"
    assert said.count("\n") == 1
    assert f"images.environment: {reason}" in said
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    document = Document(html)
    assert f"Could not be drawn: {reason}" in document.text
    assert len(list(document.every("img"))) >= 12
    assert re.search(r'<figure id="figure-environment">(?:(?!</figure>).)*Could not be drawn', html, re.DOTALL)


def test_outside_a_page_the_error_is_raised(named, monkeypatch):
    monkeypatch.setattr(images, "panorama_axes", None)
    with pytest.raises(TypeError):
        images.panorama(named.outcomes[0])


def test_tables_and_summary_are_there_when_the_report_fails(monkeypatch, tmp_path):
    from harness.report import build

    def broken(*_):
        raise RuntimeError("a bug")

    monkeypatch.setattr(build, "build_report", broken)
    out = tmp_path / "out"
    with pytest.raises(RuntimeError):
        main(["run", str(toml(tmp_path)), "--out", str(out), "--debug"])
    written = {"trials.csv", "timings.csv", "experiment.toml", "summary.json", "environment.json"}
    assert written <= {path.name for path in out.iterdir()}


# --- matplotlib's settings ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_settings_of_others_change_no_figure(named, page):
    others = {
        "image.origin": "lower",
        "image.cmap": "jet",
        "text.usetex": True,
        "svg.fonttype": "none",
        "axes.grid": True,
        "text.color": "red",
        "hatch.color": "red",
        "contour.linewidth": 9.0,
        "font.size": 30.0,
        "axes.formatter.use_locale": True,
    }
    with mpl.rc_context():
        mpl.rcParams.update(others)
        before = dict(mpl.rcParams)
        assert build_report(named) == page
        assert dict(mpl.rcParams) == before


@pytest.mark.slow
def test_a_foreign_matplotlibrc_and_backend_change_nothing(tmp_path):
    """In a process of its own: both are read as matplotlib is loaded."""
    (tmp_path / "matplotlibrc").write_text("image.origin: lower\ntext.usetex: True\nsvg.fonttype: none\n")
    script = (
        "import sys; from harness.report import theme, images; import numpy as np\n"
        "from harness.geometry.panorama import Grid\n"
        "with theme.style():\n"
        "    fig, ax, _ = images.panorama_axes(Grid())\n"
        "    ax.imshow(np.arange(12.0).reshape(3, 4), extent=images.extent_of(Grid()), aspect='auto')\n"
        "    print(theme.picture(fig, '').source)\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    root = str(Path(__file__).parents[1])

    def drawn(folder: Path, **variables: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": root, **variables},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    (tmp_path / "plain").mkdir()
    expected = drawn(tmp_path / "plain", MPLBACKEND="")
    assert drawn(tmp_path, MPLBACKEND="no such backend") == expected
