"""One rendered view."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from harness.api.loading import load_scene, load_sensor
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Pose
from harness.pipeline.rendered_view import RenderedView, view_of
from harness.pipeline.specification import Rendering
from harness.simulation.scene import Scene
from harness.spec import parse


def render(
    scene: str | Path | Mapping[str, Any] | Scene,
    *,
    sensor: str | Path | Mapping[str, Any] | Sensor | None = None,
    position_m: Sequence[float] = (0.0, 0.0, 1.0),
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    samples: int = 16,
    grid: Grid | None = None,
    colour: bool = False,
) -> RenderedView:
    """Render one view of a scene, with its true range.

    Parameters
    ----------
    scene
        A shipped name, the path of a TOML file, a table, or a scene.
    sensor
        The path of a TOML file, a table, or a sensor; the default sensor when None.
    position_m
        Viewpoint (x, y, z) in the world, metres.
    yaw_deg, pitch_deg, roll_deg
        Rotation of the sensor about z, then y, then x, degrees.
    samples
        Least number of rays per pixel, a square number; more where a texture or an outline needs them.
    grid
        The grid of the panorama; 720 x 200 pixels when None.
    colour
        Render red, green and blue: `image` and `panorama` then have a third axis. Their luma is the grey image.

    Returns
    -------
    RenderedView
        `image` and `range_m` of the mirror image, `panorama` and `panorama_range_m` on the cylinder; `write(folder)`.

    Raises
    ------
    InputError
        When an argument is invalid, the viewpoint is outside the scene, or no pixel is in the sensor's field.

    Examples
    --------
    >>> import harness
    >>> view = harness.render("box", position_m=(0, 0, 1), samples=1)
    >>> view.image.shape, view.panorama.shape
    ((480, 640), (200, 720))
    >>> float(view.panorama_range_m[39, 360].round(3))  # the wall 3 m away, at the horizon
    3.0
    """
    numbers = {"yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    try:
        position = [float(each) for each in position_m]
    except (TypeError, ValueError):
        raise InputError(f"must be three numbers, metres; found {position_m!r}", key="position_m") from None
    pose = parse(Pose, {"position_m": position, **{name: float(value) for name, value in numbers.items()}})
    samples = parse(Rendering, {"samples": samples}).samples
    loaded = load_scene(scene)
    try:
        return view_of(loaded, load_sensor(sensor), pose, samples=samples, grid=grid, colour=colour)
    except InputError as error:
        if error.file != loaded.name or not isinstance(scene, str | Path):
            raise
        raise InputError(error.problem, file=scene, key=error.key) from error
