"""How large a grey level is in images whose unit is not known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_EXPOSED = 128.0
"""The quadratic mean of an image of 8 bits that is exposed to the middle of its range, grey levels. Rendered scenes
have 128 to 138."""

_ROWS = 4
"""One row in so many is looked at: enough for the moments of a whole image."""


@dataclass(frozen=True)
class Moments:
    """Means over the known pixels of an image, in its unit and the unit's square."""

    mean: float
    square: float
    """Mean of the squares."""

    @classmethod
    def of(cls, image: NDArray[np.floating], known: NDArray[np.bool_]) -> "Moments":
        """The moments of every fourth row of an image, both `[height, width]`; 0 where nothing is known."""
        values = image[::_ROWS][known[::_ROWS]]
        if not values.size:
            return cls(0.0, 0.0)
        return cls(float(np.mean(values, dtype=np.float64)), float(np.mean(np.square(values, dtype=np.float64))))

    @property
    def variance(self) -> float:
        """Mean of the squared differences from the mean."""
        return max(self.square - self.mean**2, 0.0)


def grey_level_squared(views: Sequence[Moments]) -> float:
    """The square of a grey level, in the square of the images' unit.

    A grey level is a 256th of the range from dark to light, of which a well exposed image uses 128 in the quadratic
    mean: about 1 in images of 8 bits, 1/256 in the same of 0 .. 1.
    """
    return sum(each.square for each in views) / (len(views) * _EXPOSED**2)
