"""The input of a matcher: two mirror images, their sensors, the motion between the views, and panoramas made of them.

Panoramas and filtered panoramas are made when they are first needed, and shared by all matchers that need the
same.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor
from harness.camera.unwrap import Interpolation, unwrap
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_1
from harness.geometry.panorama import Grid, Panorama, directions
from harness.geometry.pose import Motion
from harness.machine import available_cpus
from harness.matching.filter import laplacian_of_gaussian

T = TypeVar("T")
G = TypeVar("G", bound=np.generic)

Share = Callable[[str, Hashable, Callable[[], Any]], Any]
"""`share(stage, key, make)`: the result of a stage with this key, made if it has not been made yet."""


def sharing() -> Share:
    """A `Share` that keeps everything as long as its pair exists."""
    results: dict[tuple[str, Hashable], Any] = {}

    def share(stage: str, key: Hashable, make: Callable[[], Any]) -> Any:
        if (stage, key) not in results:
            results[stage, key] = make()
        return results[stage, key]

    return share


@dataclass(frozen=True, eq=False, repr=False)
class Pair(OneLine):
    """Two views of one scene; all arrays are read-only.

    Raises
    ------
    ValueError
        When an image does not have its sensor's size.
    """

    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    """The mirror images `[sensor height, sensor width]`, grey levels of 0 .. 255, 0 where the sensor sees nothing."""
    sensors: tuple[Sensor, Sensor]
    """The sensor of each view; most rigs have two equal ones."""
    motion: Motion
    """From view 1 to view 2."""
    grid: Grid
    """The pixels of the panorama; matches are on view 1's."""
    interpolation: Interpolation = "bilinear"
    log_sigma_px: float = 1.5
    """How panoramas are made, and filtered, unless a matcher asks for something else."""
    threads: int | None = None
    """How many may be used; all available CPUs when None. No result may depend on it."""
    keys: tuple[Hashable, Hashable] = field(default_factory=lambda: (object(), object()))
    """What identifies each image and its pose where results are shared."""
    share: Share = field(default_factory=sharing)
    owner: str = ""
    """The third-party matcher that calls `shared`, if any: two of them may use the same words for their settings."""

    def __post_init__(self) -> None:
        for view, (image, sensor) in enumerate(zip(self.images, self.sensors, strict=True), 1):
            size = (sensor.camera.height_px, sensor.camera.width_px)
            if image.shape != size:
                raise ValueError(f"image {view} is {image.shape}, its sensor {size} (rows, columns)")
        first, second = self.images
        motion = Motion(_locked(self.motion.R_v2_from_v1), _locked(self.motion.t_v1))
        object.__setattr__(self, "images", (_locked(first), _locked(second)))
        object.__setattr__(self, "motion", motion)

    @property
    def sensor(self) -> Sensor:
        """The sensor of both views, for matchers that take one.

        Raises
        ------
        InputError
            When the views have different sensors: an image seen through the other one's would give wrong ranges.
        """
        first, second = self.sensors
        if first != second:
            raise InputError(
                "the views have different sensors, but the matcher asks for a common one (pair.sensor); "
                "it has to use pair.sensors",
                file=self.owner or None,
            )
        return first

    @property
    def directions(self) -> Array:
        """`[height, width, 3]`: the unit vector towards each pixel of the panorama, in v1's frame."""
        return directions(self.grid)

    @property
    def alpha_1(self) -> Array:
        """`[height, width]`, radians: the angle between each pixel's direction and t (eq. 5)."""
        return alpha_1(self.grid, self.t_v1)

    @property
    def t_v1(self) -> Array:
        """`[3]`, metres: viewpoint 2 in v1's frame."""
        return self.motion.t_v1

    @property
    def available_threads(self) -> int:
        """`threads`, or the number of CPUs."""
        return self.threads or available_cpus()

    def panoramas(self, interpolation: Interpolation | None = None) -> tuple[Panorama, Panorama]:
        """Both views on the grid, **both in v1's orientation**: what is left between them is a pure translation."""
        how = interpolation or self.interpolation
        rotations = (np.eye(3), self.motion.R_v2_from_v1)

        def one(view: int) -> Panorama:
            made = unwrap(
                self.images[view],
                self.sensors[view],
                self.grid,
                R_sensor_from_panorama=rotations[view],
                interpolation=how,
            )
            return _locked_panorama(made)

        turned = self.motion.R_v2_from_v1.tobytes()
        keys = [(key, self.sensors[view], self.grid, how, view and turned) for view, key in enumerate(self.keys)]
        first, second = (cast("Panorama", self.share("unwrap", keys[i], partial(one, i))) for i in (0, 1))
        return first, second

    def filtered(
        self, log_sigma_px: float | None = None, interpolation: Interpolation | None = None
    ) -> tuple[Panorama, Panorama]:
        """The panoramas after the Laplacian of Gaussian; 0 leaves them as they are."""
        sigma = self.log_sigma_px if log_sigma_px is None else log_sigma_px
        how = interpolation or self.interpolation
        panoramas = self.panoramas(how)
        turned = self.motion.R_v2_from_v1.tobytes()
        keys = [(key, self.sensors[view], self.grid, how, view and turned, sigma) for view, key in enumerate(self.keys)]

        def one(view: int) -> Panorama:
            return _locked_panorama(laplacian_of_gaussian(panoramas[view], sigma))

        first, second = (cast("Panorama", self.share("filter", keys[i], partial(one, i))) for i in (0, 1))
        return first, second

    def shared(self, stage: str, settings: Hashable, make: Callable[[], T]) -> T:
        """Something made of this pair with some settings, shared with other matchers that need the same.

        Parameters
        ----------
        stage
            A name; its time is counted under it, after the name of the matcher if that is a third party's.
        settings
            All that the result depends on beside the pair.
        """
        turned, made = self.motion.R_v2_from_v1.tobytes(), (self.interpolation, self.log_sigma_px)
        key = (*self.keys, turned, self.t_v1.tobytes(), self.sensors, self.grid, made, settings)
        return cast("T", self.share(f"{self.owner} {stage}" if self.owner else stage, key, make))


def _locked(array: NDArray[G]) -> NDArray[G]:
    """The same, read-only: a view of an array that owns its memory stays as it is."""
    held = array.copy() if array.flags.writeable else array
    held.flags.writeable = False
    return held.view()


def _locked_panorama(panorama: Panorama) -> Panorama:
    return Panorama(panorama.grid, _locked(panorama.values), _locked(panorama.valid))
