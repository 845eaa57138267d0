"""The figures and tables of a report as files of their own."""

import re
from xml.etree import ElementTree as ET

import pytest
from sweeps import write_small

from harness.cli import main
from harness.report.data import Data, Heading, Table, words
from harness.report.export import _latex
from harness.report.markup import html
from harness.report.section import TableBlock
from harness.runs import written

SVG = "{http://www.w3.org/2000/svg}svg"


def run_into(folder, *options):
    """A run of two trials in `folder/out`."""
    given = write_small(folder / "small.toml", "\n[axes]\nseed = [1, 2]\n")
    assert main(["run", str(given), "--out", str(folder / "out"), *options]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    run = run_into(folder)
    options = ["--figures", str(folder / "figures"), "--latex", str(folder / "tables.tex")]
    assert main(["report", str(run), *options]) == 0
    return folder


@pytest.fixture(scope="module")
def unreported(tmp_path_factory):
    """The folder of a run without a report."""
    return run_into(tmp_path_factory.mktemp("unreported"), "--no-report")


@pytest.mark.slow
def test_every_panel_of_the_page_is_a_file_in_both_formats(exported):
    page = (exported / "out" / "report.html").read_text(encoding="utf-8")
    drawn = len(re.findall(r'<img[^>]*src="data:image/svg', page))
    files = {each.name for each in (exported / "figures").iterdir()}
    stems = {name.removesuffix(".svg") for name in files if name.endswith(".svg")}
    assert files == {f"{stem}{ending}" for stem in stems for ending in (".svg", ".pdf")}
    assert drawn - 3 <= len(stems) <= drawn  # keys of lines have no number, and are no figures
    assert "errors" in stems
    for stem in stems:
        assert ET.parse(exported / "figures" / f"{stem}.svg").getroot().tag == SVG
        assert (exported / "figures" / f"{stem}.pdf").read_bytes().startswith(b"%PDF-")


@pytest.mark.long
@pytest.mark.slow
def test_the_same_result_gives_the_same_files(exported):
    again = exported / "again"
    assert main(["report", str(exported / "out"), "--figures", str(again)]) == 0
    for each in (exported / "figures").iterdir():
        assert (again / each.name).read_bytes() == each.read_bytes(), each.name


@pytest.mark.slow
def test_a_runs_files_begin_as_they_are_known_by(exported):
    """Runs of earlier versions have no hashes of all of them in their database."""
    for name, mark in written.OF_A_RUN.marks.items():
        if mark is not None and name != written.FAILURES:
            assert (exported / "out" / name).read_bytes().startswith(mark)


@pytest.mark.long
@pytest.mark.slow
def test_figures_of_ones_own_stay(exported, tmp_path, capsys):
    own = tmp_path / "errors.pdf"
    own.write_bytes(b"mine")
    words = ["report", str(exported / "out"), "--figures", str(tmp_path)]
    assert main([*words, "--latex", str(tmp_path / "tables.tex")]) == 2
    problem = "is there already, and nothing shows that it is from an earlier report; give another folder"
    assert capsys.readouterr().err == f"omnirange: {own}: --figures: {problem}\n"
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"errors.pdf": b"mine"}
    own.unlink()
    assert main(words) == main(words) == 0


@pytest.mark.slow
def test_tables_are_latex_of_plain_letters(exported):
    text = (exported / "tables.tex").read_text(encoding="ascii")  # what every engine takes
    assert text.count(r"\begin{table}") == text.count(r"\end{tabular}") >= 2
    assert text.count(r"\label{tab:") == text.count(r"\begin{table}")
    for row in re.findall(r"\\midrule\n(.*?)\\bottomrule", text, re.DOTALL):
        assert len({line.count(" & ") for line in row.strip().split("\n")}) == 1
    # The one that compares the methods, which the page groups by pixels; and no more columns than a sheet has room for.
    assert re.search(r"\\label{tab:comparison}.*?\nWalls & .*?\nAll: walls, floor and ceiling & ", text, re.DOTALL)
    assert max(line.count(" & ") for line in text.split("\n")) < 15
    assert not re.search(r"(?<!\$)[|<>]|[|<>](?!\$)", text)  # a dash and two Spanish signs in LaTeX's default encoding


def test_what_latex_would_read_as_a_command_is_text():
    table = Table(
        [Heading("Name_1", text=True), Heading("Share", "%"), Heading("Wide")],
        [[words("50 % & more #1 {x}"), words("−3 ± 2 °"), words("7")]],
        Data("t", ["a", "b", "c"], [["a", 1, 7]]),
        screen_only=(2,),
    )
    text = _latex(TableBlock("table-odd", table, html("<p>A <b>caption</b>, 95 % &amp; more.</p>")), table)
    assert r"Name\_1 & Share (\%)" in text
    assert "50 \\% \\& more \\#1 \\{x\\} & $-$3 $\\pm$ 2 $^\\circ$ \\\\\n" in text
    assert r"\caption{A caption, 95 \% \& more.}" in text
    assert r"\label{tab:odd}" in text


@pytest.mark.parametrize(
    ("option", "name", "said"),
    [
        ("--latex", "trials.csv", "is a file of the run; give another name"),
        ("--latex", "report.html", "is a file of the run; give another name"),
        ("--latex", "../out/failures.csv", "is a file of the run; give another name"),  # there or not
        ("--latex", "", "is a folder; give the name of a file"),
        ("--figures", "trials.csv", "cannot be used as the output folder (it is no folder)"),
    ],
)
def test_nothing_of_the_run_is_written_over(option, name, said, unreported, capsys):
    file = unreported / name
    before = (unreported / "trials.csv").read_bytes()
    assert main(["report", str(unreported), option, str(file)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(f"omnirange: {file}: {option}: {said}")
    assert printed.out == ""  # before the report is rebuilt
    assert (unreported / "trials.csv").read_bytes() == before


def test_maps_of_the_run_are_not_written_over(unreported, capsys):
    kept = unreported / "maps" / "0123456789abcdef.npz"
    kept.parent.mkdir(exist_ok=True)
    kept.write_bytes(b"took long to make")
    assert main(["report", str(unreported), "--latex", str(kept)]) == 2
    assert "is a file of the run" in capsys.readouterr().err
    assert kept.read_bytes() == b"took long to make"
