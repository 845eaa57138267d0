"""glTF 2.0 files, text and binary: the unlit base colour of every triangle.

Shading properties (metal, roughness, normals, occlusion, and extensions of that kind) are ignored, as a scene has no
lights; surfaces are visible from both sides; points and lines have no area; animations are not played. Everything else
that changes the image is applied, or rejected by name.
"""

import base64
import binascii
import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.files import printable
from harness.geometry.angles import Array
from harness.images import LIMIT_BYTES as IMAGE_LIMIT_BYTES
from harness.images import LUMA, Picture, Weights, decode
from harness.simulation.content_cache import read_recorded
from harness.simulation.gltf_accessors import Accessors
from harness.simulation.gltf_schema import Gltf, Material, Node, Primitive, TextureInfo
from harness.simulation.mesh_part import LIMIT_BYTES, Look, MeshPart, read_named
from harness.spec import parse

# glTF's x, y, z are right, up and towards the viewer; ours are x, y and up: (x, y, z) -> (x, -z, y).
Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_LIMIT_NODES = 100_000
_REPEAT, _MIRRORED, _CLAMP, _NEAREST = 10497, 33648, 33071, 9728


def read_gltf(path: Path, *, textured: bool, weights: Weights = LUMA) -> list[MeshPart]:
    """The parts of a glTF file, one for each primitive, z up; `textured` False leaves materials and images unread.

    Raises
    ------
    InputError
        Names the file and the key.
    """
    tree, binary = _open(path)
    reader = _Reader(path, _parsed(tree, path), binary, weights)
    return list(reader.parts(textured=textured))


def _open(path: Path) -> tuple[Any, bytes | None]:
    """The JSON tree, and the binary chunk of a GLB."""
    data, binary = read_recorded(path, LIMIT_BYTES, "mesh"), None
    if data[:4] == _MAGIC:
        chunks = dict(_chunks(data, path))
        data, binary = chunks.get(_JSON, b""), chunks.get(_BIN)
    try:
        return json.loads(data.decode("utf-8-sig")), binary
    except RecursionError:
        raise InputError("cannot be read as a mesh: its JSON is nested too deeply", file=path) from None
    except ValueError as error:
        raise InputError("cannot be read as a mesh: it is neither glTF nor GLB", file=path) from error


def _chunks(data: bytes, path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Kind and contents of a GLB's chunks, the first of each kind last."""
    if len(data) < 12 or struct.unpack_from("<I", data, 4)[0] != 2:
        raise InputError("cannot be read as a mesh: it is not GLB version 2", file=path)
    chunks, at = [], 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        if at + 8 + length > len(data):
            raise InputError("cannot be read as a mesh: it is cut short", file=path)
        chunks.append((kind, data[at + 8 : at + 8 + length]))
        at += 8 + length
    return reversed(chunks)


def _parsed(tree: Any, path: Path) -> Gltf:
    try:
        gltf = parse(Gltf, tree, file=path)
    except InputError as error:  # values may be as long as a file
        raise InputError(_shortened(error.problem), file=path, key=_shortened(error.key or "") or None) from error
    if not gltf.asset.version.startswith("2."):
        raise InputError(f"must be 2.0; found '{printable(gltf.asset.version)}'", file=path, key="asset.version")
    gltf.refuse_extensions(path)
    return gltf


def _shortened(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:150]} ..."


@dataclass(frozen=True)
class _Surface:
    """A material's texture and factor, and how it uses which texture coordinates."""

    picture: Picture | None
    factor: tuple[float, float, float] | None
    texture: TextureInfo | None
    wraps: tuple[int, int]


