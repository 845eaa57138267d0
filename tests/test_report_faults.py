"""The report where something goes wrong late: names that look like markup, settings of others, a figure that fails."""

import json
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
from harness.report import theme
from harness.report.build import build_report
from harness.report.sections import scene_to_panorama
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

    monkeypatch.setattr(scene_to_panorama, "_overview_image", broken)
    assert main(["run", str(toml(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    reason = "ZeroDivisionError: the <b>scene</b> has no middle"
    assert said.count("\n") == 1
    assert f"scene_to_panorama.environment: {reason}" in said
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    document = Document(html)
    assert f"Could not be drawn: {reason}" in document.text
    assert len(list(document.every("img"))) >= 12
    assert re.search(r'<figure id="figure-environment">(?:(?!</figure>).)*Could not be drawn', html, re.DOTALL)


def test_outside_a_page_the_error_is_raised(named, monkeypatch):
    monkeypatch.setattr(scene_to_panorama, "panorama_axes", None)
    with pytest.raises(TypeError):
        scene_to_panorama.panorama(named.outcomes[0])


def test_tables_and_summary_are_there_when_the_report_fails(monkeypatch, tmp_path):
    from harness.report import build

    def broken(*_):
        raise RuntimeError("a bug")

    monkeypatch.setattr(build, "build_report", broken)
    out = tmp_path / "out"
    assert main(["run", str(toml(tmp_path)), "--out", str(out)]) == 70
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
        "import sys; from harness.report import panoramas, theme; import numpy as np\n"
        "from harness.geometry.panorama import Grid\n"
        "with theme.style():\n"
        "    fig, ax, _ = panoramas.panorama_axes(Grid())\n"
        "    ax.imshow(np.arange(12.0).reshape(3, 4), extent=panoramas.extent_of(Grid()), aspect='auto')\n"
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


# --- A run of somebody else ---------------------------------------------------------------------------------------

PROGRAM = """import sys, numpy as np
from pathlib import Path
Path({mark!r}).touch()
np.save(Path(sys.argv[2]) / "alpha_2.npy", np.full((50, 180), 1.5))
"""


@pytest.fixture
def foreign(tmp_path: Path) -> tuple[Path, Path]:
    """An experiment whose matcher is a program, and the file that the program touches."""
    mark, script = tmp_path / "ran", tmp_path / "matcher.py"
    script.write_text(PROGRAM.format(mark=str(mark)), encoding="utf-8")
    command = [sys.executable, str(script), "{input}", "{output}"]
    return toml(tmp_path, matching={"kind": "program", "command": command}), mark


@pytest.mark.long
@pytest.mark.slow
def test_a_report_runs_no_program_unless_it_is_let(foreign, tmp_path, capsys):
    experiment, mark = foreign
    out = tmp_path / "out"
    assert main(["run", str(experiment), "--out", str(out), "--no-report"]) == 0
    mark.unlink()
    assert main(["report", str(out)]) == 0
    assert not mark.exists()
    said = capsys.readouterr().err
    assert "left out of the report: program: its matcher is not part of omnirange" in said
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "--run-code allows it to run" in Document(html).text
    assert html.count("Not shown: this section needs the pixels") == 8
    assert 'id="measures"' in html

    assert main(["report", str(out), "--run-code"]) == 0
    assert mark.exists()
    mark.unlink()
    assert "Not shown" not in (out / "report.html").read_text(encoding="utf-8")

    # From now on the answer is kept with the run, and the program may even be gone.
    (tmp_path / "matcher.py").unlink()
    assert main(["report", str(out)]) == 0
    assert not mark.exists()
    assert "Not shown" not in (out / "report.html").read_text(encoding="utf-8")


def test_an_answer_comes_back_bit_by_bit():
    from harness.runs.details import packed, unpacked

    outcome = run_small(axes={}).outcomes[0]
    matches, grid = outcome.matches, outcome.trial.panorama
    again = unpacked(packed(matches), grid)
    for name in ("alpha_2", "confidence", "sigma_alpha_2", "refined", "k", "reasons"):
        one, other = getattr(matches, name), getattr(again, name)
        assert (one is None) == (other is None), name
        assert one is None or (one.dtype == other.dtype and one.tobytes() == other.tobytes()), name


@pytest.mark.parametrize("what", ["no archive", "a pickle", "another shape", "far too large", "no angles"])
def test_no_answer_is_taken_on_trust(what):
    import io

    import numpy as np

    from harness.geometry.panorama import Grid
    from harness.runs.details import unpacked

    stream = io.BytesIO()
    arrays: dict[str, Any] = {
        "a pickle": {"alpha_2": np.array([[print]], dtype=object)},
        "another shape": {"alpha_2": np.zeros((3, 4))},
        "far too large": {"alpha_2": np.zeros((50, 1800))},
        "no angles": {"alpha_2": np.full((50, 180), 99.0)},
    }
    if what in arrays:
        np.savez_compressed(stream, **arrays[what])
    assert unpacked(stream.getvalue() or b"PK", Grid(width_px=180, height_px=50)) is None


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_report_without_the_files_of_its_scene_says_what_is_left_out(tmp_path, capsys):
    import trimesh

    mesh = tmp_path / "scene" / "pillar.ply"
    mesh.parent.mkdir()
    pillar = trimesh.creation.box((0.4, 0.4, 2.0), trimesh.transformations.translation_matrix((1.5, 1.0, 1.0)))
    mesh.write_bytes(pillar.export(file_type="ply"))
    from harness.simulation.scene import load_scene

    box = load_scene("box").model_dump(mode="json", exclude_none=True)
    box["objects"].append({"kind": "mesh", "file": str(mesh), "texture": {"kind": "grey", "value": 120.0}})
    experiment, out = toml(tmp_path, scene=box), tmp_path / "out"
    assert main(["run", str(experiment), "--out", str(out)]) == 0
    with_pixels = (out / "report.html").read_text(encoding="utf-8")
    mesh.parent.rename(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "pillar.ply").write_bytes(pillar.export(file_type="ply") + b"\n")

    from harness.simulation.fingerprint import fingerprint

    if hasattr(fingerprint, "cache_clear"):
        fingerprint.cache_clear()  # another process would not have it
    capsys.readouterr()
    assert main(["report", str(out)]) == 0
    assert "left out of the report: window" in capsys.readouterr().err
    html = (out / "report.html").read_text(encoding="utf-8")
    text = Document(html).text
    assert "pillar.ply" in text
    assert html.count("Not shown: this section needs the pixels") == 8
    measured = re.compile(r'<td data-measure="[a-z0-9_.]+">[^<]*</td>')
    assert measured.findall(html) == measured.findall(with_pixels)
    assert (out / "summary.json").read_text(encoding="utf-8").count("wall") >= 1


@pytest.mark.long
@pytest.mark.slow
def test_methods_beyond_those_that_fit_a_page_are_named(tmp_path, capsys):
    experiment, out = toml(tmp_path), tmp_path / "out"
    kinds = "window,column,sgm,slanted,opencv-bm,opencv-sgbm,opencv-reconstruct"
    assert main(["run", str(experiment), "--axis", f"matching.kind={kinds}", "--out", str(out)]) == 0
    said = "opencv-reconstruct: at most 6 methods are compared pixel by pixel; trials.csv has its figures"
    assert f"left out of the report: {said}" in capsys.readouterr().err
    assert said in (out / "report.html").read_text(encoding="utf-8")
    assert "opencv-reconstruct" not in json.loads((out / "summary.json").read_text())["comparison"]
    assert "opencv-reconstruct" in (out / "trials.csv").read_text(encoding="utf-8")
