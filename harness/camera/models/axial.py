"""The base of lens models: the optical axis is +Z, and the radius in the image depends only on the angle to it.

They are written in the usual frame: X right (u), Y down (v), Z along the optical axis, into the scene. By default the
sensor's frame is that one, so that the camera looks straight up, and the angle off its axis is 90° less the elevation.
"""

import math
from abc import abstractmethod
from typing import ClassVar, NamedTuple

from harness.camera.intrinsics import Camera, FieldEdge
from harness.camera.lens import Lens
from harness.camera.models.model import CameraModel

_MARGIN_PX = 1.0
"""Margin of the field inside the domain: the corners of the outermost pixels, 0.71 from their centres, are unprojected
too."""
_MARGIN_RAD = math.radians(0.01)
"""The least such margin as an angle, for models whose radius grows without bound."""


class Domain(NamedTuple):
    """The limit of a model's domain."""

    angle_rad: float
    """Angle off the optical axis."""
    radius: float
    """The radius there, in the model's own unit; infinite for an angle that no image reaches."""
    why: str
    """The reason for the limit, for messages: `the image folds back on itself`."""


class AxialModel(CameraModel):
    """Base of the lens models."""

    elevations_deg: ClassVar[tuple[float, float]] = (-90.0, 90.0)

    @abstractmethod
    def radius(self, angle_rad: float, lens: Lens) -> float:
        """Radius in the image of directions at this angle off the axis, in the model's own unit.

        It grows with the angle throughout the domain. If lens distortion makes it depend on the azimuth, the smallest.
        """

    @abstractmethod
    def domain(self, camera: Camera, lens: Lens) -> Domain:
        """The limit of the model's domain."""

    def unit_px(self, camera: Camera) -> float:
        """Least number of pixels per unit of `radius`: the smaller focal length, unless that unit is the pixel."""
        return camera.focal_px * min(1.0, camera.aspect)

    def largest_angle_rad(self, camera: Camera, lens: Lens) -> float:
        """The largest angle off the optical axis that a field may include, radians: one pixel inside the domain."""
        end = self.domain(camera, lens)
        last = end.radius - _MARGIN_PX / self.unit_px(camera)
        most = end.angle_rad - _MARGIN_RAD
        if last <= 0:
            return 0.0
        if self.radius(most, lens) <= last:
            return most
        from scipy.optimize import brentq

        return float(brentq(lambda angle: self.radius(angle, lens) - last, 0.0, most))

    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:
        """Check that no unused key is set, and that the field lies within the model's domain."""
        self.refuse_unused(camera, lens)
        largest = math.degrees(self.largest_angle_rad(camera, lens))
        if edge.angle_deg > largest:
            raise ValueError(
                f"{edge.said} is {edge.angle_deg:g} deg off the optical axis; beyond {largest:.2f} deg "
                f"{self.domain(camera, lens).why}; {edge.remedy(largest)}"
            )
