"""Which range profile is made of a pair."""

from typing import Annotated

from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec

MOST_BEARINGS = 7200


class Scan(Spec):
    """A range profile of view 1: for each bearing the nearest obstacle in a band of heights, scored against the truth.

    Bearings are measured in the horizontal plane from the x axis of view 1's frame.
    """

    bearings: Annotated[int, Field(ge=0, le=MOST_BEARINGS)] = 0
    """Bearings around the view, evenly spaced; 0 for no profile."""
    low_m: Finite = 0.1
    """Lower edge of the band: height in the world, metres. What lies lower is floor."""
    high_m: Finite = 1.8
    """Upper edge of the band: height in the world, metres."""
    range_max_m: Positive = 30.0
    """What is farther away is not looked at, metres."""
    support_px: Annotated[int, Field(ge=1, le=1000)] = 8
    """Pixels that have to agree on an obstacle: fewer are taken for false matches."""
    clearance_sigmas: Annotated[float, Field(ge=0, le=10)] = 2.0
    """A pixel's height is to be above the lower edge by so many of its standard deviations."""
    tolerance: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    """Share of the true distance within which an estimate is right; beyond, an obstacle is missed, or a false one
    seen."""
    thin_deg: Annotated[float, Field(gt=0, le=90)] = 1.0
    """Obstacles that span less than this are thin, degrees."""

    @model_validator(mode="after")
    def _ordered(self) -> "Scan":
        if self.low_m >= self.high_m:
            raise ValueError(f"low_m must be below high_m; found {self.low_m:g} and {self.high_m:g}")
        return self
