"""A scene's identity: the same on every machine, wherever its files lie."""

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness.simulation.mesh_file import companions
from harness.simulation.scene import Scene, assets


@lru_cache(maxsize=64)
def fingerprint(scene: Scene) -> str:
    """SHA-256 (hexadecimal) of what makes the scene: its settings, and its files' contents in place of their paths.

    Kept for the life of the process: a file is not expected to change under a running experiment.
    """
    contents = {str(path): _hash_of(path) for path in assets(scene)}
    # Files that the scene's files name in their turn: a texture beside a mesh changes the picture as the mesh does.
    beside = [_hash_of(companion) for path in assets(scene) for companion in companions(path)]
    table = [_replaced(scene.model_dump(mode="json"), contents), beside]
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def _hash_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _replaced(value: Any, contents: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(each, contents) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, contents) for each in value]
    return contents.get(value, value) if isinstance(value, str) else value
