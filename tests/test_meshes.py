"""Mesh files: what of them makes the picture, and what is said of the rest. Greys are worked out by hand."""

import base64
import copy
import json
import os
import struct

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from test_images import bomb, encoded

from harness.errors import InputError
from harness.simulation.mesh_file import read_mesh
from harness.simulation.texture import lookup

QUARTERS = np.array([[40, 90], [160, 230]], np.uint8)
"""Top row first."""
SRGB_HALF = 187.516  # half of the light of white, by IEC 61966-2-1: 255 (1.055 0.5^(1/2.4) - 0.055)


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        read_mesh(path, *options.values())
    message = str(caught.value)
    assert str(path.parent) in message
    assert "\n" not in message
    assert len(message) < 1000
    return message


def greys(parts, x=(0.25, 0.75), y=(0.75, 0.25)):
    """Grey at the middles of the quarters of the unit square, top row first, by barycentric coordinates."""
    visible = np.full((2, 2), np.nan)
    for part in parts:
        # glTF's y is our z; the other formats' y is y.
        flat = part.corners[..., [0, 2]] if np.ptp(part.corners[..., 2]) > 0.5 else part.corners[..., :2]
        for corners, uv in zip(flat, part.uv, strict=True):
            for i, py in enumerate(y):
                for j, px in enumerate(x):
                    edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=-1)
                    a, b = np.linalg.solve(edges, np.array([px, py]) - corners[0])
                    if a > -1e-9 and b > -1e-9 and a + b < 1 + 1e-9:
                        visible[i, j] = lookup(part.texels, (1 - a - b) * uv[0] + a * uv[1] + b * uv[2])
    return visible


ZEROS = {"componentType": 5126, "count": 10**9, "type": "VEC3"}


class Quad:
    """A glTF square of 1 m in glTF's x-y plane with the four quarters as its texture, to be changed."""

    def __init__(self, **attributes):
        self.data = b""
        self.tree = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {}, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0}], "accessors": [], "bufferViews": [],
        }  # fmt: skip
        position = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
        uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
        self.primitive = self.tree["meshes"][0]["primitives"][0]
        for name, array in {"POSITION": position, "TEXCOORD_0": uv, **attributes}.items():
            self.primitive["attributes"][name] = self.accessor(array)
        self.primitive["indices"] = self.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint16)[:, None])
        self.tree["images"] = [{"bufferView": self.view(encoded(QUARTERS)), "mimeType": "image/png"}]
        self.material = self.tree["materials"][0]
        self.base = self.material["pbrMetallicRoughness"]

    def view(self, data):
        self.data += b"\0" * (-len(self.data) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, **more):
        kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
        component = {"f4": 5126, "u1": 5121, "u2": 5123, "u4": 5125, "i2": 5122, "i1": 5120}[array.dtype.str[1:]]
        whole = array.dtype.kind in "iu" and array.shape[1] > 1
        self.tree["accessors"].append({
            "bufferView": self.view(array.tobytes()), "componentType": component, "count": len(array),
            "type": kinds[array.shape[1]], **({"normalized": True} if whole else {}), **more,
        })  # fmt: skip
        return len(self.tree["accessors"]) - 1

    def write(self, folder):
        self.tree["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + b"\0" * (-len(self.data) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        (folder / "q.glb").write_bytes(head + chunks)
        return folder / "q.glb"


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_gltf_as_it_is_and_normalised_coordinates(kind, tmp_path):
    np.testing.assert_allclose(greys(read_mesh(Quad().write(tmp_path))), QUARTERS, atol=1e-9)
    most = np.iinfo(kind).max
    whole = Quad(TEXCOORD_0=np.array([[0, most], [most, most], [most, 0], [0, 0]], kind))
    np.testing.assert_allclose(greys(read_mesh(whole.write(tmp_path))), QUARTERS, atol=1e-9)
    whole.tree["accessors"][1]["normalized"] = False
    assert "accessors[1]: must contain floating point" in refusal(whole.write(tmp_path))


def test_gltf_texture_transform_and_second_coordinates(tmp_path):
    half = np.array([[0, 0.5], [0.5, 0.5], [0.5, 0], [0, 0]], np.float32)
    # The square shows the texture's upper left quarter, unless it is scaled and moved.
    quad = Quad(TEXCOORD_1=half)
    texture = quad.base["baseColorTexture"]
    texture["texCoord"] = 1
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path)), x=(0.5,), y=(0.5,))[0, 0], 40, atol=1e-9)
    texture["extensions"] = {"KHR_texture_transform": {"scale": [2, 2]}}
    quad.tree["extensionsRequired"] = ["KHR_texture_transform"]
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), QUARTERS, atol=1e-9)
    texture["extensions"] = {"KHR_texture_transform": {"offset": [0.5, 0.5], "texCoord": 0}}
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), QUARTERS[::-1, ::-1], atol=1e-9)
    texture["extensions"] = {"KHR_texture_transform": {"rotation": 0.1}}
    assert "KHR_texture_transform.rotation: rotated textures" in refusal(quad.write(tmp_path))
    texture["extensions"] = {}
    texture["texCoord"] = 2
    assert "has no TEXCOORD_2" in refusal(quad.write(tmp_path))


