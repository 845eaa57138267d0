"""Files that a trial's table names: paths made absolute, scenes and sensors read in."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness import shipped
from harness.errors import InputError
from harness.files import path_of
from harness.io.calibrations.sensors import sensor_of_table
from harness.simulation.scene import load_scene
from harness.source_files import State, state_of
from harness.spec import as_table

SENSORS = ("sensor", "sensor_2")
"""The keys of a trial that may name a sensor's file."""
_SENSOR_FILES = (*SENSORS, *(f"{name}.file" for name in SENSORS))
MASKS = tuple(f"{name}.mask" for name in SENSORS)
"""The keys of a trial that may name a mask's file."""

CALIBRATIONS = ("believed.sigma.calibration", "uncertainty.calibration")
"""The keys of a trial, and of a rig, that may name the file of a calibration's covariance."""


def absolute(key: str, value: Any, folder: Path, file: str | Path, where: str | None = None) -> Any:
    """A value that names a file by a relative path, with its absolute path; any other as it is."""
    last = key.rpartition(".")[2]
    if (last == "command" or key == "matching.files") and isinstance(value, list):
        from harness.matching.program import with_absolute_files

        return with_absolute_files(value, folder, patterns=last == "files")
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else ((key, each) for each in value)
        above = "matching." if isinstance(value, dict) and "command" in value else ""  # a program's table
        above = f"{key}." if isinstance(value, dict) and key in SENSORS else above
        parts = [(name, absolute(f"{above}{name}", each, folder, file, where)) for name, each in items]
        return dict(parts) if isinstance(value, dict) else [each for _, each in parts]
    if not isinstance(value, str):
        return value
    if key == "scene":
        path = _scene_file(value, folder, file, where or key)
        return value if path.parent == shipped.folder("scenes") and path.stem == value else str(path.resolve())
    if key in _SENSOR_FILES and value in shipped.names("sensors") and not (folder / value).exists():
        return value
    if key in (*SENSORS, *MASKS, *CALIBRATIONS) or last == "file" or last.endswith("_file"):
        return str(path_of(value, folder, file=file, key=where or key or None).resolve())
    return value


def of_matcher(key: str, value: Any, folder: Path) -> Any:
    """A key of a trial's table: the files that a matcher's settings name made absolute, all else as it is."""
    return absolute("", value, folder, folder) if key == "matching" and isinstance(value, dict) else value


def _scene_file(name_or_path: str, folder: Path, file: str | Path, key: str) -> Path:
    try:
        return shipped.find("scenes", name_or_path, relative_to=folder)
    except InputError as error:
        raise InputError(f"'{error.file}': {error.problem}", file=file, key=key) from error


def read_in(trial: Mapping[str, Any], folder: Path, file: str | Path | None, key: str) -> dict[str, Any]:
    """The table of a trial with the scene and sensor files that it names read in."""
    resolved = dict(trial)
    where = f"{key}." if key else ""
    scene = resolved.get("scene")
    if isinstance(scene, str):
        path = _scene_file(scene, folder, file or "", f"{where}scene")
        resolved["scene"] = _scene_table(path.resolve())
    elif isinstance(scene, dict):
        resolved["scene"] = absolute("", scene, folder, file or "")
    for name in SENSORS:
        sensor = resolved.get(name)
        if isinstance(sensor, str):
            sensor = {"file": sensor}
        if isinstance(sensor, dict):
            placed = absolute(name, sensor, folder, file or "", f"{where}{name}")
            resolved[name] = sensor_of_table(placed, file, f"{where}{name}") if "file" in placed else placed
    for dotted in CALIBRATIONS:
        *parents, last = dotted.split(".")
        inner = resolved
        for name in parents:
            if not isinstance(inner.get(name), dict):
                break
            inner[name] = dict(inner[name])  # leave the caller's table unchanged
            inner = inner[name]
        else:
            if last in inner:
                inner[last] = absolute(dotted, inner[last], folder, file or "", f"{where}{dotted}")
    return resolved


def _scene_table(path: Path) -> Mapping[str, Any]:
    state = state_of(path)
    return _scene_table_of(path, state) if state else as_table(load_scene(str(path)))


@lru_cache(maxsize=64)
def _scene_table_of(path: Path, _state: State) -> Mapping[str, Any]:
    return as_table(load_scene(str(path)))
