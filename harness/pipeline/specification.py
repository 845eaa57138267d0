"""The settings of a trial: one run of the pipeline."""

import hashlib
import json
import math
from typing import Annotated

from pydantic import Field, model_validator

from harness.camera.sensor import Sensor
from harness.camera.unwrap import Interpolation
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion, translated
from harness.matching.registry import Matcher
from harness.matching.registry import fingerprint as matcher_fingerprint
from harness.matching.window.settings import WindowMatcher
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator
from harness.simulation.scene import Scene
from harness.spec import Finite, Positive, Spec


class SecondView(Spec):
    """The second view: a baseline from the first one, in a direction of the world, and a rotation of its own.

    Half a metre along x, unrotated, as in the paper. The rotation is in the world's frame, as the first view's.
    """

    baseline_m: Positive = 0.5
    azimuth_deg: Finite = 0.0
    elevation_deg: Finite = 0.0
    yaw_deg: Finite = 0.0
    pitch_deg: Finite = 0.0
    roll_deg: Finite = 0.0

    def pose(self, view_1: Pose) -> Pose:
        """Where the second view stands, given the first."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        moved = translated(
            view_1,
            (
                self.baseline_m * math.cos(elevation) * math.cos(azimuth),
                self.baseline_m * math.cos(elevation) * math.sin(azimuth),
                self.baseline_m * math.sin(elevation),
            ),
        )
        return moved.model_copy(
            update={"yaw_deg": self.yaw_deg, "pitch_deg": self.pitch_deg, "roll_deg": self.roll_deg}
        )


class Rendering(Spec):
    """How a pixel is made: the mean of `samples` rays on a square grid inside it."""

    samples: Annotated[int, Field(ge=1, le=1024)] = 16

    @model_validator(mode="after")
    def _square(self) -> "Rendering":
        if math.isqrt(self.samples) ** 2 != self.samples:
            raise ValueError(f"samples must be a square number (1, 4, 9, 16, ...); found {self.samples}")
        return self


class Noise(Spec):
    """White Gaussian noise on the mirror images, in grey levels of 0 .. 255."""

    sigma_grey: Annotated[float, Field(ge=0, le=255)] = 0.0


class Exposure(Spec):
    """How the second camera differs from the first one in its answer to light: `gain * grey + offset`."""

    gain: Positive = 1.0
    offset_grey: Finite = 0.0


class Placement(Spec):
    """What the seed draws of where the rig stands, so that a trial is not about one lucky place.

    `offset_m`: both views are moved alike by up to this much along x, y and z, evenly. `random_yaw`: both views are
    turned alike by any angle; the baseline keeps its direction in the world, and so takes any in the panorama.
    """

    offset_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    random_yaw: bool = False


class Unwrapping(Spec):
    """How the mirror image becomes a panorama."""

    interpolation: Interpolation = "bilinear"


class Filter(Spec):
    """The Laplacian of Gaussian; 0 for none.

    At 1 px the noise of the unwrapping's interpolation makes the sub-pixel error on walls a fifth larger than at 1.5.
    """

    log_sigma_px: Annotated[float, Field(ge=0, le=50)] = 1.5


class Scoring(Spec):
    """What is kept of a trial beyond its figures.

    - `sample_px`: the errors of every so many rows and columns, for what needs pixels of several trials at once, such
      as the spread over seeds; 0 for none.
    - `bound`: the Cramér-Rao bound of the matcher's own window in every cell of surface, direction and range.
    - `confidence`: how well the matcher's confidence puts its errors in order, which takes as long as all figures.
    """

    sample_px: Annotated[int, Field(ge=0, le=256)] = 0
    bound: bool = False
    confidence: bool = False


class Trial(Spec):
    """One run of the pipeline, from a scene to an error."""

    scene: Scene
    sensor: Sensor = Sensor()
    view_1: Pose = Pose(position_m=(0.0, 0.0, 1.0))
    view_2: SecondView = SecondView()
    placement: Placement = Placement()
    render: Rendering = Rendering()
    exposure_2: Exposure = Exposure()
    noise: Noise = Noise()
    panorama: Grid = Grid()
    unwrap: Unwrapping = Unwrapping()
    filter: Filter = Filter()
    matching: Matcher = WindowMatcher()
    scoring: Scoring = Scoring()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of all that is random: placement and noise."""

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that name these settings, on any machine: a scene counts by its contents,
        and so does a matcher from elsewhere.

        Raises
        ------
        InputError
            When such a matcher cannot be found.
        """
        settings = self.model_dump(mode="json") | {"scene": fingerprint(self.scene)}
        if matcher := matcher_fingerprint(self.matching):
            settings["matcher"] = matcher
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def poses(self) -> tuple[Pose, Pose]:
        """Where both views stand, with what the seed draws."""
        view_2 = self.view_2.pose(self.view_1)
        place = self.placement
        if place.offset_m == 0 and not place.random_yaw:
            return self.view_1, view_2
        draws = generator(self.seed, "placement", fingerprint(self.scene))
        x, y, z = (place.offset_m * draws.uniform(-1, 1, 3)).tolist()
        yaw_deg = float(draws.uniform(0, 360)) if place.random_yaw else 0.0
        first, second = (
            translated(view, (x, y, z)).model_copy(update={"yaw_deg": view.yaw_deg + yaw_deg})
            for view in (self.view_1, view_2)
        )
        return first, second

    @property
    def motion(self) -> Motion:
        """From view 1 to view 2."""
        return relative_motion(*self.poses)