def test_gltf_factors_are_of_light(tmp_path):
    quad = Quad()
    quad.tree["images"][0]["bufferView"] = quad.view(encoded(np.full((2, 2), 255, np.uint8)))
    quad.base["baseColorFactor"] = [0.5, 0.5, 0.5, 1.0]
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), SRGB_HALF, atol=1e-3)
    del quad.base["baseColorTexture"]  # the factor alone is the look
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), SRGB_HALF, atol=1e-3)
    colour = np.full((4, 3), 0.5, np.float32)
    quad = Quad(COLOR_0=colour)
    quad.tree["images"][0]["bufferView"] = quad.view(encoded(np.full((2, 2), 255, np.uint8)))
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), SRGB_HALF, atol=1e-3)
    colour[0] = 0.4
    assert "attributes.COLOR_0: has vertex colours that vary" in refusal(Quad(COLOR_0=colour).write(tmp_path))


def test_gltf_wrap_modes(tmp_path):
    beyond = np.array([[0, 2], [2, 2], [2, 0], [0, 0]], np.float32)
    quad = Quad(TEXCOORD_0=beyond)
    quad.tree["textures"][0]["sampler"] = 0
    quad.tree["samplers"] = [{"wrapS": 33648, "wrapT": 33648}]
    # Two tiles a side, the second of each mirrored: the middles of the 4 x 4 texels, top row first.
    along = ([0.125, 0.375, 0.625, 0.875], [0.875, 0.625, 0.375, 0.125])
    mirrored = np.pad(QUARTERS, ((0, 2), (0, 2)), mode="symmetric")
    parts = read_mesh(quad.write(tmp_path))
    for i in range(2):
        for j in range(2):
            rows, columns = along[1][2 * i : 2 * i + 2], along[0][2 * j : 2 * j + 2]
            expected = mirrored[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
            np.testing.assert_allclose(greys(parts, columns, rows), expected, atol=1e-9)
    quad.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]
    assert "CLAMP_TO_EDGE" in refusal(quad.write(tmp_path))
    inside = Quad()
    inside.tree["textures"][0]["sampler"] = 0
    inside.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]
    edge = greys(read_mesh(inside.write(tmp_path)), x=(0.0, 1.0), y=(1.0, 0.0))
    np.testing.assert_allclose(edge, QUARTERS, atol=1e-9)  # with a repeating texture all four are their mean
    inside.tree["samplers"] = [{"magFilter": 9728}]
    assert "samplers[0].magFilter" in refusal(inside.write(tmp_path))


