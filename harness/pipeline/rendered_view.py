"""One view of a scene with its truth, and as a folder that can be used without this program."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.camera.central import central_of
from harness.camera.sensor import Sensor, in_use, pixel_directions
from harness.camera.unwrap import unwrap
from harness.camera.visible_rows import with_rows
from harness.display import OneLine, grey, html_figure
from harness.errors import InputError
from harness.files import OwnFiles, check_empty_or_own, make_folder, write
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, Panorama, directions
from harness.geometry.pose import Pose
from harness.io.view_folder import CAMERA, FILES, PANORAMA, npy, view_files
from harness.pipeline.sight import check_mirror, check_sensor
from harness.simulation.export import write_glb
from harness.simulation.pov import README as POV_README
from harness.simulation.pov import check_pov, write_pov
from harness.simulation.reflected import points_seen
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import truth

_BEGINNING = 'One view of the scene "'
README = f"""\
{_BEGINNING}{{scene}}".

{FILES}\
range.npy             range along the ray of each pixel's centre, float64 metres, NaN outside the image circle
panorama_range.npy    range along the ray of each panorama pixel's centre, float64 metres
scene.glb             the scene as glTF 2.0 with textures; glTF's y is our z, glTF's -z is our y

Range is the Euclidean distance from the effective viewpoint (the mirror's inner focus), not a depth along an axis.
{CAMERA}
{PANORAMA}"""
OF_A_RENDERED_VIEW = OwnFiles("view", {"README.txt": _BEGINNING.encode()}, {"pose.toml": b"R_world_from_view"})
"""How a folder with a view is known."""

MISALIGNED = """
The camera is misaligned with its mirror: omni.* and range.npy are what it sees. points.npy has the point that the ray
of each pixel's centre meets, float64 metres in the sensor's frame, [row = v, column = u, 3]; range.npy is its distance
from the mirror's inner focus, and not along the ray, which begins on the mirror. rays.npy, panorama.* and
panorama_range.npy are of the aligned sensor, as whoever does not know of the misalignment takes it to be.
"""

PROFILE = """
The rays of this mirror meet in no point: omni.* and range.npy are what it sees. points.npy has the point that the ray
of each pixel's centre meets, float64 metres in the sensor's frame, [row = v, column = u, 3]; range.npy is its distance
from the sensor's origin, and not along the ray, which begins on the mirror. rays.npy, panorama.* and
panorama_range.npy are of the central camera that comes nearest to the mirror's rays at a distance of 3 m.
"""


@dataclass(frozen=True, eq=False, repr=False)
class RenderedView(OneLine):
    """One view of a scene with its truth. Missing is NaN."""

    image: NDArray[np.float32]
    """`[sensor height, sensor width]`: the mirror image, grey levels of 0 .. 255; 0 where the sensor sees nothing. Of a
    view in colour `[sensor height, sensor width, 3]`: red, green and blue."""
    range_m: Array
    """`[sensor height, sensor width]`: range along the ray of each pixel's centre, metres; NaN outside the image
    circle."""
    panorama: NDArray[np.float32]
    """`[height, width]` of the grid, or `[height, width, 3]`: the mirror image on the cylinder; NaN where the sensor
    sees nothing."""
    panorama_range_m: Array
    """`[height, width]` of the grid: range along the ray of each panorama pixel's centre, metres."""
    scene: Scene
    sensor: Sensor
    pose: Pose
    grid: Grid
    points_m: Array | None = None
    """`[sensor height, sensor width, 3]`, for a sensor without a viewpoint: the point that the ray of each pixel's
    centre meets, in the sensor's frame, metres. `range_m` is its distance from the sensor's origin. The panorama and
    its ranges are those of the aligned, or nearest central, sensor."""

    def write(self, folder: str | Path, *, pov: bool = False) -> None:
        """Write the view into a folder that can be used without this program: see its README.txt.

        Parameters
        ----------
        folder
            Made if it is not there.
        pov
            Write the view as a scene of POV-Ray too, with its physical mirror: `scene.pov`, `scene.ini`, textures.

        Raises
        ------
        InputError
            When the folder holds other files or cannot be written to, or POV-Ray has no camera like the sensor's.
        """
        if pov:
            check_pov(self.sensor)
        folder = Path(folder)
        check_empty_or_own(folder, OF_A_RENDERED_VIEW)
        make_folder(folder)
        write(folder / "README.txt", self._readme(pov=pov))  # first: a folder left half-written is known as ours
        known = np.isfinite(self.panorama if self.panorama.ndim == 2 else self.panorama.sum(axis=-1))
        panorama = Panorama(self.grid, self.panorama, known)
        for name, data in view_files(self.image, panorama, self.sensor, self.pose).items():
            write(folder / name, data)
        write(folder / "range.npy", npy(self.range_m))
        write(folder / "panorama_range.npy", npy(self.panorama_range_m))
        write_glb(self.scene, folder / "scene.glb", colour=self.image.ndim == 3)
        if pov:
            write_pov(self.scene, self.sensor, self.pose, folder)
        if self.points_m is not None:
            write(folder / "points.npy", npy(self.points_m))

    def _readme(self, *, pov: bool) -> str:
        text = README.format(scene=self.scene.name) + POV_README * pov
        return text if self.points_m is None else text + (MISALIGNED if self.sensor.profile is None else PROFILE)

    def _repr_html_(self) -> str:
        """The mirror image and the panorama as one sees it from inside: azimuth descends to the right."""
        pictures = {"mirror image": grey(self.image), "panorama": grey(self.panorama[:, ::-1])}
        return html_figure(pictures, f"{self.scene.name}, seen from {self.pose.position_m} m")


def view_of(
    scene: Scene, sensor: Sensor, pose: Pose, *, samples: int = 16, grid: Grid | None = None, colour: bool = False
) -> RenderedView:
    """Render one view with its truth.

    Parameters
    ----------
    samples
        Rays in each pixel, a square number, at least; more where they are too wide for a texture or an outline.
    grid
        The pixels of the panorama.
    colour
        Render red, green and blue.

    Raises
    ------
    InputError
        When the view cannot see the scene, or the sensor sees nothing.
    """
    assumed, points_m = central_of(sensor), None
    try:
        grid = with_rows(grid or Grid(), (assumed,))
    except ValueError as error:
        raise InputError(str(error), key="panorama") from error
    check_sensor(assumed, grid)
    check_mirror(sensor)
    image = render(scene, sensor, pose, samples, colour=colour)
    around = directions(grid)
    if sensor.is_central:
        rays, inside = pixel_directions(sensor)
        range_m = truth(scene, pose, rays, inside, wrap_columns=False).range_m
    else:
        points = points_seen(scene, sensor, pose)
        points_m, range_m = points.point_m, points.range_m
    return RenderedView(
        image=image,
        range_m=range_m,
        panorama=_unwrapped(image, assumed, grid),
        panorama_range_m=truth(scene, pose, around, in_use(assumed, around)).range_m,
        scene=scene,
        sensor=sensor,
        pose=pose,
        grid=grid,
        points_m=points_m,
    )


def _unwrapped(image: NDArray[np.float32], sensor: Sensor, grid: Grid) -> NDArray[np.float32]:
    """The panorama of an image, grey or in colour; NaN where the sensor sees nothing."""
    if image.ndim == 3:
        return np.stack([_unwrapped(np.ascontiguousarray(band), sensor, grid) for band in image.T.swapaxes(1, 2)], -1)
    panorama = unwrap(image, sensor, grid)
    return np.where(panorama.valid, panorama.values, np.float32(np.nan))
