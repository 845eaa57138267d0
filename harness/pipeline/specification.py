"""The settings of a trial: one run of the pipeline."""

import hashlib
import json
import math
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from harness.camera.central import central_of
from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor
from harness.camera.unwrap import Interpolation
from harness.camera.visible_rows import is_open, with_rows
from harness.errors import InputError, with_article
from harness.evaluation.rig_uncertainty import Odometry, Uncertainty
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion, translated
from harness.localisation.settings import Localisation
from harness.mapping.settings import OccupancyMap, Scan
from harness.matching.registry import Matcher
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.believed import Believed, draws_of, misaligned
from harness.simulation.chip import Chip
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator
from harness.simulation.optics import Optics
from harness.simulation.scene import Scene
from harness.spec import Finite, Positive, Spec, as_table
from harness.warping.settings import NovelViews


class SecondView(Spec):
    """The second view: a baseline from the first one, in a direction of the world, and a rotation of its own.

    Half a metre along x, unrotated, as in the paper. The rotation is in the world's frame, as the first view's.
    """

    baseline_m: Positive = 0.5
    """Distance between the viewpoints, metres."""
    azimuth_deg: Finite = 0.0
    """Direction of the baseline in the world: azimuth from x towards y, degrees."""
    elevation_deg: Finite = 0.0
    """Direction of the baseline in the world: elevation above the horizontal, degrees."""
    yaw_deg: Finite = 0.0
    """Rotation of the second view about z, degrees."""
    pitch_deg: Finite = 0.0
    """Rotation of the second view about y, degrees."""
    roll_deg: Finite = 0.0
    """Rotation of the second view about x, degrees."""

    def pose(self, view_1: Pose) -> Pose:
        """The pose of the second view, given the first one's."""
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
    """The sampling of pixels: each is the mean of rays on a square grid inside it."""

    samples: Annotated[int, Field(ge=1, le=1024)] = 16
    """Rays in each pixel, a square number, at least: where they are too wide for a texture or an outline there are 4 or
    16 times as many, up to 1024."""

    @model_validator(mode="after")
    def _square(self) -> "Rendering":
        if math.isqrt(self.samples) ** 2 != self.samples:
            raise ValueError(f"samples must be a square number (1, 4, 9, 16, ...); found {self.samples}")
        return self


class Noise(Spec):
    """White Gaussian noise on the mirror images, in grey levels of 0 .. 255."""

    sigma_grey: Annotated[float, Field(ge=0, le=255)] = 0.0
    """Standard deviation of the noise, grey levels of 0 .. 255."""


class Exposure(Spec):
    """The second camera's response to light relative to the first one's: `gain * grey + offset`."""

    gain: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    """Factor on the second view's grey levels, no unit."""
    offset_grey: Annotated[float, Field(ge=-255, le=255)] = 0.0
    """Added to the second view's grey levels after the gain, grey levels of 0 .. 255."""


class Placement(Spec):
    """The random part of the rig's position, drawn by the seed, so that a trial is not about one lucky viewpoint."""

    offset_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Both views are moved alike by up to this much along each of x, y and z, uniformly, metres."""
    random_yaw: bool = False
    """Whether both views are turned alike by a random angle; the baseline keeps its direction in the world, and so
    takes any in the panorama."""


class Unwrapping(Spec):
    """The resampling of mirror images to panoramas."""

    interpolation: Interpolation = "bilinear"
    """Interpolation of grey levels between the mirror image's pixels."""


class Filter(Spec):
    """The Laplacian of Gaussian that panoramas are filtered with before matching."""

    log_sigma_px: Annotated[float, Field(ge=0, le=50)] = 1.5
    """Standard deviation of the Gaussian, panorama pixels; 0 for no filter. At 1 px the noise of the unwrapping's
    interpolation makes the sub-pixel error on walls a fifth larger than at 1.5."""


class MotionGiven(Spec):
    """The motion from view 1 to view 2 that the matcher is given."""

    source: Literal["truth", "estimated"] = "truth"
    """`truth`, or `estimated` from the two noisy images, with the true length of the baseline. Angles are then counted
    from the estimated direction of the baseline, and their errors contain its error. Needs the extra `motion`."""