def test_gltf_sparse_strips_and_nodes(tmp_path):
    quad = Quad()
    moved = quad.accessor(np.zeros((1, 3), np.float32))
    index = quad.view(np.array([2], np.uint8).tobytes())
    value = quad.view(np.array([[1, 1, 0]], np.float32).tobytes())
    position = quad.tree["accessors"][0]
    wrong = np.array([[0, 0, 0], [1, 0, 0], [9, 9, 9], [0, 1, 0]], np.float32)
    position["bufferView"] = quad.view(wrong.tobytes())
    position["sparse"] = {
        "count": 1, "indices": {"bufferView": index, "componentType": 5121}, "values": {"bufferView": value},
    }  # fmt: skip
    assert moved == 3
    quad.primitive["mode"] = 6
    quad.primitive["indices"] = quad.accessor(np.array([0, 1, 2, 3], np.uint8)[:, None])
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), QUARTERS, atol=1e-9)
    quad.primitive["mode"] = 5
    quad.primitive["indices"] = quad.accessor(np.array([0, 1, 3, 2], np.uint8)[:, None])
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), QUARTERS, atol=1e-9)
    # A parent that moves by (1, 2, 3), a child that turns by 90 degrees about y and doubles.
    quad.tree["nodes"] = [
        {"children": [1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1]},
        {"mesh": 0, "rotation": [0, 2**-0.5, 0, 2**-0.5], "scale": [2, 2, 2]},
    ]
    corners = read_mesh(quad.write(tmp_path))[0].corners.reshape(-1, 3)
    # x -> -z and y stays in glTF; then y up becomes z up: (x, y, z) -> (x, -z, y).
    np.testing.assert_allclose([corners.min(0), corners.max(0)], [[1, -3, 2], [1, -1, 4]], atol=1e-6)
    quad.tree["nodes"] = [{"children": [1]}, {"children": [0], "mesh": 0}]
    assert "nodes[0]: is reached twice" in refusal(quad.write(tmp_path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda q: q.material.update(emissiveFactor=[0, 0.1, 0]), "materials[0].emissiveFactor"),
        (lambda q: q.material.update(alphaMode="BLEND"), "materials[0].alphaMode: transparency (BLEND)"),
        (
            lambda q: q.material.update(extensions={"KHR_materials_pbrSpecularGlossiness": {}}),
            "materials[0].extensions: extension 'KHR_materials_pbrSpecularGlossiness'",
        ),
        (lambda q: q.tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda q: q.tree["nodes"][0].update(skin=0), "nodes[0].skin"),
        (lambda q: q.tree["meshes"][0].update(weights=[0.5]), "weights: morph targets"),
        (lambda q: q.tree["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu_instancing"),
        (lambda q: q.tree["images"].__setitem__(0, {"uri": "http://127.0.0.1:9/x.png"}), "images[0].uri: addresses"),
        (lambda q: q.tree["images"].__setitem__(0, 5), "images[0]"),
        (lambda q: q.tree["images"].__setitem__(0, {"uri": "no/wall.png"}), "no/wall.png': no such file; looked for"),
        (lambda q: q.base.update(baseColorFactor=[2, 1, 1, 1]), "baseColorFactor[0]: must be at most 1"),
        (lambda q: q.tree["accessors"][0].update(count=10**9), "accessors[0]: is longer than its buffer view"),
        (lambda q: q.tree["accessors"].__setitem__(0, ZEROS), "accessors[0]: has more than"),
        (lambda q: q.tree["asset"].update(version="1.0"), "asset.version"),
    ],
)  # fmt: skip
def test_gltf_refused_by_name(change, said, tmp_path):
    quad = Quad()
    change(quad)
    path = quad.write(tmp_path)
    assert said in refusal(path)


def test_gltf_without_light_is_the_same(tmp_path):
    quad = Quad()
    quad.material |= {
        "occlusionTexture": {"index": 0}, "normalTexture": {"index": 0}, "extensions": {"KHR_materials_unlit": {}},
    }  # fmt: skip
    np.testing.assert_allclose(greys(read_mesh(quad.write(tmp_path))), QUARTERS, atol=1e-9)


def test_gltf_nested_deeply(tmp_path):
    (tmp_path / "m.gltf").write_text("[" * 200_000)
    assert "nested too deeply" in refusal(tmp_path / "m.gltf")
    (tmp_path / "m.gltf").write_text('{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 9, "uri": "pipe"}]}')
    assert "no triangles" in refusal(tmp_path / "m.gltf")


# --- OBJ ----------------------------------------------------------------------------------------------------------

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
OBJ = "mtllib m.mtl\n" + SQUARE + "usemtl m\nf 1/1 2/2 3/3 4/4\n"


def write_obj(folder, text=OBJ, mtl="newmtl m\nmap_Kd wall.png\n"):
    (folder / "wall.png").write_bytes(encoded(QUARTERS))
    for name, content in (("m.obj", text), ("m.mtl", mtl)):
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / "m.obj"


