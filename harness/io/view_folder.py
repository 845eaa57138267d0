"""One view as files that anyone can read without this program, and how they are described to people."""

import io
import math

import numpy as np
import tomli_w
from numpy.typing import NDArray
from PIL import Image

from harness.camera.central import central_of
from harness.camera.sensor import Sensor, pixel_directions, used
from harness.geometry.angles import Array
from harness.geometry.panorama import Panorama
from harness.geometry.pose import Motion, Pose
from harness.spec import dump_toml

FILES = """\
omni.png              mirror image, 8 bit grey or colour; 0 outside the image circle
omni.npy              the same before rounding, float32, 0 .. 255, [row = v, column = u]; colours have a third axis
panorama.png          the mirror image on a cylinder around the vertical axis, 8 bit, [row = z, column = phi]
panorama.npy          the same before rounding, float32; NaN where the sensor does not see all of a pixel
rays.npy              unit direction (x, y, z) that the centre of each pixel sees, in the sensor's frame, z up; float32,
                      [row = v, column = u, 3], NaN where it sees nothing: true of any camera
sensor.toml           the camera model and its parameters; each view's own, as the two may differ
mask.png              white where pixels are used, black where they show the robot itself; only if the sensor has a mask
pose.toml             where the sensor stands in the world, metres and degrees, z up, and the panorama's grid
"""

CAMERA = """\
The centre of pixel [v, u] is at the integers (u, v). A hyperboloid mirror, mounted as it is by default, sees a
direction (x, y, z) of unit length in the sensor's frame, z up, at
    u = cx + focal x / w,   v = cy + focal aspect y / w
    w = (z + 2 e / s),   s = b^2 / (a - e z),   e = sqrt(a^2 + b^2)
before skew and lens distortion. For other cameras go by rays.npy. A direction in the world is R (x, y, z),
R = Rz(yaw) Ry(pitch) Rx(roll), which is R_world_from_view in pose.toml, row by row.
"""

PANORAMA = """\
Panorama column j is centred at phi = -pi + (j + 0.5) 2 pi / width and row i, row 0 at the top, at
z_max - (i + 0.5) (z_max - z_min) / height; its pixel looks along (cos phi, sin phi, z). Column 0 is next to the last.
"""


def view_files(
    image: NDArray[np.float32], panorama: Panorama, sensor: Sensor, pose: Pose, R_world_from_view: Array | None = None
) -> dict[str, bytes]:
    """The files of one view, by name: those of `FILES`.

    Parameters
    ----------
    image
        `[sensor height, sensor width]`, grey levels, or `[..., 3]`, red, green and blue; as the panorama.
    sensor
        The rays are those of the aligned, or nearest central, sensor, should its rays meet in no point.
    R_world_from_view
        `[3, 3]`, where it is known better than to the rounding of the pose's angles.
    """
    rotation = pose.R_world_from_view if R_world_from_view is None else R_world_from_view
    rays, valid = pixel_directions(central_of(sensor))
    placed = dump_toml(pose) + tomli_w.dumps({"R_world_from_view": rotation.tolist()})
    valid_pixels = panorama.valid if panorama.values.ndim == 2 else panorama.valid[..., None]
    return {
        "omni.png": png(image),
        "omni.npy": npy(image),
        "panorama.png": png(np.where(valid_pixels, panorama.values, np.float32(0))),
        "panorama.npy": npy(np.where(valid_pixels, panorama.values, np.float32(np.nan))),
        "rays.npy": npy(np.where(valid[..., None], rays, np.nan).astype(np.float32)),
        **sensor_files(sensor),
        "pose.toml": (placed + "\n[panorama]\n" + dump_toml(panorama.grid)).encode(),
    }


def sensor_files(sensor: Sensor) -> dict[str, bytes]:
    """`sensor.toml`, and `mask.png`, which it names, if the sensor has a mask."""
    pixels = used(sensor)
    if pixels is None:
        return {"sensor.toml": dump_toml(sensor).encode()}
    bare = dump_toml(sensor.model_copy(update={"mask": None}))
    return {
        "sensor.toml": f'mask = "mask.png"\n{bare}'.encode(),
        "mask.png": png(np.where(pixels, np.float32(255), np.float32(0))),
    }


def pose_in(motion: Motion) -> Pose:
    """View 2's pose in v1's frame: `Rz(yaw) Ry(pitch) Rx(roll) = R_v2_from_v1^T`; roll is 0 where it is not defined."""
    R = motion.R_v2_from_v1.T
    x, y, z = motion.t_v1.tolist()
    level = math.hypot(R[0, 0], R[1, 0])
    if level > 1e-9:
        yaw, roll = math.atan2(R[1, 0], R[0, 0]), math.atan2(R[2, 1], R[2, 2])
    else:  # looking straight up or down: only yaw and roll together have a meaning
        yaw, roll = math.atan2(-R[0, 1], R[1, 1]), 0.0
    pitch = math.atan2(-R[2, 0], level)
    yaw_deg, pitch_deg, roll_deg = (math.degrees(angle) for angle in (yaw, pitch, roll))
    return Pose(position_m=(x, y, z), yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)


def png(image: NDArray[np.float32]) -> bytes:
    """An 8 bit picture, grey `[height, width]` or in colour `[height, width, 3]`."""
    stream = io.BytesIO()
    Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def npy(array: NDArray[np.floating]) -> bytes:
    """NumPy's own format."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()
