"""Both views as images of a projection that a matcher asked for, and the way back for its answer."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from harness.camera.unwrap import Interpolation, sample_bands
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array, angle_between
from harness.geometry.triangulation import alpha_2_at_range
from harness.matching.answers import QUANTITIES, Answer
from harness.matching.projections import Projection

if TYPE_CHECKING:
    from harness.matching.pair import Pair


@dataclass(frozen=True, eq=False, repr=False)
class Views(OneLine):
    """Both views on one projection, **both in v1's orientation**; all arrays are read-only."""

    projection: Projection
    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    """`[height, width]`, grey levels of 0 .. 255, or `[height, width, 3]`: red, green and blue. 0 where not `valid`."""
    valid: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    """`[height, width]`: made only of pixels that the sensor sees."""
    t_v1: Array
    """`[3]`, metres: viewpoint 2 in v1's frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns): of the images, and of every array in an answer."""
        return self.projection.shape

    @property
    def directions(self) -> Array:
        """`[height, width, 3]`: the unit vector towards each pixel, in v1's frame."""
        return self.projection.directions

    @property
    def alpha_1(self) -> Array:
        """`[height, width]`, radians: the angle between each pixel's direction and t (eq. 5)."""
        return angle_between(self.directions, self.t_v1)

    def disparity_deg(self, range_m: float) -> Array:
        """`[height, width]`: the disparity `alpha_2 - alpha_1`, degrees, of points at one range from viewpoint 1."""
        return np.degrees(alpha_2_at_range(self.directions, range_m, self.t_v1) - self.alpha_1)

    def answer(
        self,
        *,
        range_m: Array | None = None,
        disparity_deg: Array | None = None,
        disparity_px: Array | None = None,
        alpha_2: Array | None = None,
        confidence: Array | None = None,
        sigma: Array | None = None,
    ) -> Answer:
        """An answer on these pixels, for a matcher to return. Arrays `[height, width]`, NaN where there is no match.

        Parameters
        ----------
        range_m
            Metres from viewpoint 1 along the pixel's ray: no depth along an axis.
        disparity_deg
            The angle `alpha_2 - alpha_1` in degrees, between the rays from both viewpoints to the point; 0 at infinity.
        disparity_px
            Columns to the left (or rows up) from view 1 to view 2; for rectified images alone.
        alpha_2
            Radians: the angle in the epipolar plane between t and the direction from viewpoint 2 to the point.
        confidence
            Higher is more confident, in any unit.
        sigma
            Predicted standard deviation, in the unit of the given quantity.

        Raises
        ------
        InputError
            When not exactly one of the first four is given.
        """
        quantities = {
            "range_m": range_m, "disparity_deg": disparity_deg, "disparity_px": disparity_px, "alpha_2": alpha_2
        }  # fmt: skip
        if disparity_px is not None:
            self.projection.shifted_alpha_2(np.zeros(self.shape))  # refuses where columns are no epipolar curves
        return made_answer(self.projection, self.t_v1, self.valid[0], quantities, confidence, sigma)


def made_answer(
    projection: Projection | None,
    t_v1: Array,
    seen: NDArray[np.bool_] | None,
    quantities: dict[str, Array | None],
    confidence: Array | None,
    sigma: Array | None,
) -> Answer:
    """An answer with exactly one quantity.

    Raises
    ------
    InputError
        When no quantity is given, or more than one.
    """
    given = [name for name, value in quantities.items() if value is not None]
    if len(given) != 1:
        detail = f"it has {' and '.join(given)}" if given else "it has none of them"
        raise InputError(f"an answer must have exactly one of {', '.join(QUANTITIES)}; {detail}")
    return Answer(projection, t_v1, seen, confidence=confidence, sigma=sigma, **quantities)


def views_of(pair: "Pair", projection: Projection, *, colour: bool, interpolation: Interpolation | None) -> Views:
    """Both views on a projection, each made once for all matchers that need the same."""
    how = interpolation or pair.interpolation
    rotations = (np.eye(3), pair.motion.R_v2_from_v1)

    def one(view: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        looking = projection.directions @ rotations[view].T
        bands = pair.colours(view) if colour else (pair.images[view],)
        sampled, valid = sample_bands(bands, pair.sensors[view], looking, how)
        image = np.stack(sampled, axis=-1) if colour else sampled[0]
        image = np.where(valid[..., None] if colour else valid, image, np.float32(0))
        image.flags.writeable = valid.flags.writeable = False
        return image, valid

    projected = [_shared(pair, view, (projection, how, colour), partial(one, view)) for view in (0, 1)]
    return Views(projection, (projected[0][0], projected[1][0]), (projected[0][1], projected[1][1]), pair.t_v1)


def _shared(pair: "Pair", view: int, settings: Hashable, make: Callable[[], Any]) -> Any:
    turned = view and pair.motion.R_v2_from_v1.tobytes()
    return cast("Any", pair.share("project", (pair.keys[view], pair.sensors[view], turned, settings), make))