@pytest.mark.parametrize(
    ("text", "mtl", "expected"),
    [
        (OBJ, "newmtl m\nmap_Kd wall.png\n", QUARTERS),
        (OBJ.replace("1/1 2/2 3/3 4/4", "-4/-4 -3/-3 -2/-2 -1/-1"), "newmtl m\r\nmap_Kd wall.png\r\n", QUARTERS),
        # Negative numbers count from where they stand: what comes later does not move them.
        (OBJ.replace("1/1 2/2 3/3 4/4", "-4/-4 -3/-3 -2/-2 -1/-1\nv 7 7 7"), "newmtl m\nmap_Kd wall.png\n", QUARTERS),
        (OBJ.replace("f 1/1 2/2", "f 1/1 \\\n2/2"), "newmtl m\nmap_Kd .\\wall.png\n", QUARTERS),
        # Kd multiplies the texture's levels; d 1 is opaque; Ka and Ks shape an answer to light.
        (OBJ, "newmtl m\nKa 1 1 1\nKs 1 0 0\nd 1\nKe 0 0 0\nKd 0.5 0.5 0.5\nmap_Kd wall.png\n", QUARTERS / 2),
        (OBJ, "newmtl m\nKd 1 0 0\n", np.full((2, 2), 0.299 * 255)),
        ("# mür\n".encode("latin-1") + OBJ.encode(), "newmtl m\nmap_Kd wall.png\n", QUARTERS),
        # Vertex colours without a texture: grey goes linearly from the left to the right.
        (
            "v 0 0 0 0 0 0\nv 1 0 0 1 1 1\nv 1 1 0 1 1 1\nv 0 1 0 0 0 0\nf 1 2 3 4\n",
            "",
            255 * np.array([[0.25, 0.75], [0.25, 0.75]]),
        ),
    ],
)
def test_obj_look(text, mtl, expected, tmp_path):
    np.testing.assert_allclose(greys(read_mesh(write_obj(tmp_path, text, mtl))), expected, rtol=0, atol=1e-4)


def test_obj_several_material_files_with_spaces(tmp_path):
    path = write_obj(tmp_path, OBJ.replace("m.mtl", "a.mtl my file.mtl").replace("usemtl m", "usemtl my m"))
    (tmp_path / "a.mtl file.mtl").touch()
    assert "looked for" in refusal(path)
    for name in ("a.mtl", "my", "file.mtl"):
        (tmp_path / name).write_text("")
    (tmp_path / "file.mtl").write_text("newmtl my m\nmap_Kd my wall.png\n")
    Image.fromarray(QUARTERS).save(tmp_path / "my wall.png")
    np.testing.assert_allclose(greys(read_mesh(path)), QUARTERS, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "mtl", "said"),
    [
        (OBJ, "newmtl m\nmap_Kd textures\\no.png\n", "line 2: names texture 'textures\\no.png': no such file; looked"),
        (OBJ, "newmtl m\nmap_Kd -s 2 2 2 wall.png\n", "m.mtl: line 2: texture option '-s' is not applied"),
        (OBJ, "newmtl m\nd 0.5\nmap_Kd wall.png\n", "m.mtl: line 2: 'd' is not rendered"),
        (OBJ, "newmtl m\nKe 0 0 1\n", "'Ke' is not rendered"),
        (OBJ, "newmtl m\nmap_d wall.png\n", "'map_d' is not rendered"),
        (OBJ, "newmtl m\nKd 1 2 1\n", "Kd must be red, green and blue within 0 .. 1"),
        (OBJ, "newmtl m\nKd nan 0 0\n", "Kd must be"),
        (OBJ, "newmtl other\nKd 1 1 1\n", "material 'm' is in none of its material files"),
        (OBJ, "newmtl m\nmap_Kd m.obj\n", "names texture 'm.obj': cannot be read as an image"),
        (OBJ.replace("m.mtl", "x" * 5000), "", "line 1: names materials 'xxx"),
        (OBJ.replace("m.mtl", "a\0b"), "", "is not a file name"),
        (OBJ.replace("f 1/1", "f 9/1"), "newmtl m\nKd 1 1 1\n", "vertices that do not exist"),
        (OBJ.replace("f 1/1", "f 0/1"), "", "m.obj: line 11: cannot be read as a mesh: wrong numbers after 'f'"),
        (OBJ.replace("v 1 0 0", "v x 0 0"), "", "m.obj: line 3: cannot be read"),
        (OBJ.replace("v 1 0 0", "v 1e300 0 0"), "newmtl m\nKd 1 1 1\n", "beyond 1e+09"),
        (OBJ.replace("vt 0 1", "vt"), "", "line 9: cannot be read as a mesh: wrong numbers after 'vt'"),
        (OBJ.replace("usemtl", "curv"), "", "line 10: unknown keyword 'curv'"),
        ("v 0 0 0\nv 2 0 0\nv 0.1 0.1 0\nv 0 2 0\nf 2 3 4 1\n", "", "polygon 1 is not convex"),
        (OBJ.replace("v 0 0 0", "v 0 0 0 1 1 1"), "newmtl m\nKd 1 1 1\n", "vertices with and without colours"),
    ],
)  # fmt: skip
def test_obj_refused_by_name(text, mtl, said, tmp_path):
    assert said in refusal(write_obj(tmp_path, text, mtl))


