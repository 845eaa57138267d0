"""Sequences of images: each with the next, by a trajectory or by the images themselves."""

import json
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import harness
from harness.api.sequence import positions
from harness.cli import main
from harness.errors import InputError

SMALL = {
    "camera": {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5},
}
GRID = harness.Grid(width_px=360, height_px=90, z_min=-0.8, z_max=0.2)
POSES = [
    harness.Pose(position_m=(0.0, 0.0, 1.2)),
    harness.Pose(position_m=(0.3, 0.1, 1.2), yaw_deg=25),
    harness.Pose(position_m=(0.5, -0.2, 1.2), yaw_deg=-20),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequence")
    for i, pose in enumerate(POSES):
        view = harness.render("box", sensor=SMALL, position_m=pose.position_m, yaw_deg=pose.yaw_deg, samples=4)
        view.write(folder / f"view{i}")
    lines = [
        " ".join(
            map(repr, [float(i), *pose.position_m, *Rotation.from_matrix(pose.R_world_from_view).as_quat().tolist()])
        )
        for i, pose in enumerate(POSES)
    ]
    (folder / "trajectory.txt").write_text("\n".join(lines) + "\n")
    return folder


def images(folder):
    return [folder / f"view{i}" / "omni.png" for i in range(3)]


def motions():
    return [harness.relative_motion(a, b) for a, b in pairwise(POSES)]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_points_of_all_pairs_are_on_the_walls_of_the_box(folder, tmp_path):
    told = []
    sequence = harness.estimate_sequence(
        images(folder), folder / "view0" / "sensor.toml", tmp_path, motions(), "column", grid=GRID, tell=told.append
    )
    assert told == list(sequence.pairs)
    assert [each.left for each in told] == ["view0/omni.png", "view1/omni.png"]
    assert all(each.density > 0.4 and each.status == "given" for each in told)
    assert positions(sequence) == pytest.approx(
        np.array([p.position_m for p in POSES]) - POSES[0].position_m, abs=1e-12
    )
    cloud = trimesh.load(tmp_path / "points.ply")
    sizes = [len(trimesh.load(tmp_path / each.folder / "points.ply").vertices) for each in told]
    assert len(cloud.vertices) == sum(sizes)
    # In the world: the box is x and y in -3 .. 3, z in 0 .. 6. Column windows at half a degree are a few cm off there.
    points = np.asarray(cloud.vertices) + POSES[0].position_m
    off = np.min(
        [abs(abs(points[:, 0]) - 3), abs(abs(points[:, 1]) - 3), abs(points[:, 2]), abs(points[:, 2] - 6)], axis=0
    )
    for part in np.split(off, [sizes[0]]):
        assert np.median(part) < 0.1
    page = (tmp_path / "range.html").read_text()
    assert 'href="0001/range.html"' in page


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_sequence_goes_on_where_it_was(folder, tmp_path, monkeypatch):
    calls = []
    from harness.api import sequence as module

    def counted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return harness.estimate_range(*arguments, **options)

    monkeypatch.setattr(module, "estimate_range", counted)
    given = (images(folder), folder / "view0" / "sensor.toml", tmp_path, motions(), "column")
    with pytest.raises(KeyboardInterrupt):
        harness.estimate_sequence(*given, grid=GRID)
    first = (tmp_path / "0000" / "pair.json").read_text()
    harness.estimate_sequence(*given, grid=GRID)
    assert len(calls) == 3
    assert (tmp_path / "0000" / "pair.json").read_text() == first
    (tmp_path / "0001" / "pair.json").write_text("{")  # damaged: matched anew
    harness.estimate_sequence(*given, grid=GRID)
    assert len(calls) == 4
    cut = tmp_path / "0000" / "points.ply"
    whole = cut.read_bytes()
    damaged = {"points.ply": whole[:500], "range.npy": None, "pair.json": first.replace('"density": ', '"density": "x')}
    for count, (name, content) in enumerate(damaged.items(), start=5):
        file = tmp_path / "0000" / name
        file.unlink() if content is None else file.write_bytes(content if name != "pair.json" else content.encode())
        harness.estimate_sequence(*given, grid=GRID)
        assert len(calls) == count
    assert cut.read_bytes() == whole
    assert len(json.loads((tmp_path / "sequence.json").read_text())) == 2


@pytest.mark.slow
def test_command(folder, tmp_path, capsys):
    shared = [
        "--sensor",
        str(folder / "view0" / "sensor.toml"),
        "--matcher",
        "column",
        "--set",
        "panorama.width_px=360",
    ]
    base = ["range", *map(str, images(folder)), *shared, "--out", str(tmp_path / "out")]
    trajectory = ["--pose", str(folder / "trajectory.txt"), "--frame", "sensor"]
    assert main([*base, *trajectory]) == 0
    printed = capsys.readouterr().out
    assert "view1/omni.png, view2/omni.png: " in printed
    assert "motion given, geometry" in printed
    for options, message in (
        (["--pose", str(folder / "trajectory.txt")], "--frame: a trajectory does not say which frame it moves"),
        ([*trajectory, "--views", "0", "1"], "--views: is for two images"),
        (["--pose", str(folder / "view0" / "pose.toml")], "pose.toml: holds one pose; more than two images need"),
    ):
        assert main([*base, *options]) == 2
        assert message in capsys.readouterr().err
    assert main([*base[:4], str(images(folder)[0]), *base[4:], *trajectory]) == 2
    assert "trajectory.txt: has 3 poses; there are 4 images" in capsys.readouterr().err


def test_what_is_refused(tmp_path):
    with pytest.raises(InputError, match="images: must be two images or more; found 1"):
        harness.estimate_sequence(["a.png"], harness.Sensor(), tmp_path)
    with pytest.raises(InputError, match="motions: must be one for each image but the last, 2; found 1"):
        harness.estimate_sequence(["a", "b", "c"], harness.Sensor(), tmp_path, motions()[:1])


def test_nothing_of_another_sequence_stays_as_if_it_were_of_this_one(tmp_path, monkeypatch, capsys):
    unknown = SimpleNamespace(direction_v1=None, status="failed", reasons=("no keypoints",))
    monkeypatch.setattr("harness.api.sequence.estimate_motion", lambda *_, **__: unknown)
    images = []
    for name in ("a.png", "b.png", "c.png"):
        (tmp_path / name).write_bytes(name.encode())
        images.append(str(tmp_path / name))
    out = tmp_path / "out"
    for number in range(4):
        (out / f"{number:04d}").mkdir(parents=True)
        (out / f"{number:04d}" / "pair.json").write_text('{\n  "key": "')
        (out / f"{number:04d}" / "range.npy").write_text("1")
        (out / f"{number:04d}" / "range.json").write_text('{\n  "density": 1')
    (out / "points.ply").write_text("1")
    (out / "sequence.json").write_text('[\n  {\n    "left": "a.png"')
    assert main(["range", *images, "--sensor", "mirror", "--out", str(out)]) == 1
    assert f"still in {out} of another sequence: 0002 and 0003" in capsys.readouterr().out
    assert [each.parent.name for each in sorted(out.glob("*/range.npy"))] == ["0002", "0003"]
    assert not (out / "points.ply").exists()
