"""A scene counts by its contents: by all files that make the picture, and by nothing else."""

import json

import numpy as np
import pytest
from PIL import Image

from harness.errors import InputError
from harness.runs.experiment import load_experiment
from harness.runs.worker import pack
from harness.simulation.fingerprint import fingerprint
from harness.simulation.mesh_file import companions
from harness.simulation.scene import load_scene

OBJ = """mtllib paint.mtl
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
vt 1 0
vt 0 1
usemtl paint
f 1/1 2/2 3/3
"""


def write_scene(folder, grey=100):
    folder.mkdir()
    (folder / "shape.obj").write_text(OBJ)
    (folder / "paint.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    Image.fromarray(np.full((4, 4), grey, np.uint8)).save(folder / "paint.png")
    scene = """name = "s"
closed = false
[[objects]]
kind = "mesh"
file = "shape.obj"
"""
    (folder / "scene.toml").write_text(scene)
    return load_scene(str(folder / "scene.toml"))


def print_of(scene):
    fingerprint.cache_clear()
    return fingerprint(scene)


def test_the_place_of_the_files_does_not_count_their_contents_do(tmp_path):
    here, there = write_scene(tmp_path / "here"), write_scene(tmp_path / "there")
    assert here != there
    assert print_of(here) == print_of(there)
    assert print_of(here) != print_of(write_scene(tmp_path / "darker", grey=99))


def test_files_named_by_files_count_too(tmp_path):
    scene = write_scene(tmp_path / "one")
    before = print_of(scene)
    assert [path.name for path in companions(tmp_path / "one" / "shape.obj")] == ["paint.mtl", "paint.png"]
    Image.fromarray(np.full((4, 4), 7, np.uint8)).save(tmp_path / "one" / "paint.png")
    assert print_of(scene) != before


def test_companions_of_a_gltf(tmp_path):
    (tmp_path / "a b.bin").write_bytes(b"123")
    parts = {"buffers": [{"uri": "a%20b.bin"}], "images": [{"uri": "data:image/png;base64,AA"}, {"bufferView": 0}]}
    (tmp_path / "m.gltf").write_text(json.dumps(parts))
    assert [path.name for path in companions(tmp_path / "m.gltf")] == ["a b.bin"]
    (tmp_path / "broken.gltf").write_text("{")
    assert companions(tmp_path / "broken.gltf") == ()


def test_a_mesh_of_several_files_is_not_sent_away_in_part(tmp_path):
    write_scene(tmp_path / "one")
    (tmp_path / "e.toml").write_text('name = "e"\n[trial]\nscene = "one/scene.toml"\n')
    planned = load_experiment(str(tmp_path / "e.toml")).planned
    with pytest.raises(InputError, match="save it as GLB"):
        pack(planned, with_files=True)
    assert pack(planned).files == {}
