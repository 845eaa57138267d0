"""What the README shows of the terminal is what the commands print."""

import json
import re
from pathlib import Path

import pytest

from harness.cli import main
from harness.cli.results import show
from harness.runs.load import load_experiment

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
REFERENCES = ROOT / "results" / "reference"


def block_after(text: str) -> str:
    """The first fenced block after some text of the README."""
    return re.search(r"```\w*\n(.*?)```", README[README.index(text) + len(text) :], re.DOTALL)[1]


def lines_of(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip().splitlines()]


def alike(said: str, printed: str) -> None:
    """The same words; numbers within 2 %: another CPU rounds the third digit otherwise."""
    number = re.compile(r"[+-]?\d+(?:\.\d+)?")
    assert [number.sub("#", line) for line in lines_of(said)] == [number.sub("#", line) for line in lines_of(printed)]
    mine, theirs = ([float(each) for each in number.findall(text)] for text in (said, printed))
    assert mine == pytest.approx(theirs, rel=0.02, abs=1e-3)


def test_the_readme_shows_what_the_papers_experiment_prints(monkeypatch, capsys):
    """From the reference numbers, which other tests hold to what comes out."""
    monkeypatch.setenv("COLUMNS", "80")
    reference = json.loads((REFERENCES / "paper.json").read_text())
    summary = {"experiment": "paper", "claims": reference["claims"], **reference["scenes"]["box"]}
    show(summary | {"trials": {"total": len(load_experiment("paper").planned)}})
    said = block_after("the last command prints").partition("writing report\n")
    assert lines_of(said[0]) == lines_of(capsys.readouterr().out)
    assert said[2] == "report: results/paper/report.html\n"


@pytest.mark.slow
def test_the_readme_shows_what_design_prints(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(block_after("What is known of the rig is a TOML file"))
    for said in re.findall(r"^omnirange (design .*)$", README, re.MULTILINE):
        capsys.readouterr()
        assert main(said.split()) == 0
        alike(block_after(f"{said}\n```"), capsys.readouterr().out)


@pytest.mark.slow
def test_what_the_readme_makes_of_its_table_is_in_it():
    """A tenth of a millimetre limits the range up to 4 m, the rotation at 8 m."""
    table = block_after("omnirange design rig.toml\n```").partition("\n\n")[0].splitlines()
    most = {float(line.split()[0]): line.split()[-1] for line in table[-4:]}
    assert most == {1: "alignment", 2: "alignment", 4: "alignment", 8: "rotation"}


@pytest.mark.slow
def test_the_readme_says_what_sensor_prints_of_resolutions(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (said,) = re.findall(r"At the horizon the three have (.*?) px per degree", README)
    printed = []
    for name in ("mirror", "fisheye", "equirectangular"):
        assert main(["sensor", name]) == 0
        printed.append(re.search(r"at the horizon (\S+) and (\S+)", " ".join(capsys.readouterr().out.split())).groups())
    assert re.findall(r"([\d.]+) x ([\d.]+)", said) == printed
