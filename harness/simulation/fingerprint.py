"""A scene's identity: the same on every machine, wherever its files lie."""

import hashlib
import json
from functools import lru_cache
from typing import Any

from harness.simulation.scene import Scene, assets


@lru_cache(maxsize=64)
def fingerprint(scene: Scene) -> str:
    """SHA-256 (hexadecimal) of what makes the scene: its settings, and its files' contents in place of their paths.

    Kept for the life of the process: a file is not expected to change under a running experiment.
    """
    contents = {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in assets(scene)}
    table = _replaced(scene.model_dump(mode="json"), contents)
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def _replaced(value: Any, contents: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(each, contents) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, contents) for each in value]
    return contents.get(value, value) if isinstance(value, str) else value
