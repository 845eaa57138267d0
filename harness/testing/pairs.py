"""The pairs that matchers are tested on: small views of the paper's box, without noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from harness import shipped
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import Mirror
from harness.camera.sensor import Sensor, pixel_directions
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose
from harness.matching.pair import Pair, sharing
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import SecondView, Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.stages import Work
from harness.pipeline.trial import PAIR, REFERENCE
from harness.simulation.scene import load_scene
from harness.simulation.truth import Truth, truth

Mask = NDArray[np.bool_]

ROWS = 160
"""Side of the mirror image, a square: turning it by 90° is exact. A third of the paper's resolution, to be quick."""
GRID = Grid(width_px=240, height_px=66)
OTHER_GRIDS = (Grid(width_px=96, height_px=30), Grid(width_px=300, height_px=40, z_max=0.2, z_min=-0.6))


@dataclass(frozen=True)
class Scenery:
    """A pair and its truth."""

    pair: Pair
    alpha_2: Array
    """True angles, radians."""
    domain: Mask
    """Pixels that both views see, away from the epipoles."""
    work: Work
    """The trial that it comes from."""

    def truth(self, looking: Array) -> tuple[Truth, Array]:
        """The truth along any directions `[rows, columns, 3]` of v1, and the range from viewpoint 2 along the same
        directions, metres.
        """
        trial, poses = self.work.trial, self.work.setup.poses
        every = np.ones(looking.shape[:-1], dtype=bool)
        ground_truth = truth(trial.scene, poses[0], looking, every, pose_2=poses[1], sensor_2=self.pair.sensors[1])
        alike = poses[0].model_copy(update={"position_m": poses[1].position_m})
        return ground_truth, truth(trial.scene, alike, looking, every).range_m


SLANTED = SecondView(azimuth_deg=130.0, elevation_deg=25.0)
TURNED = SecondView(yaw_deg=40.0, pitch_deg=4.0, roll_deg=-3.0)
SENSOR = Sensor(
    camera=Camera(
        width_px=ROWS, height_px=ROWS, focal_px=614.12 * ROWS / 480, cx_px=(ROWS - 1) / 2, cy_px=(ROWS - 1) / 2
    )
)
OTHER_SENSOR = Sensor(
    model=Mirror(a_m=0.030, b_m=0.0234),
    camera=Camera(width_px=224, height_px=208, focal_px=230.0, aspect=1.03, cx_px=104.4, cy_px=108.7),
    lens=Lens(k1=-0.1, p1=0.002),
)
"""Another mirror, focal length, lens, size of image and centre, and somewhat more pixels to the radian."""


@lru_cache(maxsize=8)
def scenery(
    view_2: SecondView = SecondView(),  # noqa: B008 - frozen
    grid: Grid = GRID,
    sensor_2: Sensor | None = None,
    view_1: Pose = Pose(position_m=(0.0, 0.0, 1.0)),  # noqa: B008 - frozen,
) -> Scenery:
    """The paper's box, without noise."""
    scene = load_scene(str(shipped.find("scenes", "box")))
    # The reference is asked for without a matcher's answer; samples in alpha are defined for every baseline.
    trial = Trial(
        scene=scene,
        sensor=SENSOR,
        sensor_2=sensor_2,
        panorama=grid,
        view_1=view_1,
        view_2=view_2,
        matching=WindowMatcher(sampling="alpha"),
    )
    work = Work(trial, StageCache())
    reference, _ = work(REFERENCE)
    return Scenery(work(PAIR), reference.alpha_2, reference.domain, work)


def lopsided() -> Scenery:
    """A pair without symmetries: away from the middle of the box, and along none of its walls."""
    return scenery(
        SecondView(azimuth_deg=70.0, elevation_deg=12.0), view_1=Pose(position_m=(1.5, -0.8, 1.2), yaw_deg=20.0)
    )


def fresh(pair: Pair, *, threads: int | None = None) -> Pair:
    """A copy of the pair without cached results and colours, in memory of its own."""
    first, second = (image.copy() for image in pair.images)
    keys = object(), object()
    return replace(pair, images=(first, second), threads=threads, keys=keys, share=sharing(), bands=None)


def quarter_turn(pair: Pair) -> Pair:
    """The images of the same rig after a turn by 90°, exact to the last bit: phi grows by 90° everywhere."""
    first, second = (np.ascontiguousarray(np.rot90(image, -1)) for image in pair.images)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R, t = pair.motion.R_v2_from_v1, pair.motion.t_v1
    return replace(fresh(pair), images=(first, second), motion=Motion(turn @ R @ turn.T, turn @ t))


def one_image() -> Pair:
    """One image as both views."""
    pair = scenery().pair
    return replace(fresh(pair), images=(pair.images[0], pair.images[0]))


def blank() -> Pair:
    """Images of one grey."""
    pair = scenery().pair
    first, second = (np.where(pixel_directions(each)[1], np.float32(128), np.float32(0)) for each in pair.sensors)
    return replace(fresh(pair), images=(first, second))


PAIRS: dict[str, Callable[[], Pair]] = {
    "easy": lambda: scenery().pair,
    "turned": lambda: scenery(TURNED).pair,
    "up": lambda: scenery(SecondView(elevation_deg=90.0)).pair,
    "slanted": lambda: scenery(SLANTED).pair,
    "grid 1": lambda: scenery(grid=OTHER_GRIDS[0]).pair,
    "grid 2": lambda: scenery(grid=OTHER_GRIDS[1]).pair,
    "sensors": lambda: scenery(TURNED, sensor_2=OTHER_SENSOR).pair,
    "quarter": lambda: quarter_turn(scenery().pair),
    "lopsided": lambda: lopsided().pair,
    "blank": blank,
}
