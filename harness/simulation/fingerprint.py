"""A scene's identity, the same on every machine and for any location of its files."""

import hashlib
import json
from pathlib import Path
from typing import Any

from harness.images import LIMIT_BYTES as IMAGE_LIMIT_BYTES
from harness.simulation.content_cache import FileRead, cached_by_content, recording
from harness.simulation.mesh_file import read_mesh
from harness.simulation.mesh_part import LIMIT_BYTES as MESH_LIMIT_BYTES
from harness.simulation.scene import Mesh, Scene, file_specs
from harness.simulation.texture import texels_of

LARGEST_ASSET_BYTES = max(IMAGE_LIMIT_BYTES, MESH_LIMIT_BYTES)
"""The largest file of a scene, bytes."""


@cached_by_content(64)
def fingerprint(scene: Scene) -> str:
    """SHA-256 (hexadecimal) of a scene: of its settings, with the files' contents instead of their paths.

    The files are those that are actually opened when the scene is read.

    Raises
    ------
    InputError
        When a mesh or texture file is wrong.
    """
    read = files_read(scene)
    contents = {str(path): files[0].sha256 for path, files in read.items()}
    # Files that the scene's files refer to: a texture of a mesh changes the image as the mesh does.
    referenced = [file.sha256 for _, files in sorted(read.items()) for file in files[1:]]
    table = [_replaced(scene.model_dump(mode="json"), contents), referenced]
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def files_read(scene: Scene) -> dict[Path, tuple[FileRead, ...]]:
    """The files that are opened to read each mesh and image of a scene: that file, then those it refers to.

    Raises
    ------
    InputError
        When one of them is wrong.
    """
    read: dict[Path, tuple[FileRead, ...]] = {}
    for spec in file_specs(scene):
        with recording() as files:
            if isinstance(spec, Mesh):
                read_mesh(Path(spec.file), spec.texture is None)
            else:
                texels_of(spec)
        read[Path(spec.file)] = tuple(dict.fromkeys((*files, *read.get(Path(spec.file), ()))))
    return read


def _replaced(value: Any, contents: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(each, contents) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, contents) for each in value]
    return contents.get(value, value) if isinstance(value, str) else value