class Scoring(Spec):
    """Additional results that are stored with a trial."""

    sample_px: Annotated[int, Field(ge=0, le=256)] = 0
    """Keep the errors of every so many rows and columns, panorama pixels, for figures over the pixels of several trials
    at once, such as the spread over seeds; 0 for none."""
    bound: bool = False
    """Whether the Cramér-Rao bound of the matcher's own window is computed for every cell of surface, direction and
    range."""
    budget: bool = False
    """Whether to predict the range's errors by cause (`believed.sigma`, and the matcher's own prediction), and to count
    the errors in units of that."""
    confidence: bool = False
    """Whether to measure how well the matcher's confidence ranks its errors, which takes as long as all other
    figures."""


class Trial(Spec):
    """One run of the pipeline, from a scene to an error."""

    scene: Scene
    """The world: a table, a shipped scene's name, or the path of a TOML file."""
    sensor: Sensor = Sensor()
    """The sensor of both views, or of the first if the second has its own: a table, or the path of a TOML file."""
    sensor_2: Sensor | None = None
    """The sensor of the second view, where it is not the first one's: a table, or the path of a TOML file. In a table,
    keys that are not given have their defaults; a dotted key, as on an axis, changes a copy of the first view's."""
    view_1: Pose = Pose(position_m=(0.0, 0.0, 1.0))
    """The first view's pose in the world; 1 m above the origin when there is no such table."""
    view_2: SecondView = SecondView()
    """The second view, from the first one."""
    placement: Placement = Placement()
    """The random part of both views' poses."""
    render: Rendering = Rendering()
    """How images are rendered."""
    optics: Optics = Optics()
    """Lens effects on both images, or on the first if the second has its own."""
    optics_2: Optics | None = None
    """Lens effects on the second image, if they differ. Keys that are not given have their defaults; a dotted key, as
    on an axis, changes a copy of the first view's."""
    exposure_2: Exposure = Exposure()
    """Exposure of the second image relative to the first."""
    noise: Noise = Noise()
    """Noise on the mirror images, beside the chip's own."""
    chip: Chip = Chip()
    """The image sensor of both cameras: shot noise, bits, gamma, JPEG."""
    panorama: Grid = Grid()
    """The panorama on which ranges are estimated."""
    unwrap: Unwrapping = Unwrapping()
    """How the mirror images become panoramas."""
    filter: Filter = Filter()
    """The filter before matching."""
    motion: MotionGiven = MotionGiven()
    """The motion that the matcher is given."""
    believed: Believed = Believed()
    """Errors of the motion and the calibration that the matcher is given."""
    matching: Matcher = WindowMatcher()
    """The matcher and its settings."""
    novel_views: NovelViews = NovelViews()
    """Views from other viewpoints, warped from the pair with the matcher's ranges."""
    scan: Scan = Scan()
    """A range profile of view 1, as a robot uses it."""
    map: OccupancyMap = OccupancyMap()
    """A map of occupied and free cells, from such profiles along a path."""
    localisation: Localisation = Localisation()
    """Localisation by appearance, with real images and with others that are made of them."""
    scoring: Scoring = Scoring()
    """Additional results that are stored with the trial."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of all that is random: placement and noise."""

    @model_validator(mode="after")
    def _has_a_budget(self) -> "Trial":
        for each in (self.sensor, self.sensor_2):
            if self.scoring.budget and each is not None and each.profile is not None:
                raise ValueError(
                    f"scoring.budget: errors are not propagated through {with_article(each.profile.title)}; "
                    "leave it out"
                )
        return self

    @model_validator(mode="after")
    def _has_a_mirror_to_align(self) -> "Trial":
        sigma = self.believed.sigma
        if (sigma.alignment_mm or sigma.alignment_deg) and not isinstance(self.sensor.model, Mirror):
            raise ValueError("believed.sigma.alignment_mm and _deg are for sensors with a hyperboloid mirror")
        return self

    @model_validator(mode="after")
    def _with_rows(self) -> "Trial":
        if is_open(self.panorama):
            motion = relative_motion(self.view_1, self.view_2.pose(self.view_1))
            try:
                self.__dict__["panorama"] = with_rows(self.panorama, self.assumed_sensors, motion.R_v2_from_v1)
            except (ValueError, InputError) as error:  # of the rows, or of the sensors that are assumed
                raise ValueError(f"panorama: {error}") from error
        return self

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that name these settings, on any machine: a scene counts by its contents,
        and so do masks, and a matcher and camera models from elsewhere.

        Raises
        ------
        InputError
            When such a matcher cannot be found, or the source of one of these has changed since it was loaded.
        """
        settings = as_table(self, without="scene") | {"scene": fingerprint(self.scene)}
        self._drop_new_defaults(settings)
        if matcher := self.matching.identity():
            settings["matcher"] = matcher
        if any(models := [sensor.model.identity() for sensor in self.sensors]):
            settings["camera_models"] = models
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    def _drop_new_defaults(self, settings: dict[str, Any]) -> None:
        """Remove newer keys from a trial key's settings where they are at their defaults.

        So a trial that an earlier version could describe keeps its key.
        """
        if self.sensors[0] == self.sensors[1]:
            del settings["sensor_2"]  # the same trial, whether or not the key is given
        for sensor, specification in zip((settings["sensor"], settings.get("sensor_2", {})), self.sensors, strict=True):
            _drop_new_sensor_defaults(sensor, specification)
        for name in ("optics", "optics_2", "chip", "motion", "believed", "novel_views", "scan", "map", "localisation"):
            if getattr(self, name) == type(self).model_fields[name].default:
                del settings[name]  # as in versions without this table
        sigma = settings.get("believed", {}).get("sigma", {})
        if self.believed.sigma.odometry == Odometry():
            sigma.pop("odometry", None)
        if self.believed.sigma.calibration is None:
            sigma.pop("calibration", None)
        if self.optics_2 == self.optics:
            settings.pop("optics_2", None)
        if not self.scoring.budget:
            del settings["scoring"]["budget"]

    @property
    def poses(self) -> tuple[Pose, Pose]:
        """The poses of both views, with their random part."""
        view_2 = self.view_2.pose(self.view_1)
        placement = self.placement
        if placement.offset_m == 0 and not placement.random_yaw:
            return self.view_1, view_2
        draws = generator(self.seed, "placement", fingerprint(self.scene))
        x, y, z = (placement.offset_m * draws.uniform(-1, 1, 3)).tolist()
        yaw_deg = float(draws.uniform(0, 360)) if placement.random_yaw else 0.0
        first, second = (
            translated(view, (x, y, z)).model_copy(update={"yaw_deg": view.yaw_deg + yaw_deg})
            for view in (self.view_1, view_2)
        )
        return first, second

    @property
    def sensors(self) -> tuple[Sensor, Sensor]:
        """The sensor of each view, as it truly is."""
        second = self.sensor if self.sensor_2 is None else self.sensor_2
        sigma = self.believed.sigma
        if not sigma.alignment_mm and not sigma.alignment_deg:
            return self.sensor, second
        draws = self.belief_draws
        return misaligned(self.sensor, draws), misaligned(second, draws)

    @property
    def belief_draws(self) -> dict[str, float]:
        """The errors of the believed rig that the seed draws, by parameter."""
        sigma = self.believed.sigma
        return {} if sigma == Uncertainty() else draws_of(self.sensor, sigma, self.true_motion, self.seed)

    @property
    def lenses(self) -> tuple[Optics, Optics]:
        """The lens effects of each view."""
        return self.optics, self.optics if self.optics_2 is None else self.optics_2

    @property
    def is_noisy(self) -> bool:
        """Whether the seed's draws change the images."""
        return self.noise.sigma_grey > 0 or self.chip.is_noisy

    @property
    def bound_noise_grey(self) -> float:
        """The factor of `Outcome.bound_px`: the standard deviation of the white noise; 1 where the chip adds noise.

        The chip's noise differs from pixel to pixel and is in the bound already.
        """
        return self.noise.sigma_grey if self.chip.is_ideal else 1.0

    @property
    def assumed_sensors(self) -> tuple[Sensor, Sensor]:
        """The sensor of each view as users of its images assume it: central, its camera and mirror aligned.

        Instead of a mirror with a `[profile]` it is the nearest central camera (`camera.central`).
        Panoramas, matches, ranges and the truth that they are compared with are those of this sensor.
        """
        first, second = self.sensors
        return central_of(first), central_of(second)

    @property
    def true_motion(self) -> Motion:
        """The true motion from view 1 to view 2."""
        return relative_motion(*self.poses)


def _drop_new_sensor_defaults(settings: dict[str, Any], given: Sensor) -> None:
    """Remove newer keys of a sensor from a trial key's settings where they are at their defaults."""
    if given.misalignment.is_zero:
        settings.pop("misalignment", None)  # as in versions without this table
    if given.profile is None:
        settings.pop("profile", None)
    if mask := settings.pop("mask", None):
        settings["mask"] = mask["sha256"]
