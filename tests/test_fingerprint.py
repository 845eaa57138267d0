"""A scene counts by its contents: by all files that make the picture, and by nothing else."""

import base64
import json
import os
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from PIL import Image

from harness.errors import InputError
from harness.pipeline import trial as trial_module
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.stages import Work
from harness.runs.load import load_experiment
from harness.runs.worker import pack
from harness.simulation.fingerprint import files_read, fingerprint
from harness.simulation.scene import load_scene
from harness.simulation.scene_geometry import geometry_of

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


def test_the_place_of_the_files_does_not_count_their_contents_do(tmp_path):
    here, there = write_scene(tmp_path / "here"), write_scene(tmp_path / "there")
    assert here != there
    assert fingerprint(here) == fingerprint(there)
    assert fingerprint(here) != fingerprint(write_scene(tmp_path / "darker", grey=99))


def test_files_named_by_files_count_too(tmp_path):
    scene = write_scene(tmp_path / "one")
    before = fingerprint(scene)
    (files,) = files_read(scene).values()
    assert [Path(file.path).name for file in files] == ["shape.obj", "paint.mtl", "paint.png"]
    Image.fromarray(np.full((4, 4), 7, np.uint8)).save(tmp_path / "one" / "paint.png")
    assert fingerprint(scene) != before
    assert geometry_of(scene).textures[0][0, 0] == 7


def quad_obj(folder, image):
    """An OBJ whose material file and image have names with spaces."""
    (folder / "my wall.mtl").write_text(f"newmtl my paint\nmap_Kd {image}\n")
    return OBJ.replace("paint.mtl", "my wall.mtl").replace("usemtl paint", "usemtl my paint")


def quad_ply(_folder, image):
    """A PLY with a texture."""
    return (
        f"ply\nformat ascii 1.0\ncomment TextureFile {image}\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float s\nproperty float t\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
    )


def quad_gltf(_folder, image):
    """A glTF with its texture in a file."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    uv = np.array([[0, 1], [1, 1], [0, 0]], np.float32).tobytes()
    data = base64.b64encode(positions + uv).decode()
    tree = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": quote(image)}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 24},
        ],
        "buffers": [{"byteLength": 60, "uri": f"data:application/octet-stream;base64,{data}"}],
    }
    return json.dumps(tree)


@pytest.mark.parametrize(("name", "write"), [("m.obj", quad_obj), ("m.ply", quad_ply), ("m.gltf", quad_gltf)])
def test_a_texture_edited_in_place_is_another_scene(name, write, tmp_path):
    """Within one process, whoever names the texture, and however soon after the last look."""
    image = tmp_path / "my wall.png"
    (tmp_path / name).write_text(write(tmp_path, image.name))
    (tmp_path / "s.toml").write_text(f'name = "s"\nclosed = false\n[[objects]]\nkind = "mesh"\nfile = "{name}"\n')
    scene = load_scene(str(tmp_path / "s.toml"))
    visible = []
    for grey in (10, 20, 30, 10):
        Image.fromarray(np.full((4, 4), grey, np.uint8)).save(image)
        os.utime(image, (1, 1))  # the time alone does not tell
        visible.append((fingerprint(scene), float(geometry_of(scene).textures[0][0, 0])))
    assert [grey for _, grey in visible] == [10, 20, 30, 10]
    assert len(set(visible)) == 3
    assert visible[0] == visible[3]


def test_files_that_are_not_opened_do_not_count(tmp_path):
    """A texture of the scene's own replaces the mesh's materials, which may then be missing."""
    write_scene(tmp_path / "one")
    text = (tmp_path / "one" / "scene.toml").read_text() + 'texture = { kind = "grey", value = 9 }\n'
    (tmp_path / "one" / "scene.toml").write_text(text)
    scene = load_scene(str(tmp_path / "one" / "scene.toml"))
    before = fingerprint(scene)
    (tmp_path / "one" / "paint.png").unlink()
    (tmp_path / "one" / "paint.mtl").unlink()
    assert fingerprint(scene) == before


def test_a_scene_changed_while_a_trial_runs_is_not_kept(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "one")
    work = Work(Trial(scene=scene), StageCache(), lambda _: None, 1)

    def repainted(*_):
        Image.fromarray(np.full((4, 4), 7, np.uint8)).save(tmp_path / "one" / "paint.png")
        return np.zeros((480, 640), np.float32)

    monkeypatch.setattr(trial_module, "render", repainted)
    with pytest.raises(InputError, match="changed while the trial ran"):
        work(trial_module.RENDER)


def test_a_mesh_of_several_files_is_not_sent_away_in_part(tmp_path):
    write_scene(tmp_path / "one")
    (tmp_path / "e.toml").write_text('name = "e"\n[trial]\nscene = "one/scene.toml"\n')
    planned = load_experiment(str(tmp_path / "e.toml")).planned
    with pytest.raises(InputError, match="save it as GLB"):
        pack(planned, with_files=True)
    assert pack(planned).files == {}


def test_a_file_of_the_scene_that_is_wrong_is_named(tmp_path):
    """Before anything is run, and as itself: not as the experiment that led to it."""
    write_scene(tmp_path / "one")
    (tmp_path / "one" / "paint.mtl").write_text("newmtl paint\nd 0.5\n")
    (tmp_path / "e.toml").write_text('name = "e"\n[trial]\nscene = "one/scene.toml"\n')
    with pytest.raises(InputError, match=r"^\S*/one/paint\.mtl: line 2: "):
        load_experiment(str(tmp_path / "e.toml"))
