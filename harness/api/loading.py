"""Experiments, scenes and sensors from names, files, tables or objects."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness.camera import sensor as _sensor
from harness.camera.sensor import Sensor
from harness.runs import load as _load
from harness.runs.experiment import Experiment
from harness.simulation import scene as _scene
from harness.simulation.scene import Scene
from harness.spec import parse


def load_experiment(
    experiment: str | Path | Mapping[str, Any] | Experiment,
    *,
    axes: Mapping[str, Sequence[Any]] | None = None,
    sets: Mapping[str, Any] | None = None,
) -> Experiment:
    """Read an experiment, and change it.

    Parameters
    ----------
    experiment
        A shipped name, the path of a TOML file, a table like that of a file, or an experiment.
    axes
        Dotted keys of a trial and the values that each takes: further axes, or other values of one that is there.
    sets
        Dotted keys of a trial and values: settings of the base trial; an axis over the same key is dropped.

    Returns
    -------
    Experiment

    Raises
    ------
    InputError
        One line that names the file or the argument, the key and what would be right.

    Examples
    --------
    >>> import harness
    >>> harness.load_experiment("paper", axes={"matching.window_px": [7, 11]})
    Experiment('paper', 4 trials: matching.subpixel (2), matching.window_px (2))
    >>> harness.load_experiment({"name": "mine", "trial": {"scene": "corridor"}}).trial.matching.window_px
    11
    """
    return _load.load_experiment(experiment, sets or {}, axes or {})


def load_scene(scene: str | Path | Mapping[str, Any] | Scene) -> Scene:
    """Read a scene.

    Parameters
    ----------
    scene
        A shipped name (`box`, `corridor`, `room`), the path of a TOML file, a table like that of a file, or a scene.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        One line that names the file, the key and what would be right.

    Examples
    --------
    >>> import harness
    >>> harness.load_scene("box").objects[0].size_m
    (6.0, 6.0, 6.0)
    """
    return scene if isinstance(scene, Scene) else _scene.load_scene(scene)


def load_sensor(sensor: str | Path | Mapping[str, Any] | Sensor | None = None) -> Sensor:
    """Read a sensor.

    Parameters
    ----------
    sensor
        The path of a TOML file, a table like that of a file, or a sensor; the default sensor when None.

    Returns
    -------
    Sensor

    Raises
    ------
    InputError
        One line that names the file, the key and what would be right.

    Examples
    --------
    >>> import harness
    >>> sensor = harness.load_sensor({"camera": {"width_px": 1280, "cx_px": 639.5}})
    >>> sensor.camera.width_px, sensor.model.a_m
    (1280, 0.0281)
    """
    if sensor is None:
        return Sensor()
    if isinstance(sensor, Sensor):
        return sensor
    if isinstance(sensor, Mapping):
        return parse(Sensor, sensor, file="sensor")
    return _sensor.load_sensor(Path(sensor))
