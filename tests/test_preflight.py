"""What a run is refused for before anything is rendered, and what is not overwritten."""

import importlib.util
from pathlib import Path

import pytest
from sweeps import write_small

from harness.cli.parser import main
from harness.errors import InputError, Notice
from harness.files import OwnFiles, check_empty_or_own
from harness.runs import preflight
from harness.runs.load import load_experiment

EXPERIMENTS = Path(__file__).parent.parent / "experiments"


def small(tmp_path, **axes):
    return load_experiment(write_small(tmp_path / "e.toml"), axes={"seed": [1], **axes})


def test_a_viewpoint_outside_the_scene_is_refused_at_once(tmp_path, capsys):
    file = write_small(tmp_path / "e.toml")
    out = tmp_path / "out"
    assert main(["run", str(file), "--set", "view_1.position_m=[0,0,9]", "--out", str(out), "--workers", "1"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"omnirange: {file}: trial.view_1.position_m: scene box: the view at (0, 0, 9) m is outside")
    assert said.count("\n") == 1
    assert not (out / "failures.csv").exists()


def test_some_trials_that_will_fail_are_said(tmp_path):
    experiment = small(tmp_path, **{"view_2.baseline_m": [0.5, 5.0]})
    count = len(experiment.planned)
    with pytest.warns(Notice, match=f"{count // 2} of {count} trials will fail; the first: trial.view_2: scene box"):
        preflight.preflight(experiment.planned, len(experiment.planned), "e.toml")


def test_a_new_view_inside_an_object_is_said(tmp_path):
    experiment = small(tmp_path, **{"novel_views.distances_m": [[0.1], [0.1, 9.0]]})
    with pytest.warns(Notice, match=r"trials will fail; the first: trial.novel_views.distances_m\[1\]: scene box"):
        preflight.preflight(experiment.planned, len(experiment.planned), "e.toml")


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in EXPERIMENTS.glob("*.toml")))
def test_no_trial_of_a_shipped_experiment_will_fail(name, monkeypatch):
    """With all extras: a run that fails as it is shipped teaches nobody anything. No `Notice` is an error here."""
    monkeypatch.setattr(preflight, "_is_installed", lambda _: True)
    planned = load_experiment(name).planned
    preflight.preflight(planned, len(planned), f"{name}.toml")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"matching.kind": "opencv-sgbm"},
            "e.toml: trial.matching.kind: needs the extra: pip install 'omnirange[peers]'",
        ),
        (
            {"motion.source": "estimated"},
            "e.toml: trial.motion.source: needs the extra: pip install 'omnirange[motion]'",
        ),
    ],
)
def test_a_missing_extra_is_named(settings, message, monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "cv2" else there(name))
    experiment = load_experiment("smoke", sets=settings)
    with pytest.raises(InputError) as caught:
        preflight.preflight(experiment.planned, len(experiment.planned), "e.toml")
    assert str(caught.value) == message


def test_a_scene_is_no_experiment(capsys):
    scene = Path(__file__).parents[1] / "scenes" / "box.toml"
    assert main(["run", str(scene)]) == 2
    assert capsys.readouterr().err.startswith(
        f"omnirange: {scene}: is a scene, not an experiment; see `omnirange render`"
    )


def test_a_folder_of_other_files_is_left_alone(tmp_path):
    own = OwnFiles("view", {"README.txt": b"One view"})
    check_empty_or_own(tmp_path / "new", own)
    check_empty_or_own(tmp_path, own)
    (tmp_path / "thesis.tex").write_text("")
    for text in (None, "mine", "One v"):
        if text is not None:
            (tmp_path / "README.txt").write_text(text)
        with pytest.raises(InputError, match="holds files, and nothing shows that they are from an earlier view"):
            check_empty_or_own(tmp_path, own)
    (tmp_path / "README.txt").write_text("One view of a house")
    check_empty_or_own(tmp_path, own)


def test_a_command_beside_the_experiment_needs_no_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "match.py"
    program.write_text("#!/usr/bin/env python3\n")
    program.chmod(0o755)
    table = 'name = "e"\n[trial]\nscene = "box"\n[trial.matching]\nkind = "program"\n'
    file = tmp_path / "below" / "e.toml"
    file.parent.mkdir()
    program.rename(file.parent / "match.py")
    file.write_text(f'{table}command = ["match.py", "{{input}}", "{{output}}"]\n')
    first, *_ = load_experiment(file).trial.matching.command
    assert first == str(file.parent / "match.py")
    file.write_text(f'{table}command = ["env", "{{input}}", "{{output}}"]\n')
    (file.parent / "env").write_text("")  # a program of the search path keeps its name
    assert load_experiment(file).trial.matching.command[0] == "env"
