"""The settings of mirrors of revolution of any profile, viewed by a perspective camera on their axis.

The profile is z(r), the height of the surface above its apex at the distance r from the axis, where z points away from
the camera. The camera centre is on the axis, below the apex.
"""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec


class Profile(Spec):
    """Base of the profiles: the camera's distance, and the origin of the sensor's frame."""

    title: ClassVar[str]
    """The profile's name in captions: `spherical mirror`."""

    camera_m: Positive
    """Height of the mirror's apex above the camera centre, metres."""
    viewpoint_m: Finite | None = None
    """Height of the sensor's origin above the mirror's apex, metres. By default the point of the axis that lies nearest
    to the rays of all pixels, least squares."""


class _Cut(Profile):
    """Base of profiles that are given by a formula and cut off at a rim."""

    rim_m: Positive
    """Radius of the mirror's rim, metres."""


class Sphere(_Cut):
    """A ball: `z = R - sqrt(R² - r²)`."""

    title: ClassVar[str] = "spherical mirror"
    kind: Literal["sphere"] = "sphere"
    """A sphere."""
    radius_m: Positive
    """Radius R of the sphere, metres."""

    @model_validator(mode="after")
    def _rim_on_it(self) -> "Sphere":
        if self.rim_m >= 0.999 * self.radius_m:
            raise ValueError(
                f"rim_m = {self.rim_m:g} is not in front of the sphere's equator, of radius {self.radius_m:g}; use "
                f"less than {0.999 * self.radius_m:.4g}"
            )
        return self


class Cone(_Cut):
    """A cone, its tip towards the camera: `z = r cot(half angle)`."""

    title: ClassVar[str] = "conical mirror"
    kind: Literal["cone"] = "cone"
    """A cone."""
    half_angle_deg: Annotated[float, Field(ge=1, lt=90)]
    """Angle between the axis and the surface, degrees."""


class Paraboloid(_Cut):
    """A paraboloid seen by a perspective camera, so that its rays meet in no point: `z = r²/(4 f)`."""

    title: ClassVar[str] = "paraboloid mirror with a perspective camera"
    kind: Literal["paraboloid"] = "paraboloid"
    """A paraboloid."""
    focal_length_m: Positive
    """Distance f of the paraboloid's focus from its apex, metres."""


class Equiangular(_Cut):
    """The elevation grows in proportion to the angle at the camera: `rho cos(k t)^(1/k) = h`, `k = (1 + gain)/2`.

    rho and t are polar coordinates about the camera centre, t from the axis, and h is `camera_m`. Source: J. S. Chahl
    and M. V. Srinivasan, Reflective surfaces for panoramic imaging, Applied Optics 36 (1997).
    """

    title: ClassVar[str] = "equiangular mirror"
    kind: Literal["equiangular"] = "equiangular"
    """A constant radial gain."""
    gain: Annotated[float, Field(gt=1, le=50)]
    """Angle of the reflected ray off the axis, which it leaves straight down, per angle at the camera; no unit."""

    @property
    def k(self) -> float:
        """Half of one more than the gain."""
        return (1 + self.gain) / 2

    @model_validator(mode="after")
    def _rim_on_it(self) -> "Equiangular":
        widest = self.radius_at(0.98 * math.pi / (2 * self.k))
        if self.rim_m >= widest:
            raise ValueError(
                f"rim_m = {self.rim_m:g} is next to the asymptote of a mirror of this gain; use less than {widest:.4g}"
            )
        return self

    def radius_at(self, t: float) -> float:
        """Radius of the mirror at an angle t at the camera, radians; metres."""
        return float(self.camera_m * math.cos(self.k * t) ** (-1 / self.k) * math.sin(t))


class Table(Profile):
    """Points of the profile, joined by monotone cubic interpolation (PCHIP): `r_mm[0]` is 0, the last is the rim."""

    title: ClassVar[str] = "mirror given by a table"
    kind: Literal["table"] = "table"
    """Points of the profile."""
    r_mm: Annotated[tuple[Finite, ...], Field(min_length=4, max_length=100_000)]
    """Distances of points from the axis, millimetres: 0 first, ascending, the rim last."""
    z_mm: Annotated[tuple[Finite, ...], Field(min_length=4, max_length=100_000)]
    """Heights of these points, away from the camera, millimetres: ascending. The first is the apex."""

    @model_validator(mode="after")
    def _ascending(self) -> "Table":
        if len(self.r_mm) != len(self.z_mm):
            raise ValueError(f"r_mm has {len(self.r_mm)} numbers and z_mm {len(self.z_mm)}: give equally many")
        if self.r_mm[0] != 0:
            raise ValueError(f"r_mm: the first point is the apex, at 0; found {self.r_mm[0]:g}")
        for key in ("r_mm", "z_mm"):
            steps = np.diff(getattr(self, key))
            if not (steps > 0).all():
                i = int(np.argmin(steps > 0)) + 1
                before, after = getattr(self, key)[i - 1 : i + 1]
                raise ValueError(f"{key} must ascend; found {after:g} after {before:g}")
        return self

    @property
    def rim_m(self) -> float:
        """Radius of the mirror's rim, metres."""
        return self.r_mm[-1] / 1000


AnyProfile = Annotated[Sphere | Cone | Paraboloid | Equiangular | Table, Field(discriminator="kind")]
"""Any profile, distinguished by `kind`."""
