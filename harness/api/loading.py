"""Experiments, scenes and sensors from names, files, tables or objects."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness.camera.mount import Looks, camera_from_sensor
from harness.camera.sensor import Sensor, check_mask, lens_from_sensor
from harness.errors import InputError
from harness.geometry.pose import Motion
from harness.io.calibrations.sensors import Chosen, sensor_of_table
from harness.io.calibrations.sensors import load_sensor as load_calibrated_sensor
from harness.io.motions import Frame, read_motion
from harness.runs import load as _load
from harness.runs.experiment import Experiment
from harness.simulation import scene as _scene
from harness.simulation.scene import Scene
from harness.spec import parse


def load_experiment(
    experiment: str | Path | Mapping[str, Any] | Experiment,
    *,
    axes: Mapping[str, Sequence[Any]] | None = None,
    cases: Mapping[str, Mapping[str, Any]] | None = None,
    sets: Mapping[str, Any] | None = None,
) -> Experiment:
    """Read an experiment, with changed axes, cases and settings.

    Parameters
    ----------
    experiment
        A shipped name, the path of a TOML file, a table like that of a file, or an experiment.
    axes
        Dotted keys of a trial and the values of each: further axes, or other values of an existing one.
    cases
        Names, each with dotted keys of a trial and their values: cases instead of the experiment's own.
    sets
        Dotted keys of a trial and values: settings of the base trial. The experiment's axis over a key is dropped.

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
    Experiment('paper', 48 trials: seed (12), matching.subpixel (2), matching.window_px (2))
    >>> rigs = {"1280x960, 0.3 m": {"view_2.baseline_m": 0.3, "noise.sigma_grey": 4}, "as it is": {}}
    >>> harness.load_experiment("paper", cases=rigs)
    Experiment('paper', 48 trials: seed (12), matching.subpixel (2), 2 cases)
    >>> harness.load_experiment({"name": "mine", "trial": {"scene": "corridor"}}).trial.matching.window_px
    11
    """
    return _load.load_experiment(experiment, sets or {}, axes or {}, cases)


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


def load_sensor(
    sensor: str | Path | Mapping[str, Any] | Sensor | None = None,
    *,
    camera: int | None = None,
    looks: Looks | None = None,
    mirrored: bool | None = None,
    size: tuple[int, int] | None = None,
    angle_max_deg: float | None = None,
    elevation_deg: tuple[float, float] | None = None,
) -> Sensor:
    """Read a sensor.

    Parameters
    ----------
    sensor
        The path of a sensor's TOML, or of a calibration file of another program; a table like that of a sensor's TOML,
        or a sensor; the default sensor when None.
    camera
        The number of the camera in a calibration file with several, from 0.
    looks, mirrored
        How the camera is mounted, which no calibration contains: where the optical axis points, `up` (the default),
        `down` or `forward`, and whether its image is reversed left to right (by default not). A camera below a mirror
        looks down and is mirrored.
    size
        Width and height in pixels, for a calibration that does not contain them.
    angle_max_deg, elevation_deg
        The field of view: the largest angle off the optical axis, and the lowest and the highest elevation, degrees; by
        default as far as model and image allow.

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
    chosen = Chosen(camera, looks, mirrored, size, angle_max_deg, elevation_deg)
    if isinstance(sensor, str | Path):
        return load_calibrated_sensor(Path(sensor), chosen)
    if chosen != Chosen():
        raise InputError("is not a file; set these values in its tables", key="sensor")
    if isinstance(sensor, Mapping):
        loaded = parse(Sensor, sensor_of_table(sensor, "sensor") if "file" in sensor else sensor, file="sensor")
        check_mask(loaded, file="sensor")
        return loaded
    return Sensor() if sensor is None else sensor


def load_motion(
    file: str | Path,
    first: int | None = None,
    second: int | None = None,
    *,
    sensor: Sensor | None = None,
    sensor_2: Sensor | None = None,
    frame: Frame | None = None,
    looks: Looks = "up",
    mirrored: bool = False,
) -> Motion:
    """Read the motion from view 1 to view 2, between the sensors' frames, z up.

    Parameters
    ----------
    file
        View 2's pose in view 1's frame, TOML as `omnirange motion` writes it; a calibration file of a rig, such as a
        Kalibr camchain; or a trajectory in TUM's format (`time x y z qx qy qz qw`) or KITTI's (3 x 4 matrices).
    first, second
        Numbers of the rig's cameras or of the trajectory's poses, from 0; by default the first two, if a trajectory has
        no others.
    sensor, sensor_2
        The sensors of views 1 and 2; `sensor_2` is `sensor` when None. Their mounts convert a motion between lenses to
        one between sensors.
    frame
        The frame of a trajectory's poses, which the file does not contain: `sensor`, z up, or `lens`, X along u, Y
        along v, Z along the optical axis.
    looks, mirrored
        How both cameras are mounted if no sensor is given; see `load_sensor`.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        When the file cannot be read, or does not contain the poses of both views.

    Examples
    --------
    >>> import harness
    >>> motion = harness.load_motion("camchain.yaml", looks="forward")  # doctest: +SKIP
    >>> motion = harness.load_motion("trajectory.txt", 0, 10, frame="sensor")  # doctest: +SKIP
    """
    if (first is None) != (second is None):
        raise InputError("give both views' numbers or none", key="second" if second is None else "first")
    views = None if first is None or second is None else (first, second)
    first_lens = camera_from_sensor(looks, mirrored=mirrored) if sensor is None else lens_from_sensor(sensor)
    second_lens = first_lens if sensor_2 is None else lens_from_sensor(sensor_2)
    return read_motion(Path(file), (first_lens, second_lens), views, frame, both="relative_motion(first, second)")