def test_what_is_named_must_be_a_regular_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "/dev/zero", "."):
        assert "is not a regular file" in refusal(write_obj(tmp_path, mtl=f"newmtl m\nmap_Kd {name}\n"))
        assert "is not a regular file" in refusal(write_obj(tmp_path, OBJ.replace("m.mtl", name)))
    (tmp_path / "bomb.png").write_bytes(bomb(20000, 20000))
    assert "67 million" in refusal(write_obj(tmp_path, mtl="newmtl m\nmap_Kd bomb.png\n"))


def test_one_texture_is_held_once(tmp_path):
    text = OBJ + "usemtl n\nf 1/1 2/2 3/3 4/4\n"
    parts = read_mesh(write_obj(tmp_path, text, "newmtl m\nmap_Kd wall.png\nnewmtl n\nmap_Kd wall.png\n"))
    assert len(parts) == 2
    assert parts[0].texels is parts[1].texels


# --- PLY ----------------------------------------------------------------------------------------------------------

PLY = """ply
format ascii 1.0
comment TextureFile wall.png
element vertex 4
property float x
property float y
property float z
property float s
property float t
element face 1
property list uchar int vertex_indices
end_header
0 0 0 0 0
1 0 0 1 0
1 1 0 1 1
0 1 0 0 1
4 0 1 2 3
"""
COLOURED = PLY.replace("comment TextureFile wall.png\n", "").replace("float s", "uchar red").replace(
    "float t", "uchar green\nproperty uchar blue").replace("0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1",
    "0 0 0 0 0 0\n1 0 0 255 255 255\n1 1 0 255 255 255\n0 1 0 0 0 0")  # fmt: skip


def test_ply_look(tmp_path):
    (tmp_path / "wall.png").write_bytes(encoded(QUARTERS))
    (tmp_path / "m.ply").write_text(PLY)
    np.testing.assert_allclose(greys(read_mesh(tmp_path / "m.ply")), QUARTERS, atol=1e-9)
    (tmp_path / "m.ply").write_text(COLOURED)
    expected = 255 * np.array([[0.25, 0.75], [0.25, 0.75]])
    np.testing.assert_allclose(greys(read_mesh(tmp_path / "m.ply")), expected, atol=1e-4)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_is_what_another_library_writes(encoding, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / "m.ply", encoding=encoding)
    (part,) = read_mesh(tmp_path / "m.ply", False)
    # Single precision, or eight digits of text.
    np.testing.assert_allclose(part.corners, ball.triangles, rtol=0, atol=1e-6)


