"""The parts that all camera models share: image size, intrinsic parameters, field of view."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec, remember

Pixels = Annotated[int, Field(ge=8, le=16384)]

if TYPE_CHECKING:
    FocalLength = float
    Centre = float
else:
    FocalLength = Positive | Literal["fit"]
    Centre = Finite | Literal["centre"]


class Camera(Spec):
    """The image and the camera matrix. By default 640x480 as in the paper, +20° of elevation 238 px from the centre."""

    width_px: Pixels = 640
    """Width of the image, pixels."""
    height_px: Pixels = 480
    """Height of the image, pixels."""
    focal_px: FocalLength = 614.12
    """Focal length along u, pixels; "fit" for the largest at which the whole field of view is on the image."""
    aspect: Positive = 1.0
    """Focal length along v divided by that along u, no unit."""
    skew_px: Finite = 0.0
    """Skew, pixels: K[0, 1] of the camera matrix; 0 if columns are at right angles to rows."""
    cx_px: Centre = 319.5
    """Principal point along u, pixels; the centre of the first pixel is 0. "centre" for the image's, (width - 1)/2."""
    cy_px: Centre = 239.5
    """Principal point along v, pixels; the centre of the first pixel is 0. "centre" for the image's, (height - 1)/2."""

    @property
    def is_open(self) -> bool:
        """Whether the focal length is still to be fitted to a field of view."""
        focal_px: Any = self.focal_px
        return isinstance(focal_px, str)

    @property
    def matrix(self) -> dict[str, float]:
        """The entries of the camera matrix, pixels, under their names in the compiled models."""
        return {
            "fu": self.focal_px,
            "fv": self.focal_px * self.aspect,
            "skew": self.skew_px,
            "cu": self.cx_px,
            "cv": self.cy_px,
        }

    @model_validator(mode="after")
    def _looks_at_its_mirror(self) -> "Camera":
        for key, size in (("cx_px", self.width_px), ("cy_px", self.height_px)):
            if isinstance(getattr(self, key), str):
                remember(self, {key: getattr(self, key)})
                self.__dict__[key] = (size - 1) / 2
        for key, at, size in (("cx_px", self.cx_px, self.width_px), ("cy_px", self.cy_px, self.height_px)):
            if not -0.5 <= at <= size - 0.5:
                raise ValueError(
                    f"{key} = {at:g} is not on an image of {size} pixels; 'centre' is its middle, {(size - 1) / 2:g}"
                )
        return self


class FieldOfView(Spec):
    """The directions that the sensor sees, before it is tilted by its mount."""

    elevation_min_deg: Finite = -75.0
    """Lowest elevation in the field, degrees. Below the default the camera sees itself: a camera of 20 mm radius at F1,
    73 mm below F0, hides what is below -75°."""
    elevation_max_deg: Finite = 20.0
    """Highest elevation in the field, degrees: +20° puts the rim 238 px from the centre, just inside 480 rows."""
    angle_max_deg: Annotated[float, Field(gt=0, le=180)] = 180.0
    """Largest angle off the optical axis, degrees; 180 for no limit other than those of elevation."""

    @model_validator(mode="after")
    def _ordered(self) -> "FieldOfView":
        # What is not given is for the sensor to fill in, since it depends on the camera model.
        lowest, highest = (
            getattr(self, key) if key in self.model_fields_set else other
            for key, other in (("elevation_min_deg", -90.0), ("elevation_max_deg", 90.0))
        )
        if not -90 <= lowest < highest <= 90:
            raise ValueError("elevation_min_deg must be below elevation_max_deg, both within -90 .. 90")
        return self


class FieldEdge(NamedTuple):
    """The largest angle off the optical axis that a field of view includes, and the key that sets it."""

    angle_deg: float
    key: str
    value: float

    @property
    def said(self) -> str:
        """The key and its value, for messages: `field.elevation_max_deg = 20`."""
        return f"field.{self.key} = {self.value:g}"

    def remedy(self, angle_deg: float) -> str:
        """Advice, for messages, that keeps the field within an angle off the optical axis: `use at most 15.25`."""
        if self.key == "elevation_min_deg":
            return f"use at least {math.ceil((90 - angle_deg) * 100) / 100:g}"
        most = angle_deg - 90 if self.key == "elevation_max_deg" else angle_deg
        return f"use at most {math.floor(most * 100) / 100:g}"