class _Reader:
    def __init__(self, path: Path, gltf: Gltf, binary: bytes | None, weights: Weights) -> None:
        self._path, self._gltf = path, gltf
        self._accessors = Accessors(path, gltf, self._buffer, binary)
        self._look = Look(path, linear=True, weights=weights)
        self._surfaces: dict[int, _Surface] = {}
        self._pictures: dict[tuple[int, tuple[int, int]], Picture] = {}

    def parts(self, *, textured: bool) -> Iterator[MeshPart]:
        for index, transform in self._placed():
            key = f"meshes[{index}]"
            mesh = self._one("meshes", index)
            for number, primitive in enumerate(mesh.primitives):
                if primitive.mode >= 4:
                    yield self._part(primitive, transform, f"{key}.primitives[{number}]", textured=textured)

    def _one(self, kind: str, index: int) -> Any:
        entries: Sequence[Any] = getattr(self._gltf, kind)
        if not 0 <= index < len(entries):
            raise InputError(f"there is no {kind}[{index}]; repair the mesh", file=self._path)
        return entries[index]

    def _placed(self) -> Iterator[tuple[int, Array]]:
        """The meshes of the scene's nodes with their transforms `[4, 4]`; each node once, parents first."""
        gltf = self._gltf
        if gltf.scenes:
            roots = self._one("scenes", gltf.scene or 0).nodes
        else:
            children = {child for node in gltf.nodes for child in node.children}
            roots = tuple(index for index in range(len(gltf.nodes)) if index not in children)
        waiting = [(index, np.eye(4)) for index in reversed(roots)]
        visited: set[int] = set()
        while waiting:
            index, above = waiting.pop()
            node: Node = self._one("nodes", index)
            if index in visited or len(visited) >= _LIMIT_NODES:
                raise InputError(
                    "is reached twice; a node may have one parent only", file=self._path, key=f"nodes[{index}]"
                )
            visited.add(index)
            transform = above @ node.transform
            if node.mesh is not None:
                self._refuse_deformed(node, index)
                yield node.mesh, transform
            waiting += [(child, transform) for child in reversed(node.children)]

    def _refuse_deformed(self, node: Node, index: int) -> None:
        if node.skin is not None:
            self._refuse(f"nodes[{index}].skin", "skins are not applied")
        weights = node.weights if node.weights is not None else self._one("meshes", node.mesh or 0).weights
        if weights is not None and any(weights):
            self._refuse(f"nodes[{index}].weights", "morph targets are not applied")

    def _part(self, primitive: Primitive, transform: Array, key: str, *, textured: bool) -> MeshPart:
        attributes = primitive.attributes
        if "POSITION" not in attributes:
            self._refuse(f"{key}.attributes", "vertices without POSITION are not read")
        vertices = self._accessors.read(attributes["POSITION"], ("VEC3",))
        if primitive.indices is None:
            indices = np.arange(len(vertices))
        else:
            indices = self._accessors.read(primitive.indices, ("SCALAR",), whole=True)[:, 0].astype(np.int64)
        triangles = _triangles(indices, primitive.mode)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise InputError("has vertices that do not exist; repair the mesh", file=self._path, key=f"{key}.indices")
        placed = vertices @ transform[:3, :3].T + transform[:3, 3]
        corners = (placed @ Z_UP_FROM_Y_UP.T)[triangles]
        if not textured or not len(triangles):
            return MeshPart(corners, None, None)
        surface = self._surface(primitive.material)
        uv = self._uv(attributes, surface, triangles, len(vertices), key)
        colours = None
        if "COLOR_0" in attributes:
            colours = self._per_vertex(attributes["COLOR_0"], ("VEC3", "VEC4"), len(vertices), key)[triangles][..., :3]
        return self._look.part(corners, uv, surface.picture, surface.factor, colours, key=f"{key}.attributes.COLOR_0")

    def _per_vertex(self, accessor: int, kinds: tuple[str, ...], count: int, key: str) -> Array:
        values = self._accessors.read(accessor, kinds, normalised=True)
        if len(values) != count:
            raise InputError("attributes must have the same count", file=self._path, key=f"{key}.attributes")
        return values

    def _uv(
        self, attributes: dict[str, int], surface: _Surface, triangles: NDArray[np.int64], count: int, key: str
    ) -> Array | None:
        """Texture coordinates `[triangles, 3, 2]`, v up, in repetitions of the picture."""
        texture = surface.texture
        name = f"TEXCOORD_{0 if texture is None else texture.set_used}"
        if name not in attributes:
            if texture is not None:
                raise InputError(f"has no {name}, which its material uses", file=self._path, key=f"{key}.attributes")
            return None
        uv = self._per_vertex(attributes[name], ("VEC2",), count, key)
        if texture is not None and texture.transform is not None:
            uv = texture.transform.applied(uv)
        for axis, wrap in enumerate(surface.wraps):
            if wrap == _CLAMP and len(uv) and not (uv[:, axis].min() >= 0 and uv[:, axis].max() <= 1):
                self._refuse(
                    f"{key}.attributes.{name}", "clamped textures (CLAMP_TO_EDGE) beyond 0 .. 1 are not rendered"
                )
            if wrap != _REPEAT:  # the picture is two tiles wide
                uv = uv / np.where(np.arange(2) == axis, 2, 1)
        return (uv * [1, -1] + [0, 1])[triangles]

    def _surface(self, index: int | None) -> _Surface:
        if index is None:
            return _Surface(None, None, None, (_REPEAT, _REPEAT))
        if index not in self._surfaces:
            material: Material = self._one("materials", index)
            material.refuse_what_shows(self._path, f"materials[{index}]")
            base = material.pbrMetallicRoughness
            texture = None if base is None else base.baseColorTexture
            given = None if base is None else base.baseColorFactor
            factor = None if given is None else (given[0], given[1], given[2])
            if texture is not None and texture.transform is not None and texture.transform.rotation != 0:
                # The specification's text and its matrix rotate in opposite directions, and renderers differ.
                key = f"materials[{index}].pbrMetallicRoughness.baseColorTexture.extensions.KHR_texture_transform"
                self._refuse(f"{key}.rotation", "rotated textures are not rendered")
            picture, wraps = (None, (_REPEAT, _REPEAT)) if texture is None else self._picture(texture.index)
            self._surfaces[index] = _Surface(picture, factor, texture, wraps)
        return self._surfaces[index]

    def _picture(self, index: int) -> tuple[Picture, tuple[int, int]]:
        """A texture's picture, laid out for its wrap modes."""
        texture = self._one("textures", index)
        source = texture.source if texture.source is not None else texture.webp
        if source is None:
            self._refuse(f"textures[{index}]", "textures without a PNG, JPEG or WebP image are not read")
        wraps = (_REPEAT, _REPEAT)
        if texture.sampler is not None:
            sampler = self._one("samplers", texture.sampler)
            key = f"samplers[{texture.sampler}]"
            wraps = (sampler.wrapS, sampler.wrapT)
            if not set(wraps) <= {_REPEAT, _MIRRORED, _CLAMP}:
                self._refuse(key, f"wrap modes {wraps[0]} and {wraps[1]} are not known")
            if sampler.magFilter == _NEAREST:
                self._refuse(f"{key}.magFilter", "textures are interpolated, NEAREST is not rendered")
        picture = (source, wraps)
        if picture not in self._pictures:
            self._pictures[picture] = _laid_out(self._image(source), wraps)
        return self._pictures[picture], wraps

    def _image(self, index: int) -> Picture:
        image, key = self._one("images", index), f"images[{index}]"
        if image.uri is None and image.bufferView is None:
            self._refuse(key, "images without uri or bufferView are not read")
        if image.uri is not None:
            data = self._fetched(image.uri, IMAGE_LIMIT_BYTES, "texture", key)
        else:
            data = self._accessors.view(image.bufferView, key)
        try:
            return decode(data, self._path)
        except InputError as error:
            named = "" if image.uri is None or image.uri.startswith("data:") else f" '{printable(image.uri)}'"
            raise InputError(f"its image{named} {error.problem}", file=self._path, key=key) from error

    def _buffer(self, index: int) -> bytes:
        buffer, key = self._one("buffers", index), f"buffers[{index}]"
        if buffer.uri is None:
            self._refuse(key, "buffers without uri are not read, but for the first of a GLB")
        return self._fetched(buffer.uri, LIMIT_BYTES, "buffer", key)

    def _fetched(self, uri: str, limit_bytes: int, what: str, key: str) -> bytes:
        """The data of a URI: embedded data, or a file relative to the mesh."""
        if uri.startswith("data:"):
            head, comma, content = uri.partition(",")
            try:
                return base64.b64decode(content, validate=True) if head.endswith(";base64") and comma else b""
            except (binascii.Error, ValueError):
                raise InputError("contains no base64 data", file=self._path, key=f"{key}.uri") from None
        if "://" in uri:
            self._refuse(f"{key}.uri", f"addresses such as '{printable(uri)}' are not fetched")
        return read_named(unquote(uri), self._path, limit_bytes, what, key=key)[0]

    def _refuse(self, key: str, what: str) -> None:
        raise InputError(f"{what}; change it when exporting, or give the object a texture", file=self._path, key=key)


def _triangles(indices: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Triangles `[n, 3]` of a list (4), a strip (5) or a fan (6)."""
    if mode == 4:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    count = max(len(indices) - 2, 0)
    start = np.arange(count)
    first = start if mode == 5 else np.zeros(count, dtype=np.int64)
    return indices[np.stack([first, start + 1, start + 2], axis=-1)]


def _laid_out(picture: Picture, wraps: tuple[int, int]) -> Picture:
    """A tile that repeats as the wrap modes require: with mirrored copies, which also suit a clamped texture if
    coordinates stay within 0 .. 1.
    """
    levels = picture.levels
    if wraps[0] != _REPEAT:
        levels = np.concatenate([levels, levels[:, ::-1]], axis=1)
    if wraps[1] != _REPEAT:  # v is down in the file, as rows are
        levels = np.concatenate([levels, levels[::-1]], axis=0)
    return Picture(levels, picture.white, picture.scale)
