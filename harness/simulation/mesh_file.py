"""Mesh files (GLB, OBJ, PLY) read through trimesh, as triangles with texture coordinates."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.io.images import Picture
from harness.simulation.texture import Texels

FORMATS = (".glb", ".gltf", ".obj", ".ply")

# glTF's x, y, z are right, up and towards the viewer; ours are x, y and up: (x, y, z) -> (x, -z, y).
Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class MeshPart:
    """Triangles of a file that share one texture."""

    corners: Array
    """`[triangles, 3, 3]`, in the file's unit, z up."""
    uv: Array | None
    """`[triangles, 3, 2]`, in repetitions of the texture, v up; None when the file has none."""
    texels: Texels | None
    """Grey `[height, width]`; None when the file has none."""


def read_mesh(path: Path) -> list[MeshPart]:
    """The textured triangles in a mesh file, with the transforms of its scene graph applied.

    Raises
    ------
    InputError
        When the file is missing or is of no known format, or has no triangles or vertices that are not finite.
    """
    import trimesh

    if path.suffix.lower() not in FORMATS:
        raise InputError(f"not a mesh file; give one of {', '.join(FORMATS)}", file=path)
    if not path.is_file():
        raise InputError("no such mesh", file=path)
    try:
        world = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh's readers raise whatever their parsers do
        raise InputError(f"cannot be read as a mesh ({type(error).__name__}: {error})", file=path) from error
    y_up = path.suffix.lower() in {".glb", ".gltf"}
    parts = []
    for node in world.graph.nodes_geometry:
        transform, name = world.graph[node]
        mesh = world.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            part = _part(mesh, np.asarray(transform), Z_UP_FROM_Y_UP if y_up else np.eye(3))
            if not np.isfinite(part.corners).all() or (part.uv is not None and not np.isfinite(part.uv).all()):
                raise InputError("has vertices that are not finite numbers; repair the mesh", file=path)
            parts.append(part)
    if not parts:
        raise InputError("has no triangles; give a mesh with faces, not a point cloud", file=path)
    return parts


def companions(path: Path) -> tuple[Path, ...]:
    """The other files that a mesh file names: materials and textures of an OBJ, buffers and textures of a glTF."""
    found: set[Path] = set()
    if path.suffix.lower() == ".obj":
        for library in _named_in(path, "mtllib"):
            found |= {library, *_named_in(library, "map_")}
    elif path.suffix.lower() == ".gltf":
        parts = _json(path)
        entries = [*parts.get("buffers", []), *parts.get("images", [])]
        uris = [str(entry["uri"]) for entry in entries if "uri" in entry]
        found = {path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")}
    return tuple(sorted(each for each in found if each.is_file()))


def _named_in(path: Path, keyword: str) -> list[Path]:
    """Files named by the last word of the lines that begin with a keyword, beside the file that names them."""
    if not path.is_file():
        return []
    lines = (line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    return [path.parent / words[-1] for words in lines if len(words) > 1 and words[0].lower().startswith(keyword)]


def _json(path: Path) -> dict[str, Any]:
    try:
        parts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}  # whoever reads the mesh says what is wrong with it
    return parts if isinstance(parts, dict) else {}


def _part(mesh: Any, transform: Array, to_z_up: Array) -> MeshPart:
    vertices = np.asarray(mesh.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
    triangles = np.asarray(mesh.faces)
    uv = getattr(mesh.visual, "uv", None)
    image = _image(mesh)
    return MeshPart(
        corners=(vertices @ to_z_up.T)[triangles],
        uv=None if uv is None else np.asarray(uv, dtype=np.float64)[triangles][..., :2],
        texels=image,
    )


def _image(mesh: Any) -> NDArray[np.float32] | None:
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return None if image is None else Picture(np.asarray(image.convert("RGB")), 255.0, "").grey()
