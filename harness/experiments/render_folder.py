"""One view as a folder that anyone can use without this program: pictures, truth, sensor, pose and scene."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from harness.camera.angles import normalise
from harness.camera.pose import Pose
from harness.camera.sensor import Sensor, in_field, pixel_directions
from harness.experiments.files import make_folder, write
from harness.simulation.export import write_glb
from harness.simulation.render import render
from harness.simulation.scene import Scene
from harness.simulation.truth import truth
from harness.spec import dump_toml
from harness.stereo.panorama import Grid, cylinder, unwrap

README = """\
One view of the scene "{scene}".

omni.png              mirror image, 8 bit grey; 0 outside the image circle
omni.npy              the same before rounding, float32, 0 .. 255, [row = v, column = u]
range.npy             range along the ray of each pixel's centre, float64 metres, NaN outside the image circle
panorama.png          the mirror image on a cylinder around the vertical axis, 8 bit grey, [row = z, column = phi]
panorama_range.npy    range along the ray of each panorama pixel's centre, float64 metres
sensor.toml           the mirror, camera and lens
pose.toml             where the sensor stands in the world, metres and degrees, z up, and the panorama's grid
scene.glb             the scene as glTF 2.0 with textures; glTF's y is our z, glTF's -z is our y

Range is the Euclidean distance from the effective viewpoint (the mirror's inner focus), not a depth along an axis.
The centre of pixel [v, u] is at the integers (u, v). A direction (x, y, z) of unit length in the sensor's frame, z up,
is seen at
    u = cx + focal x / w,   v = cy + focal aspect y / w
    w = (z + 2 e / s),   s = b^2 / (a - e z),   e = sqrt(a^2 + b^2)
before lens distortion. A direction in the world is R (x, y, z), R = Rz(yaw) Ry(pitch) Rx(roll).
Panorama column j is centred at phi = -pi + (j + 0.5) 2 pi / width and row i at
z_max - (i + 0.5) (z_max - z_min) / height; its pixel looks along (cos phi, sin phi, z).
"""


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
    write(folder / "omni.png", _png(image))
    write(folder / "omni.npy", _npy(image))
    write(folder / "range.npy", _npy(truth(scene, pose, directions, seen, wrap_columns=False).range_m))
    write(folder / "panorama.png", _png(np.where(panorama.valid, panorama.values, 0)))
    write(folder / "panorama_range.npy", _npy(truth(scene, pose, around, in_field(sensor, around)).range_m))
    write(folder / "sensor.toml", dump_toml(sensor))
    write(folder / "pose.toml", dump_toml(pose) + "\n[panorama]\n" + dump_toml(grid))
    write_glb(scene, folder / "scene.glb")
    write(folder / "README.txt", README.format(scene=scene.name))


def _png(image: NDArray[np.float32]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def _npy(array: NDArray[np.floating]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()
