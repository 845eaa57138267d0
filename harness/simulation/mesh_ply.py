"""PLY files: vertices, polygons, texture coordinates of vertices or corners, colours, and one texture."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.files import printable
from harness.geometry.angles import Array
from harness.images import LUMA, Weights
from harness.simulation.content_cache import read_recorded
from harness.simulation.mesh_part import LIMIT_BYTES, Look, MeshPart, read_picture, refuse_unless_convex

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_LOST = {"tristrips", "multi_texture_vertex", "multi_texture_face"}
"""Elements with faces or textures in forms that are not supported."""


@dataclass
class _Property:
    name: str
    type: str
    count_type: str = ""
    """The type of a list's length; empty for a single value."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _Lists:
    """A property that has a list in each row."""

    lengths: NDArray[np.int64]
    values: Array
    """All lists, concatenated."""


Ints = NDArray[np.int64]
Table = dict[str, Any]
"""The values `[count]` of each property, or its `_Lists`."""


def read_ply(path: Path, *, textured: bool, weights: Weights = LUMA) -> list[MeshPart]:
    """The part in a PLY file; `textured` False leaves its texture unread.

    Raises
    ------
    InputError
        Names the file, and what in it is wrong.
    """
    data = read_recorded(path, LIMIT_BYTES, "mesh")
    try:
        order, elements, texture_names, body = _header(data, path)
        tables = _tables(order, elements, body, path)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError("cannot be read as a mesh: its header does not fit its contents", file=path) from error
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    indices = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= set(vertex) or not isinstance(indices, _Lists):
        raise InputError("has no triangles; give a mesh with faces, not a point cloud", file=path)
    if len(indices.lengths) and indices.lengths.min() < 3:
        raise InputError("has faces with fewer than three corners; repair the mesh", file=path)
    corner, polygon = _fans(indices.lengths)
    used = indices.values[corner].astype(np.int64)
    vertices = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    if used.size and (used.min() < 0 or used.max() >= len(vertices)):
        raise InputError("has faces with vertices that do not exist; repair the mesh", file=path)
    corners = vertices[used]
    refuse_unless_convex(corners, polygon, path)
    if not textured or not len(corners):
        return [MeshPart(corners, None, None)]
    uv = _uv(vertex, face, indices, used, corner, path)
    picture = None
    if texture_names and uv is not None:
        texture = _texture(texture_names, face, path)
        picture = read_picture(texture, path, key="TextureFile")
    return [Look(path, weights=weights).part(corners, uv, picture, None, _colours(vertex, face, used, polygon))]


def _fans(lengths: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangle fans `[n, 3]` of polygons, as indices into all corners, and the polygon of each triangle."""
    triangles = lengths - 2
    polygon = np.repeat(np.arange(len(lengths)), triangles)
    first = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)[polygon]
    before = np.concatenate([[0], np.cumsum(triangles)[:-1]]).astype(np.int64)[polygon]
    second = first + 1 + np.arange(len(polygon)) - before
    return np.stack([first, second, second + 1], axis=-1), polygon


def _uv(vertex: Table, face: Table, indices: _Lists, used: Ints, corner: Ints, path: Path) -> Array | None:
    """Texture coordinates `[triangles, 3, 2]` of the faces' corners, or else of the vertices."""
    lists = face.get("texcoord")
    if isinstance(lists, _Lists):
        if not np.array_equal(lists.lengths, 2 * indices.lengths):
            raise InputError("has faces without texture coordinates; repair the mesh", file=path, key="texcoord")
        return np.asarray(lists.values.reshape(-1, 2)[corner], dtype=np.float64)
    for names in _UV_NAMES:
        if set(names) <= set(vertex):
            return np.stack([vertex[name].astype(np.float64) for name in names], axis=-1)[used]
    return None


def _texture(names: list[str], face: Table, path: Path) -> str:
    numbers = face.get("texnumber", np.zeros(1))
    if len(names) > 1 and (isinstance(numbers, _Lists) or np.ptp(numbers) != 0):
        raise InputError("has several textures, which are not read; save it as GLB", file=path, key="texnumber")
    number = int(numbers[0])
    if not 0 <= number < len(names):
        raise InputError("names a texture that is not in its header", file=path, key="texnumber")
    return names[number]


def _colours(vertex: Table, face: Table, used: Ints, polygon: Ints) -> Array | None:
    """Red, green and blue of corners `[triangles, 3, 3]`, 0 .. 1, from faces, or else from vertices."""
    for table, index in ((face, polygon[:, None].repeat(3, axis=1)), (vertex, used)):
        for prefix in ("", "diffuse_"):
            names = [prefix + name for name in ("red", "green", "blue")]
            if set(names) <= set(table) and not any(isinstance(table[name], _Lists) for name in names):
                levels = np.stack([_share(table[name]) for name in names], axis=-1)
                return np.asarray(levels[index])
    return None


def _share(levels: NDArray[Any]) -> Array:
    """Integers divided by the largest value of their type."""
    scale = np.iinfo(levels.dtype).max if levels.dtype.kind in "iu" else 1
    return np.asarray(levels.astype(np.float64) / scale)


# --- The file's structure -----------------------------------------------------------------------------------------


def _header(data: bytes, path: Path) -> tuple[str, list[_Element], list[str], bytes]:
    """Byte order (empty for text), elements, names of textures, and the data after the header."""
    match = re.match(rb"ply[ \t]*\r?\n(?:[^\n]*\n)*?end_header[ \t]*\r?\n", data[:100_000])
    if match is None:
        raise InputError("cannot be read as a mesh: it has no header of a PLY file", file=path)
    order: str | None = None
    elements: list[_Element] = []
    textures: list[str] = []
    for line in match[0].decode("utf-8", "replace").splitlines()[1:-1]:
        words = line.split()
        if words[:1] == ["format"]:
            order = _ORDERS[words[1]]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2])))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(_property(words))
        elif words[:2] == ["comment", "TextureFile"]:
            textures.append(line.split("TextureFile", 1)[1].strip())
        elif words and words[0] not in {"comment", "obj_info"}:
            raise InputError(f"cannot be read as a mesh: unknown line '{printable(line)}' in its header", file=path)
    if order is None or any(element.count < 0 for element in elements):
        raise ValueError
    return order, elements, textures, data[match.end() :]


