"""A scene's identity: the same on every machine, wherever its files lie."""

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
"""The largest file that a scene is made of."""


@cached_by_content(64)
def fingerprint(scene: Scene) -> str:
    """SHA-256 (hexadecimal) of what makes the scene: its settings, and its files' contents in place of their paths.

    The files are those that are opened when the scene is read, and no list made beside that.

    Raises
    ------
    InputError
        When a mesh or texture file is wrong.
    """
    read = files_read(scene)
    contents = {str(path): files[0].sha256 for path, files in read.items()}
    # Files that the scene's files name in their turn: a texture beside a mesh changes the picture as the mesh does.
    beside = [file.sha256 for _, files in sorted(read.items()) for file in files[1:]]
    table = [_replaced(scene.model_dump(mode="json"), contents), beside]
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def files_read(scene: Scene) -> dict[Path, tuple[FileRead, ...]]:
    """The files that are opened to read each mesh and image that a scene names: itself, then others.

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
