"""Nothing of other trials stays in a run's folder unsaid."""

from pathlib import Path

import pytest
from sweeps import write_small

import harness
from harness.cli import main
from harness.cli.results import say_unused_rows
from harness.errors import Notice
from harness.runs.store import UnusedRows
from harness.runs.written import OF_ALL_ROWS

OTHER = ("--set", "noise.sigma_grey=3")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_small(tmp_path / "small.toml")


def run(small: Path, out: Path, *options: str) -> None:
    assert main(["run", str(small), "--out", str(out), "--workers", "1", *options]) == 0


def interrupted(*_: object, **__: object) -> str:
    raise KeyboardInterrupt


def test_a_summary_without_its_report_does_not_stay(small, tmp_path, monkeypatch):
    """Ctrl-C while the first report is drawn."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("harness.report.build.build_report", interrupted)
        assert main(["run", str(small), "--out", str(out)]) != 0
    assert (out / "summary.json").is_file()
    run(small, out, *OTHER, "--no-report")
    assert not any((out / name).exists() for name in OF_ALL_ROWS)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_nor_one_between_two_runs_of_the_same_trials(small, tmp_path, monkeypatch, capsys):
    """The finished report was of the trials that are run again; the summary that is there is not."""
    out = tmp_path / "out"
    run(small, out)
    with monkeypatch.context() as patch:
        patch.setattr("harness.report.build.build_report", lambda *_, **__: 1 / 0)
        assert main(["run", str(small), "--out", str(out), *OTHER]) != 0
    assert (out / "summary.json").is_file()
    capsys.readouterr()
    run(small, out, "--no-report")
    assert f"removed from {out}: environment.json and summary.json of earlier trials" in capsys.readouterr().out


def test_maps_and_a_comparison_of_other_trials_are_said(small, tmp_path, capsys):
    out, first = tmp_path / "out", tmp_path / "first"
    run(small, first, "--no-report")
    run(small, out, "--keep-arrays", "--no-report")
    assert main(["compare", str(first), str(out)]) == 0
    run(small, out, "--no-report")
    assert "still in" not in capsys.readouterr().out
    run(small, out, *OTHER, "--keep-arrays", "--no-report")
    said = f"still in {out} of earlier trials: comparison.html and 1 of 2 maps in maps"
    assert said in capsys.readouterr().out
    assert "A file whose KEY is not there is of other trials" in (out / "maps" / "README.txt").read_text()
    with pytest.warns(Notice, match=r"still there: comparison\.html and 1 of 2 maps in maps of earlier trials"):
        harness.run(small, sets={"noise.sigma_grey": 3}, out=out, workers=1)
    assert main(["compare", str(first), str(out)]) == 0
    capsys.readouterr()
    run(small, out, *OTHER, "--no-report")
    assert f"still in {out} of earlier trials: 1 of 2 maps in maps" in capsys.readouterr().out


def test_maps_of_other_code_are_said(small, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("harness.pipeline.maps.code_hash", lambda: "other")
        run(small, out, "--keep-arrays", "--no-report")
    run(small, out, "--no-report")
    assert f"still in {out} of earlier trials: 1 of 1 map in maps" in capsys.readouterr().out


def test_a_path_s_maps_of_other_trials_are_said(small, tmp_path, capsys):
    out = tmp_path / "out"
    run(small, out, "--no-report")
    (out / "occupancy").mkdir()
    (out / "occupancy" / "sgm-0123456789abcdef.yaml").write_text("image: x.png")
    run(small, out, *OTHER, "--no-report")
    assert "of earlier trials: 1 of 1 map in occupancy" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_report_from_python_comes_with_its_own_tables(small, tmp_path):
    out = tmp_path / "out"
    first = harness.run(small, out=out, workers=1)
    table = (out / "trials.csv").read_bytes()
    harness.run(small, sets={"noise.sigma_grey": 3}, out=out, workers=1)
    assert (out / "trials.csv").read_bytes() != table
    first.report()
    assert (out / "trials.csv").read_bytes() == table


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_removed_report_is_said_in_python(small, tmp_path):
    out = tmp_path / "out"
    run(small, out)
    with pytest.warns(Notice, match=r"removed: environment\.json, summary\.json and report\.html of earlier trials"):
        harness.run(small, sets={"noise.sigma_grey": 3}, out=out, workers=1)


def test_trials_that_are_not_used_are_counted(capsys):
    say_unused_rows(UnusedRows(other_code=1, other_scene=0, other_settings=3))
    one, more = capsys.readouterr().out.splitlines()
    assert one == "1 trial in this folder was made by other code or libraries: it is not used"
    assert more == "3 trials in this folder were made with other settings: they are not used"
