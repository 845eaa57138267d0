"""Settings of range profiles, and of occupancy maps from the profiles of several pairs."""

import math
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec

MOST_BEARINGS = 7200
MOST_PAIRS = 1000


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
    """Largest distance of obstacles that count, metres."""
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


Point = tuple[Finite, Finite]


class OccupancyMap(Spec):
    """A map of occupied and free cells, from the range profiles of pairs along a path, scored against the floor plan
    that is cut from the scene.

    At each station the rig is turned as the path runs, so that the baseline keeps its direction to it: `view_2`'s
    azimuth is counted from there. The profiles are those that `scan` describes.
    """

    path_m: Annotated[tuple[Point, ...], Field(max_length=64)] = ()
    """Corners of the path in the world, (x, y) each, metres; the heights are view 1's. None for no map; one for a
    single pair."""
    every_m: Positive = 0.5
    """Distance of the pairs along the path, metres."""
    cell_m: Annotated[float, Field(ge=0.005, le=10)] = 0.05
    """Side of a cell, metres."""
    prior: Annotated[float, Field(gt=0, lt=0.5)] = 0.2
    """Probability that a cell is occupied before anything was measured."""
    false_share: Annotated[float, Field(gt=0, lt=0.5)] = 0.05
    """Share of the profiles' distances that are false: it limits the evidence of one distance about a cell."""

    def stations(self) -> list[tuple[float, float, float]]:
        """(x, y, heading) of each pair: metres, and radians from x towards y."""
        corners = np.array(self.path_m, dtype=np.float64)
        if len(corners) < 2:
            return [(float(x), float(y), 0.0) for x, y in corners]
        steps = np.diff(corners, axis=0)
        lengths = np.hypot(*steps.T)
        steps, lengths, corners = steps[lengths > 0], lengths[lengths > 0], corners[:-1][lengths > 0]
        if not lengths.size:
            return [(*self.path_m[0], 0.0)]
        begins = np.concatenate([[0.0], np.cumsum(lengths)])
        along = np.arange(int(np.floor(begins[-1] / self.every_m * (1 + 1e-9))) + 1) * self.every_m
        leg = np.clip(np.searchsorted(begins, along * (1 + 1e-9), side="right") - 1, 0, lengths.size - 1)
        at = corners[leg] + steps[leg] * ((along - begins[leg]) / lengths[leg])[:, None]
        heading = np.arctan2(steps[leg, 1], steps[leg, 0])
        return [(float(x), float(y), float(turn)) for (x, y), turn in zip(at, heading, strict=True)]

    @model_validator(mode="after")
    def _not_endless(self) -> "OccupancyMap":
        length = sum(math.dist(a, b) for a, b in pairwise(self.path_m))
        if length / self.every_m > MOST_PAIRS:
            raise ValueError(f"a path of {length:.4g} m has more than {MOST_PAIRS} pairs, {self.every_m:g} m apart")
        return self
