"""Mesh files (glTF, OBJ, PLY) as triangles with texture coordinates and grey textures."""

from pathlib import Path

import numpy as np

from harness.errors import InputError
from harness.images import LUMA, Weights
from harness.simulation.content_cache import cached_by_content
from harness.simulation.mesh_gltf import read_gltf
from harness.simulation.mesh_obj import read_obj
from harness.simulation.mesh_part import MeshPart
from harness.simulation.mesh_ply import read_ply
from harness.spec import LARGEST

FORMATS = {".glb": read_gltf, ".gltf": read_gltf, ".obj": read_obj, ".ply": read_ply}


@cached_by_content(8)
def read_mesh(path: Path, textured: bool = True, weights: Weights = LUMA) -> tuple[MeshPart, ...]:
    """The triangles in a mesh file, with the transforms of its scene graph applied; cached until its files change.

    Parameters
    ----------
    textured
        Whether its materials and textures are read; otherwise no part has any.
    weights
        Weights of red, green and blue in the textures: luma, or another band.

    Raises
    ------
    InputError
        When the file is missing, is of no known format, has features that are not rendered, no triangles, or vertices
        that are not finite.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"not a mesh file; give one of {', '.join(FORMATS)}", file=path)
    with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused below
        parts = [
            part for part in FORMATS[path.suffix.lower()](path, textured=textured, weights=weights) if len(part.corners)
        ]
    for part in parts:
        if not np.isfinite(part.corners).all() or (part.uv is not None and not np.isfinite(part.uv).all()):
            raise InputError("has vertices that are not finite numbers; repair the mesh", file=path)
        if np.abs(part.corners).max() > LARGEST or (part.uv is not None and np.abs(part.uv).max() > LARGEST):
            raise InputError(f"has coordinates beyond {LARGEST:g}; repair the mesh", file=path)
        for array in (part.corners, part.uv):
            if array is not None:
                array.flags.writeable = False
    if not parts:
        raise InputError("has no triangles; give a mesh with faces, not a point cloud", file=path)
    return tuple(parts)
