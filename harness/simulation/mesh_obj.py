"""Wavefront OBJ files and their materials (MTL).

A material is its diffuse colour, `Kd` times `map_Kd`. Shading properties are ignored, as a scene has no lights.
Properties that would change the image and are not rendered are rejected by name.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.files import printable
from harness.geometry.angles import Array
from harness.images import LUMA, Picture, Weights
from harness.simulation.content_cache import read_recorded
from harness.simulation.mesh_part import (
    LIMIT_BYTES,
    Colour,
    Look,
    MeshPart,
    is_beside,
    read_named,
    read_picture,
    refuse_unless_convex,
    text_of,
)

_IGNORED = {
    "o",
    "g",
    "s",
    "vn",
    "vp",
    "p",
    "l",
    "mg",
    "lod",
    "bevel",
    "c_interp",
    "d_interp",
    "shadow_obj",
    "trace_obj",
}
"""Ignored keywords: names, shading, points and lines, which have no area."""
_MAP_OPTIONS = {
    "-blendu",
    "-blendv",
    "-bm",
    "-boost",
    "-cc",
    "-clamp",
    "-imfchan",
    "-mm",
    "-o",
    "-s",
    "-t",
    "-texres",
    "-type",
}
_CHANGES_THE_LOOK = {"map_d", "map_ke", "disp", "map_disp", "decal"}


@dataclass
class _Material:
    factor: Colour | None = None
    texture: str | None = None
    file: Path = Path()
    line: str = ""


@dataclass
class _Faces:
    """Triangles of one material: indices of corners into vertices and texture coordinates (-1: none)."""

    line: str
    vertices: list[int] = field(default_factory=list)
    uv: list[int] = field(default_factory=list)
    polygon: list[int] = field(default_factory=list)


class _Obj:
    def __init__(self, file: Path) -> None:
        self.file = file
        self.vertices: list[float] = []
        self.colours: list[float] = []
        self.uv: list[float] = []
        self.faces: dict[str, _Faces] = {}
        self.libraries: list[tuple[str, str]] = []
        self.polygons = 0

    def read(self, text: str) -> None:
        material = ""
        for number, line in _lines(text):
            words = line.split()
            try:
                if words[0] == "v":
                    self._vertex([float(word) for word in words[1:]])
                elif words[0] == "vt":
                    self.uv += float(words[1]), float(words[2]) if len(words) > 2 else 0.0
                elif words[0] == "f":
                    faces = self.faces.setdefault(material, _Faces(f"line {number}"))
                    self._face(words[1:], faces)
                elif words[0] == "usemtl":
                    material = line[6:].strip()
                elif words[0] == "mtllib":
                    self.libraries.append((line[6:].strip(), f"line {number}"))
                elif words[0] not in _IGNORED:
                    raise InputError(
                        f"unknown keyword '{printable(words[0])}'; save the mesh as polygons",
                        file=self.file,
                        key=f"line {number}",
                    )
            except (ValueError, IndexError) as error:
                raise InputError(
                    f"cannot be read as a mesh: wrong numbers after '{words[0]}'", file=self.file, key=f"line {number}"
                ) from error

    def _vertex(self, numbers: list[float]) -> None:
        if len(numbers) not in {3, 4, 6, 7}:
            raise ValueError
        self.vertices += numbers[:3]
        if len(numbers) > 4:
            self.colours += numbers[3:6]

    def _face(self, words: list[str], faces: _Faces) -> None:
        if len(words) < 3:
            raise ValueError
        corners = []
        for word in words:
            parts = word.split("/")
            texture = parts[1] if len(parts) > 1 else ""
            corners.append(
                (_index(parts[0], len(self.vertices) // 3), _index(texture, len(self.uv) // 2) if texture else -1)
            )
        for second, third in pairwise(corners[1:]):
            for vertex, uv in (corners[0], second, third):
                faces.vertices.append(vertex)
                faces.uv.append(uv)
            faces.polygon.append(self.polygons)
        self.polygons += 1


def read_obj(path: Path, *, textured: bool, weights: Weights = LUMA) -> list[MeshPart]:
    """The parts of an OBJ file, one for each material; `textured` False leaves materials and textures unread.

    Raises
    ------
    InputError
        Names the file and the line.
    """
    obj = _Obj(path)
    obj.read(text_of(read_recorded(path, LIMIT_BYTES, "mesh")))
    vertices = np.array(obj.vertices, dtype=np.float64).reshape(-1, 3)
    colours = np.array(obj.colours, dtype=np.float64).reshape(-1, 3)
    uv = np.array(obj.uv, dtype=np.float64).reshape(-1, 2)
    if textured and len(colours) not in {0, len(vertices)}:
        raise InputError("has vertices with and without colours; give all of them a colour", file=path)
    materials = _materials(obj) if textured else {}
    look = Look(path, weights=weights)
    pictures: dict[tuple[Path, str], Picture] = {}
    parts = []
    for name, faces in obj.faces.items():
        triangles = np.array(faces.vertices, dtype=np.int64).reshape(-1, 3)
        _in_range(triangles, len(vertices), "vertices", obj, faces)
        corners: Array = vertices[triangles]
        refuse_unless_convex(corners, np.unique(faces.polygon, return_inverse=True)[1], path)
        if not textured:
            parts.append(MeshPart(corners, None, None))
            continue
        if name and name not in materials:
            raise InputError(
                f"material '{printable(name)}' is in none of its material files (mtllib); give the object a texture",
                file=path,
                key=faces.line,
            )
        material = materials.get(name, _Material())
        texture_of_corner = np.array(faces.uv, dtype=np.int64).reshape(-1, 3)
        corner_uv = None
        if len(uv) and (texture_of_corner >= 0).all():
            _in_range(texture_of_corner, len(uv), "texture coordinates", obj, faces)
            corner_uv = uv[texture_of_corner]
        picture = None
        if material.texture is not None:
            key = (material.file, material.texture)
            if key not in pictures:
                pictures[key] = read_picture(material.texture, material.file, key=material.line)
            picture = pictures[key]
        parts.append(
            look.part(corners, corner_uv, picture, material.factor, colours[triangles] if len(colours) else None)
        )
    return parts


def _in_range(indices: NDArray[np.int64], count: int, what: str, obj: _Obj, faces: _Faces) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise InputError(
            f"faces from here on use {what} that do not exist; repair the mesh", file=obj.file, key=faces.line
        )


def _index(word: str, count: int) -> int:
    """The index from 0; negative numbers count backwards from the last element so far."""
    number = int(word)
    if number == 0 or number < -count or number > 2**31:
        raise ValueError
    return number - 1 if number > 0 else count + number


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines that are not empty, without comments; a backslash at the end continues a line."""
    joined, start = "", 0
    for number, line in enumerate(text.split("\n"), 1):
        start = start or number
        if line.endswith("\\"):
            joined += line[:-1] + " "
            continue
        whole = (joined + line).partition(" #")[0].strip()
        if whole and not whole.startswith("#"):
            yield start, whole
        joined, start = "", 0
    if joined.strip():
        yield start, joined.strip()


