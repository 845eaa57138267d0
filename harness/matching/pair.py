"""The input of a matcher: two mirror images, their sensors, the motion between the views, and panoramas made of them.

Panoramas and filtered panoramas are made when they are first needed, and shared by all matchers that need the
same.
"""

import math
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
from harness.matching.answers import Answer
from harness.matching.filter import laplacian_of_gaussian
from harness.matching.projections import Along, Equirectangular, Rectified, perspective
from harness.matching.views import Views, made_answer, views_of

T = TypeVar("T")
G = TypeVar("G", bound=np.generic)

Bands = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""Red, green and blue, each like an image."""

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
    """The motion from view 1 to view 2."""
    grid: Grid
    """The pixels of the panorama; matches are on view 1's."""
    interpolation: Interpolation = "bilinear"
    log_sigma_px: float = 1.5
    """Interpolation and filter of the panoramas, unless a matcher asks for others."""
    threads: int | None = None
    """Most threads to use; all available CPUs when None. No result may depend on it."""
    keys: tuple[Hashable, Hashable] = field(default_factory=lambda: (object(), object()))
    """Keys of each image and its pose, under which results are shared."""
    share: Share = field(default_factory=sharing)
    bands: Callable[[int], Bands] | None = None
    """`bands(view)`: red, green and blue of an image, made when asked for; None where there is only grey."""
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
        """Both views on the grid, **both in v1's orientation**: only a translation remains between them."""
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
        """The panoramas after the Laplacian of Gaussian; a sigma of 0 leaves them unfiltered."""
        sigma = self.log_sigma_px if log_sigma_px is None else log_sigma_px
        how = interpolation or self.interpolation
        panoramas = self.panoramas(how)
        turned = self.motion.R_v2_from_v1.tobytes()
        keys = [(key, self.sensors[view], self.grid, how, view and turned, sigma) for view, key in enumerate(self.keys)]

        def one(view: int) -> Panorama:
            return _locked_panorama(laplacian_of_gaussian(panoramas[view], sigma))

        first, second = (cast("Panorama", self.share("filter", keys[i], partial(one, i))) for i in (0, 1))
        return first, second

    def colours(self, view: int) -> Bands:
        """Red, green and blue of the image of a view, 0 or 1; the grey image thrice where there are no colours."""
        if self.bands is None:
            return (self.images[view],) * 3
        red, green, blue = (_locked(each) for each in self.bands(view))
        return red, green, blue

    def equirectangular(
        self,
        width_px: int,
        height_px: int | None = None,
        *,
        elevation_deg: tuple[float, float] = (-90.0, 90.0),
        colour: bool = False,
        interpolation: Interpolation | None = None,
    ) -> Views:
        """Both views as equirectangular images; see `projections.Equirectangular`.

        Parameters
        ----------
        height_px
            Rows; as many as make pixels square at the horizon if None.
        elevation_deg
            Of the lower and the upper edge, degrees.
        colour
            Red, green and blue rather than grey levels.

        Raises
        ------
        InputError
            When there are no such images.
        """
        bottom, top = elevation_deg
        height = round(width_px * (top - bottom) / 360) if height_px is None else height_px
        projection = Equirectangular(height, width_px, math.radians(top), math.radians(bottom))
        return views_of(self, projection, colour=colour, interpolation=interpolation)

    def rectified(
        self,
        around_px: int,
        *,
        along: Along = "rows",
        colour: bool = False,
        interpolation: Interpolation | None = None,
    ) -> Views:
        """Both views in longitude and latitude about the baseline; see `projections.Rectified`.

        Parameters
        ----------
        around_px
            Pixels once around the baseline, even: the rows, with half as many columns, or the other way round.
        along
            Whether a row or a column is an epipolar curve.

        Raises
        ------
        InputError
            When there are no such images.
        """
        if around_px % 2:
            raise InputError(f"must be even; found {around_px}", key="around_px")
        shape = (around_px, around_px // 2) if along == "rows" else (around_px // 2, around_px)
        x, y, z = (float(each) for each in self.t_v1)
        return views_of(self, Rectified(*shape, (x, y, z), along), colour=colour, interpolation=interpolation)

    def perspective(
        self,
        width_px: int,
        height_px: int,
        *,
        fov_deg: float = 90.0,
        azimuth_deg: float | None = None,
        elevation_deg: float = 0.0,
        rectified: bool = True,
        colour: bool = False,
        interpolation: Interpolation | None = None,
    ) -> Views:
        """Both views as pinhole images in a direction; see `projections.perspective`.

        Parameters
        ----------
        fov_deg
            Between the left and the right edge, degrees.
        azimuth_deg, elevation_deg
            Of the optical axis, degrees. Azimuth None: to the left of t.
        rectified
            Whether rows are epipolar curves: the camera is turned until its x axis is along t.

        Raises
        ------
        InputError
            When there are no such images.
        """
        t_v1 = self.t_v1 if rectified else None
        projection = perspective(width_px, height_px, fov_deg, azimuth_deg, elevation_deg, t_v1)
        return views_of(self, projection, colour=colour, interpolation=interpolation)

    def answer(
        self,
        *,
        range_m: Array | None = None,
        disparity_deg: Array | None = None,
        alpha_2: Array | None = None,
        confidence: Array | None = None,
        sigma: Array | None = None,
    ) -> Answer:
        """An answer on the panorama's own pixels, for a matcher to return; see `Views.answer`.

        Raises
        ------
        InputError
            When not exactly one quantity is given.
        """
        quantities = {"range_m": range_m, "disparity_deg": disparity_deg, "alpha_2": alpha_2}
        return made_answer(None, self.t_v1, None, quantities, confidence, sigma)

    def shared(self, stage: str, settings: Hashable, make: Callable[[], T]) -> T:
        """A result computed from this pair with some settings, shared with other matchers that need the same.

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
    """A read-only view of an array, or of a copy if the array is writable."""
    held = array.copy() if array.flags.writeable else array
    held.flags.writeable = False
    return held.view()


def _locked_panorama(panorama: Panorama) -> Panorama:
    return Panorama(panorama.grid, _locked(panorama.values), _locked(panorama.valid))
