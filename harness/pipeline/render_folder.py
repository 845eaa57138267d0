"""One view as a folder that anyone can use without this program: pictures, truth, sensor, pose and scene."""

from pathlib import Path

from harness.camera.sensor import Sensor, in_field, pixel_directions
from harness.camera.unwrap import unwrap
from harness.files import make_folder, write
from harness.geometry.angles import normalise
from harness.geometry.panorama import Grid, cylinder
from harness.geometry.pose import Pose
from harness.io.view_folder import CAMERA, FILES, PANORAMA, npy, view_files
from harness.simulation.export import write_glb
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import truth

README = f"""\
One view of the scene "{{scene}}".

{FILES}\
range.npy             range along the ray of each pixel's centre, float64 metres, NaN outside the image circle
panorama_range.npy    range along the ray of each panorama pixel's centre, float64 metres
scene.glb             the scene as glTF 2.0 with textures; glTF's y is our z, glTF's -z is our y

Range is the Euclidean distance from the effective viewpoint (the mirror's inner focus), not a depth along an axis.
{CAMERA}
{PANORAMA}"""


def write_render(
    scene: Scene, sensor: Sensor, pose: Pose, folder: Path, *, samples: int = 16, grid: Grid | None = None
) -> None:
    """Render one view with its truth and write the folder.

    Raises
    ------
    InputError
        When the view cannot see the scene, or the folder cannot be written to.
    """
    grid = grid or Grid()
    make_folder(folder)
    image = render(scene, sensor, pose, samples)
    directions, seen = pixel_directions(sensor)
    around = normalise(cylinder(grid))
    panorama = unwrap(image, sensor, grid)
    for name, data in view_files(image, panorama, sensor, pose).items():
        write(folder / name, data)
    write(folder / "range.npy", npy(truth(scene, pose, directions, seen, wrap_columns=False).range_m))
    write(folder / "panorama_range.npy", npy(truth(scene, pose, around, in_field(sensor, around)).range_m))
    write_glb(scene, folder / "scene.glb")
    write(folder / "README.txt", README.format(scene=scene.name))