def _property(words: list[str]) -> _Property:
    if words[1] == "list":
        return _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return _Property(words[2], _TYPES[words[1]])


def _tables(order: str, elements: list[_Element], body: bytes, path: Path) -> dict[str, Table]:
    tables = {}
    source = _Words(body) if not order else _Bytes(body, order)
    for element in elements:
        names = [each.name for each in element.properties]
        if element.name in _LOST or len(set(names)) < len(names):
            raise InputError(f"has element '{printable(element.name)}', which is not read; save it as GLB", file=path)
        if element.count * len(element.properties) > len(body):  # a value has a byte or more
            raise InputError(f"ends before its {element.count} of '{element.name}'", file=path)
        if any(each.count_type for each in element.properties):
            tables[element.name] = source.rows(element)
        else:
            tables[element.name] = source.table(element)
    return tables


class _Words:
    """Reads the values of a text file in order."""

    def __init__(self, body: bytes) -> None:
        self._words = np.array(body.split(), dtype=np.bytes_).astype(np.float64) if body.split() else np.zeros(0)
        self._at = 0

    def _take(self, count: int) -> Array:
        taken = self._words[self._at : self._at + count]
        if count < 0 or len(taken) < count:
            raise ValueError
        self._at += count
        return taken

    def table(self, element: _Element) -> Table:
        columns = len(element.properties)
        rows = self._take(element.count * columns).reshape(element.count, columns)
        return {each.name: _typed(rows[:, i], each.type) for i, each in enumerate(element.properties)}

    def rows(self, element: _Element) -> Table:
        return _gathered(element, (self._row(element) for _ in range(element.count)))

    def _row(self, element: _Element) -> list[Array]:
        return [self._take(int(self._take(1)[0]) if each.count_type else 1) for each in element.properties]


class _Bytes:
    """Reads the values of a binary file in order."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def _take(self, kind: str, count: int) -> NDArray[Any]:
        taken = np.frombuffer(self._body, self._order + kind, count, self._at)
        self._at += taken.nbytes
        return taken

    def table(self, element: _Element) -> Table:
        record = np.dtype([(each.name, self._order + each.type) for each in element.properties])
        taken = np.frombuffer(self._body, record, element.count, self._at)
        self._at += taken.nbytes
        return {each.name: taken[each.name] for each in element.properties}

    def rows(self, element: _Element) -> Table:
        return self._equal_rows(element) or _gathered(element, (self._row(element) for _ in range(element.count)))

    def _equal_rows(self, element: _Element) -> Table | None:
        """All rows at once, if their lists are as long as those of the first row; else None."""
        if not element.count:
            return None
        start = self._at
        first = self._row(element)
        self._at = start
        fields: list[tuple[str, str] | tuple[str, str, int]] = []
        for i, (each, values) in enumerate(zip(element.properties, first, strict=True)):
            fields += [(f"n{i}", self._order + each.count_type)] if each.count_type else []
            fields += [(f"p{i}", self._order + each.type, len(values))]
        record = np.dtype(fields)
        if element.count * record.itemsize > len(self._body) - start:
            return None
        taken = np.frombuffer(self._body, record, element.count, start)
        lists = [i for i, each in enumerate(element.properties) if each.count_type]
        if any((taken[f"n{i}"] != len(first[i])).any() for i in lists):
            return None
        self._at += taken.nbytes
        return {
            each.name: _Lists(np.full(element.count, len(first[i])), taken[f"p{i}"].ravel())
            if each.count_type
            else taken[f"p{i}"].ravel()
            for i, each in enumerate(element.properties)
        }

    def _row(self, element: _Element) -> list[Array]:
        return [
            self._take(each.type, int(self._take(each.count_type, 1)[0]) if each.count_type else 1)
            for each in element.properties
        ]


def _gathered(element: _Element, rows: Iterator[list[Array]]) -> Table:
    columns: list[list[Array]] = [[] for _ in element.properties]
    for row in rows:
        for column, values in zip(columns, row, strict=True):
            column.append(values)
    table: Table = {}
    for each, column in zip(element.properties, columns, strict=True):
        values = _typed(np.concatenate(column), each.type) if column else np.zeros(0)
        lengths = np.array([len(one) for one in column], dtype=np.int64)
        table[each.name] = _Lists(lengths, values) if each.count_type else values
    return table


def _typed(values: Array, kind: str) -> Array:
    """Values converted to the header's type; raises ValueError when it cannot represent them."""
    if kind[0] in "iu":
        limits = np.iinfo(kind)
        if values.size and not ((values >= limits.min) & (values <= limits.max) & (values == np.rint(values))).all():
            raise ValueError
    return values.astype(kind)
