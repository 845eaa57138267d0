"""The hyperboloid mirror, (z + e)²/a² - r²/b² = 1 with e² = a² + b², upper sheet.

The mirror's focus F0 is the origin and the effective viewpoint; the camera centre is the other focus
F1 = (0, 0, -2e) and looks up.
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from harness.geometry.angles import Array
from harness.spec import Positive, Spec


class Mirror(Spec):
    """Semi-axes of the hyperboloid in metres.

    The default is the mirror made for the University of Amsterdam's robots in the years of the paper, which
    does not state its own: a = 28.1 mm, b = 23.4 mm.
    """

    a_m: Positive = 0.0281
    """Semi-axis of the hyperboloid along the optical axis, metres."""
    b_m: Positive = 0.0234
    """Semi-axis of the hyperboloid across the optical axis, metres."""

    @model_validator(mode="after")
    def _hyperboloid_in_reach(self) -> "Mirror":
        if not 1e-3 < self.b_m / self.a_m < 1e3:
            raise ValueError(
                f"b_m / a_m is {self.b_m / self.a_m:g}, which is no mirror one can see with: use 0.001 to 1000"
            )
        return self

    @property
    def e_m(self) -> float:
        """Half the distance between the foci, in metres."""
        return math.hypot(self.a_m, self.b_m)

    @property
    def asymptote_rad(self) -> float:
        """Elevation that no point of the mirror reaches: the surface's asymptote, in radians."""
        return math.asin(self.a_m / self.e_m)


def point_on_mirror(mirror: Mirror, directions: ArrayLike) -> Array:
    """Where the mirror is met in a direction from F0, in metres.

    `lambda d` with `lambda = b²/(a |d| - e d_z)`: the polar equation of a hyperbola about its focus, so there
    is no quadratic and no branch to choose.

    Parameters
    ----------
    directions
        `[..., 3]`, of any length.

    Returns
    -------
    Array
        `[..., 3]`; NaN in directions above the asymptote, where there is no mirror.
    """
    d = np.asarray(directions, dtype=np.float64)
    length = np.linalg.norm(d, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = mirror.a_m * length - mirror.e_m * d[..., 2]
        scale = np.where(reach > 0, mirror.b_m**2 / reach, np.nan)
        return scale[..., None] * d