def test_ply_polygons_of_any_length_in_either_byte_order(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]])
    for order, name in (("<", "little"), (">", "big")):
        head = (
            f"ply\nformat binary_{name}_endian 1.0\nelement vertex 5\nproperty double x\nproperty double y\n"
            "property double z\nelement face 2\nproperty list uchar ushort vertex_index\nend_header\n"
        )
        faces = struct.pack(f"{order}B4HB3H", 4, 0, 1, 2, 3, 3, 3, 2, 4)
        (tmp_path / "m.ply").write_bytes(head.encode() + points.astype(order + "f8").tobytes() + faces)
        (part,) = read_mesh(tmp_path / "m.ply", False)
        np.testing.assert_array_equal(part.corners, points[[[0, 1, 2], [0, 2, 3], [3, 2, 4]]])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("wall.png", "none.png", "m.ply: TextureFile: names texture 'none.png': no such file; looked for"),
        ("vertex 4", "vertex 999999999999", "ends before its 999999999999 of 'vertex'"),
        ("vertex 4", "vertex -1", "does not fit"),
        ("4 0 1 2 3", "4 0 1 2 9", "vertices that do not exist"),
        ("4 0 1 2 3", "2 0 1", "fewer than three corners"),
        ("4 0 1 2 3", "4 0 1 2", "does not fit"),
        ("0 0 0 0 0", "nan 0 0 0 0", "not finite"),
        ("element face", "element tristrips", "element 'tristrips', which is not read"),
        ("ply\n", "plx\n", "no header"),
    ],
)
def test_ply_refused_by_name(old, new, said, tmp_path):
    (tmp_path / "wall.png").write_bytes(encoded(QUARTERS))
    (tmp_path / "m.ply").write_text(PLY.replace(old, new, 1))
    assert said in refusal(tmp_path / "m.ply")


# --- Damaged files ------------------------------------------------------------------------------------------------

VALUES = [
    0, -1, 1, 3, 2**31 - 1, 2**32, 10**20, 1e308, None, "x", "../../../etc/passwd", "/dev/zero", "pipe", "loop",
    "data:;base64,AAAA", "http://127.0.0.1:9/x", [], {}, [1], True, float("nan"), 5121, 5126, "VEC4", "x" * 3000,
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to("loop")
    return folder


def read_or_refuse(path):
    """Whatever a file holds, there are finite triangles with greys, or one line that names it."""
    try:
        parts = read_mesh(path)
    except InputError as error:
        message = str(error)
    else:
        message = str(path.parent)
        assert all(np.isfinite(part.corners).all() for part in parts)
        assert all(part.texels is None or np.isfinite(part.texels).all() for part in parts)
    assert str(path.parent) in message
    assert len(message) < 1000


def places(tree, at=()):
    """Keys that lead to the parts of a JSON tree."""
    if at:
        yield at
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield from places(value, (*at, key))


@pytest.mark.slow
@given(st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_changed_trees_of_gltf(folder, data):
    quad = Quad()
    quad.tree["buffers"] = [
        {"byteLength": len(quad.data), "uri": "data:;base64," + base64.b64encode(quad.data).decode()}
    ]
    for _ in range(data.draw(st.integers(1, 2))):
        *above, last = data.draw(st.sampled_from(list(places(quad.tree))))
        part = quad.tree
        for key in above:
            part = part[key]
        if data.draw(st.integers(0, 3)):
            part[last] = copy.deepcopy(data.draw(st.sampled_from(VALUES)))  # a second change may reach into it
        else:
            del part[last]
    (folder / "m.gltf").write_text(json.dumps(quad.tree))
    read_or_refuse(folder / "m.gltf")


BINARY_PLY = trimesh.creation.box((1, 1, 1)).export(file_type="ply")


@pytest.mark.slow
@given(st.sampled_from(["q.glb", "m.obj", "m.mtl", "m.ply", "b.ply"]), st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_bytes(folder, name, data):
    Quad().write(folder)
    write_obj(folder)
    (folder / "m.ply").write_text(PLY)
    (folder / "b.ply").write_bytes(BINARY_PLY)
    content = bytearray((folder / name).read_bytes())
    for _ in range(data.draw(st.sampled_from([1, 3, 20]))):
        where = data.draw(st.integers(0, len(content) - 1))
        content[where] = data.draw(st.one_of(st.sampled_from(list(b"0 9-\n/\\#x")), st.integers(0, 255)))
    cut = data.draw(st.sampled_from([None, None, len(content) // 2]))
    (folder / name).write_bytes(content[:cut])
    read_or_refuse(folder / ("m.obj" if name == "m.mtl" else name))
