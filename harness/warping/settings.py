"""Settings of the views that are warped from a pair and scored."""

import math
from typing import Annotated

from pydantic import Field

from harness.geometry.pose import Pose, translated
from harness.spec import Finite, Positive, Spec


class NovelViews(Spec):
    """Views from other viewpoints, warped from the pair with the matcher's ranges, and scored against rendered ones.

    They stand on a line through the first viewpoint and have its orientation.
    """

    distances_m: Annotated[tuple[Positive, ...], Field(max_length=32)] = ()
    """Distances from the first viewpoint, metres; none for no such views."""
    azimuth_deg: Finite = 90.0
    """Direction of the line in the world: azimuth from x towards y, degrees."""
    elevation_deg: Finite = 0.0
    """Direction of the line in the world: elevation above the horizontal, degrees."""

    def poses(self, view_1: Pose) -> tuple[Pose, ...]:
        """The poses of the new views, given the first view's."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        x, y = math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth)
        z = math.sin(elevation)
        return tuple(translated(view_1, (each * x, each * y, each * z)) for each in self.distances_m)
