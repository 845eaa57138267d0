"""`--set` and `--axis` over an experiment's axes: what they leave out is said, and errors name the option."""

import pytest
from sweeps import write_small

import harness
from harness.cli import main
from harness.errors import InputError
from harness.runs.load import load_experiment


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--set", "matching.kind=slanted"), "the axis matching.subpixel is left out: --set matching.kind=slanted has"),
        (
            ("--axis", "matching.kind=slanted,opencv-reconstruct"),
            "the axes matching.window_px and matching.subpixel are left out: --axis matching.kind=slanted,opencv-recon",
        ),
        (("--set", "matching.kind=column"), ""),
        (("--set", "matching.subpixel=none"), ""),  # it is said where it is said what it is
        (("--set", "matching.kind=slanted", "--set", "matching.window_px=7"), "the axis matching.subpixel is left out"),
    ],
)
def test_an_axis_that_a_matcher_does_not_have_is_said_to_be_left_out(options, said, capsys):
    assert main(["run", "smoke", "--dry-run", *options]) == 0
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == bool(said)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--axis", "matching=3"), "--axis: matching: must be a table; found 3"),
        (("--axis", "noise=2"), "--axis: noise: must be a table; found 2"),
        (("--axis", "seed=1,1"), "--axis: seed: has the value 1 twice; leave one out"),
        (("--axis", "seed=1,2,1.0"), "--axis: seed: has the value 1.0 twice; leave one out"),
        (
            ("--axis", "seed=1", "--axis", "seed=2"),
            "--axis: seed: is given twice; write all values in one: --axis seed=",
        ),
        (
            ("--axis", "view_2.azimuth_deg=0", "--axis", "view_2={baseline_m=0.3},{baseline_m=0.4}"),
            "--axis: two trials",
        ),
    ],
)
def test_the_option_is_blamed_and_not_the_experiment(options, said, capsys):
    assert main(["run", "smoke", "--dry-run", *options]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {said}")


def test_a_file_is_blamed_for_what_is_wrong_without_any_option(tmp_path):
    file = tmp_path / "e.toml"
    file.write_text('name = "e"\n[trial]\nscene = "box"\n[axes]\nseed = [1, 1]\n')
    with pytest.raises(InputError, match=r"e\.toml: axes\.seed: has the value 1 twice"):
        load_experiment(file, axes=["noise.sigma_grey=1,2"])


def test_of_an_experiment_that_is_valid_only_with_the_option_too(tmp_path, capsys):
    file = tmp_path / "e.toml"
    file.write_text('name = "e"\n[trial]\nscene = "box"\nmatching.kind = "absent:match"\n[axes]\n"seed" = [1, 2]\n')
    assert main(["run", str(file), "--dry-run"]) == 2
    assert "there is no module absent" in capsys.readouterr().err
    assert main(["run", str(file), "--dry-run", "--set", "matching.kind=slanted"]) == 0
    assert capsys.readouterr().err == ""


def test_an_experiment_of_ones_own_is_not_written_over(tmp_path, capsys):
    """Unless it is the file of a run in that folder, which is written again."""
    own = tmp_path / "experiment.toml"
    text = write_small(own, "# mine\n").read_text(encoding="utf-8")
    assert main(["run", str(own), "--out", str(tmp_path), "--no-report"]) == 2
    assert f"{own}: --out: would be written over, and is read" in capsys.readouterr().err
    assert own.read_text(encoding="utf-8") == text
    out = tmp_path / "out"
    assert main(["run", str(own), "--out", str(out), "--no-report"]) == 0
    assert main(["run", str(out / "experiment.toml"), "--out", str(out), "--no-report"]) == 0


@pytest.mark.parametrize("name", ["trials.csv", "experiment.toml", "report.html", "failures.csv"])
def test_files_of_ones_own_are_not_written_over_or_removed(name, tmp_path, capsys):
    """Nor is it said otherwise by a dry run, which changes nothing."""
    own = tmp_path / "out" / name
    own.parent.mkdir()
    own.write_text("mine")
    file = write_small(tmp_path / "e.toml")
    assert main(["run", str(file), "--out", str(own.parent), "--no-report"]) == 2
    said = f"{own}: is there already, and not from a run in this folder; give another folder"
    assert capsys.readouterr().err == f"omnirange: {said}\n"
    assert main(["run", str(file), "--out", str(own.parent), "--dry-run"]) == 2
    assert capsys.readouterr().err == f"omnirange: {said}\n"
    with pytest.raises(InputError) as caught:
        harness.run(file, out=own.parent)
    assert str(caught.value) == said
    assert [each.name for each in own.parent.iterdir()] == [name]
    assert own.read_text() == "mine"


@pytest.mark.slow
def test_failures_of_ones_own_in_a_runs_folder_are_kept(tmp_path, capsys):
    """By a run with other trials, by one that has nothing to do, by a report."""
    file, out = write_small(tmp_path / "e.toml"), tmp_path / "out"
    words = ["run", str(file), "--out", str(out), "--no-report"]
    assert main(words) == 0
    own = out / "failures.csv"
    own.write_text("what,why\n")
    said = (
        f"omnirange: {own}: is there already, and nothing shows that it is from an earlier run; move it, or give "
        "another folder\n"
    )
    capsys.readouterr()
    for each in (words, [*words, "--set", "seed=2"], [*words, "--dry-run"], ["report", str(out)]):
        assert main(each) == 2
        assert capsys.readouterr().err == said
        assert own.read_text() == "what,why\n"
    own.write_text("seed,message,traceback,key\n")  # as an earlier version has left it
    assert main(words) == 0
    assert not own.exists()


def test_a_dry_run_says_what_the_run_would_of_its_folder(tmp_path, capsys):
    file = write_small(tmp_path / "e.toml")
    text = file.read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    other.write_text(text.replace('name = "', 'name = "another'), encoding="utf-8")
    out = tmp_path / "out"
    (tmp_path / "file").write_text("mine")
    assert main(["run", str(other), "--out", str(out), "--no-report"]) == 0
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "run.sqlite").touch()
    for each in (out, tmp_path / "file", tmp_path / "file" / "out", tmp_path / "new", tmp_path / "empty"):
        capsys.readouterr()
        words = ["run", str(file), "--out", str(each), "--no-report"]
        before = sorted(tmp_path.rglob("*"))
        dry = main([*words, "--dry-run"]), capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before
        assert (main(words), capsys.readouterr().err) == dry


def test_a_readme_of_ones_own_among_the_maps_is_kept(tmp_path):
    file, out = write_small(tmp_path / "e.toml"), tmp_path / "out"
    own = out / "maps" / "README.txt"
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    words = ["run", str(file), "--out", str(out), "--no-report", "--keep-arrays"]
    assert main(words) == 0
    assert own.read_text() == "mine"
    own.write_text("The maps")  # ours, cut short
    assert main([*words, "--set", "seed=2"]) == 0
    assert own.read_text().startswith("The maps of the trials")
