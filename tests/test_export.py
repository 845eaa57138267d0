"""A scene written as glTF and read back gives the same picture."""

import json
import struct

import numpy as np
import pytest
import trimesh

from harness.camera.sensor import Sensor
from harness.geometry.pose import Pose
from harness.simulation.export import write_glb
from harness.simulation.render import render
from harness.simulation.scene import Box, Mesh, Scene, load_scene
from harness.simulation.texture import BundledTexture, GreyTexture
from harness.simulation.truth import ranges

# Off the axes: from the middle of a square room the edges lie on the diagonals of pixels, and the sample that falls
# on an edge belongs to either side.
POSE = Pose(position_m=(0.13, -0.21, 1.04), yaw_deg=17)


def json_chunk(path):
    data = path.read_bytes()
    assert data[:4] == b"glTF"
    (length,) = struct.unpack("<I", data[12:16])
    return json.loads(data[20 : 20 + length])


ONE_MESH = pytest.mark.filterwarnings("ignore:.*coincide:harness.errors.Notice")
"""In one mesh, the feet of furniture coincide with the floor under them, which is said."""


@pytest.mark.slow
@ONE_MESH
@pytest.mark.parametrize("name", ["box", "corridor", "room"])
def test_the_picture_is_the_same_when_read_back(name, tmp_path):
    scene = load_scene(name)
    path = tmp_path / "scene.glb"
    write_glb(scene, path)
    again = Scene(name="again", objects=(Mesh(kind="mesh", file=str(path), inward=True),))
    difference = np.abs(render(again, Sensor(), POSE) - render(scene, Sensor(), POSE))
    # 8-bit texels are at most half a grey level off. Float32 texture coordinates are 1e-6 of a tile off, a
    # thousandth of a texel, which is worth less than 0.1 grey level. Of pixels on an edge between two sides with one
    # texture, which are made of more samples in a box but not in a mesh, there are fewer than one in a thousand.
    assert np.quantile(difference, 0.999) <= 0.6
    # Float32 positions move an outline by 1e-7 m: at most a sample in a pixel changes sides.
    assert difference.max() <= 255 / 16 + 0.6


@pytest.mark.slow
def test_whole_greys_are_not_rounded_and_tiles_repeat(tmp_path):
    gravel = BundledTexture(kind="bundled", name="gravel", tile_m=1.7)
    scene = Scene(name="s", objects=(Box(kind="box", inward=True, size_m=(6, 6, 6), texture=gravel),))
    path = tmp_path / "scene.glb"
    write_glb(scene, path)
    again = Scene(name="again", objects=(Mesh(kind="mesh", file=str(path), inward=True),))
    difference = np.abs(render(again, Sensor(), POSE) - render(scene, Sensor(), POSE))
    # Edges as above: a few hundred of 170,000 pixels.
    assert np.quantile(difference, 0.997) <= 0.1


@pytest.mark.slow
@ONE_MESH
def test_range_is_the_same_when_read_back(tmp_path):
    scene = load_scene("room")
    path = tmp_path / "scene.glb"
    write_glb(scene, path)
    again = Scene(name="again", objects=(Mesh(kind="mesh", file=str(path), inward=True),))
    rng = np.random.default_rng(1)
    d = rng.standard_normal((100, 100, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    valid = np.ones((100, 100), dtype=bool)
    # Positions are float32: 2e-7 m on 3 m, more along a grazing ray.
    np.testing.assert_allclose(ranges(again, POSE, d, valid), ranges(scene, POSE, d, valid), atol=1e-5)


def test_file_is_y_up_unlit_and_self_contained(tmp_path):
    size = (2.0, 4.0, 1.0)
    box = Box(kind="box", size_m=size, texture=GreyTexture(kind="grey", value=128))
    path = tmp_path / "scene.glb"
    write_glb(Scene(name="s", closed=False, objects=(box,)), path)
    tree = json_chunk(path)
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert all("KHR_materials_unlit" in material["extensions"] for material in tree["materials"])
    assert all("uri" not in image and image["mimeType"] == "image/png" for image in tree["images"])
    # No sampler, or one that does not clamp: glTF repeats by default.
    assert all(sampler.get("wrapS", 10497) == 10497 for sampler in tree.get("samplers", []))
    # Read by a plain glTF reader: our x, z, -y.
    bounds = trimesh.load_scene(path).bounds
    np.testing.assert_allclose(bounds, [[-1, 0, -2], [1, 1, 2]], atol=1e-6)