# --- Materials ----------------------------------------------------------------------------------------------------


def _materials(obj: _Obj) -> dict[str, _Material]:
    materials: dict[str, _Material] = {}
    for names, line in obj.libraries:
        # A name may have spaces, or there may be several of them.
        several = names.split()
        if is_beside(names, obj.file) or not all(is_beside(name, obj.file) for name in several):
            several = [names]
        for name in several:
            data, path = read_named(name, obj.file, LIMIT_BYTES, "materials", key=line)
            for each, material in _read_mtl(text_of(data), path).items():
                materials.setdefault(each, material)
    return materials


def _read_mtl(text: str, file: Path) -> dict[str, _Material]:
    materials: dict[str, _Material] = {}
    material = _Material()
    for number, line in _lines(text):
        words = line.split()
        keyword, key = words[0].lower(), f"line {number}"
        rest = line[len(words[0]) :].strip()
        if keyword == "newmtl":
            material = materials.setdefault(rest, _Material(file=file))
            continue
        if keyword == "kd":
            material.factor = _colour(words[1:], file, key)
        elif keyword == "map_kd":
            if words[1:] and words[1].lower() in _MAP_OPTIONS:
                raise InputError(
                    f"texture option '{words[1]}' is not applied; bake it into the texture", file=file, key=key
                )
            material.texture, material.line = rest, key
        elif keyword in _CHANGES_THE_LOOK or _shines_through(keyword, words[1:], file, key):
            raise InputError(
                f"'{words[0]}' is not rendered; bake it into map_Kd, or give the object a texture", file=file, key=key
            )
    return materials


def _shines_through(keyword: str, words: list[str], file: Path, key: str) -> bool:
    """Whether a line makes the material transparent (d below 1, Tr above 0) or emissive (Ke)."""
    if keyword not in {"d", "tr", "ke"} or words[:1] == ["-halo"]:
        return False
    numbers = _numbers(words, file, key)
    return any(number < 1 for number in numbers) if keyword == "d" else any(number > 0 for number in numbers)


def _colour(words: list[str], file: Path, key: str) -> Colour:
    numbers = _numbers(words, file, key)
    r, g, b = numbers * 3 if len(numbers) == 1 else numbers if len(numbers) == 3 else [-1.0] * 3
    if not all(0 <= each <= 1 for each in (r, g, b)):
        raise InputError("Kd must be red, green and blue within 0 .. 1", file=file, key=key)
    return r, g, b


def _numbers(words: list[str], file: Path, key: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise InputError("must be numbers", file=file, key=key) from None
