"""One pair of a data set: both images and everything that is true of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, pixel_directions, project, seam_px
from harness.datasets.rigs import draw_poses, draw_sensors
from harness.datasets.rooms import DrawnRoom
from harness.datasets.specification import DatasetSpec, number_between
from harness.geometry.angles import Array
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.simulation.cast import rotated
from harness.simulation.noise import generator
from harness.simulation.render import render, render_with_range
from harness.simulation.scene import Scene
from harness.simulation.truth import Truth, ranges, truth

Image = NDArray[np.uint8]

NOT_SEEN, VISIBLE, OCCLUDED, OUTSIDE, SKY = range(5)
"""The states of view 1's pixels: outside its field; seen by both views; hidden from view 2; beyond the image of view 2;
nothing there."""
STATES = {
    NOT_SEEN: "view 1's camera sees nothing here",
    VISIBLE: "visible in both views",
    OCCLUDED: "in view 2's image, hidden by something else",
    OUTSIDE: "outside view 2's image",
    SKY: "sky: no surface, no range",
}


@dataclass(frozen=True, eq=False)
class Pair:
    """Both images of a pair, its geometry and its truth. Arrays are `[height, width]` of view 1 unless stated."""

    scene_number: int
    number: int
    """Within its scene."""
    scene: Scene
    sensors: tuple[Sensor, Sensor]
    poses: tuple[Pose, Pose]
    motion: Motion
    images: tuple[Image, Image]
    """Grey `[height, width]`, or red, green and blue `[height, width, 3]`."""
    range_m: tuple[Array, Array]
    """Ranges of both views, metres; NaN where a pixel sees no surface."""
    match: Array
    """`[height, width, 2]`: where view 2's image has the point, (u, v) in pixels; NaN where it is not on that image.
    Known of hidden points, too."""
    state: NDArray[np.uint8]
    """The states of view 1's pixels; see `STATES`."""
    normal: Array
    """`[height, width, 3]`: unit normals towards view 1, in view 1's frame; NaN where there is no surface."""
    sigma_grey: float
    """Standard deviation of the noise, grey levels."""
    gain: float
    """Exposure of view 2 against view 1."""
    threads: int | None = 1
    """Threads for further ray tracing."""


def make_pair(spec: DatasetSpec, room: DrawnRoom, scene: int, number: int, threads: int | None = 1) -> Pair:
    """Render a pair with its truth; the same whenever, wherever and with however many threads.

    Raises
    ------
    InputError
        When the room has no free place for the rig.
    """
    placed = room.scene()
    sensors, poses = draw_sensors(spec, scene), draw_poses(spec, room, scene, number)
    motion = relative_motion(*poses)
    draws = generator(spec.seed, "dataset", "image", str(scene), str(number))
    sigma_grey = float(number_between(spec.noise.sigma_grey, draws.random()))
    gain = float(np.exp(0.01 * spec.noise.gain_percent * draws.standard_normal()))
    directions, in_field = pixel_directions(sensors[0])
    light_1 = render(placed, sensors[0], poses[0], spec.samples, threads, colour=spec.colour)
    if spec.colour:
        light_2 = render(placed, sensors[1], poses[1], spec.samples, threads, colour=True)
        range_2 = ranges(placed, poses[1], *pixel_directions(sensors[1]), threads=threads)
    else:
        light_2, range_2 = render_with_range(placed, sensors[1], poses[1], spec.samples, threads)
    true = truth(
        placed,
        poses[0],
        directions,
        in_field,
        pose_2=poses[1],
        sensor_2=sensors[1],
        wrap_columns=seam_px(sensors[0]) > 0,
        threads=threads,
    )
    has_surface = np.isfinite(true.range_m)
    points = directions[has_surface] * true.range_m[has_surface, None]
    pixels, on_image_2 = project(sensors[1], rotated(points - motion.t_v1, motion.R_v2_from_v1))
    match, normal = np.full((*has_surface.shape, 2), np.nan), np.full((*has_surface.shape, 3), np.nan)
    match[has_surface] = np.where(on_image_2[:, None], pixels, np.nan)
    normal[has_surface] = rotated(true.normal[has_surface], poses[0].R_world_from_view.T)
    return Pair(
        scene_number=scene,
        number=number,
        scene=placed,
        sensors=sensors,
        poses=poses,
        motion=motion,
        images=(
            _photograph(light_1, sensors[0], sigma_grey, draws),
            _photograph(gain * light_2, sensors[1], sigma_grey, draws),
        ),
        range_m=(true.range_m, range_2),
        match=match,
        state=_states(true, in_field),
        normal=normal,
        sigma_grey=sigma_grey,
        gain=gain,
        threads=threads,
    )


def _states(true: Truth, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    state = np.full(seen.shape, NOT_SEEN, dtype=np.uint8)
    state[seen] = SKY
    has_surface = np.isfinite(true.range_m)
    state[has_surface] = OUTSIDE
    state[has_surface & true.in_field_2] = OCCLUDED
    state[true.visible] = VISIBLE
    return state


def _photograph(light: NDArray[np.floating], sensor: Sensor, sigma_grey: float, draws: np.random.Generator) -> Image:
    """An image of 8 bits, with noise where the sensor sees something."""
    in_field = pixel_directions(sensor)[1]
    noise = sigma_grey * draws.standard_normal(light.shape, dtype=np.float32)
    noise *= in_field if light.ndim == 2 else in_field[..., None]
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
