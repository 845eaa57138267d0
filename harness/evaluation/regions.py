"""The parts of the picture that errors are reported by. They depend on the truth alone: trials share them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from harness.camera.angles import Array
from harness.evaluation.errors import MIN_SINE_ALPHA_1, Reference
from harness.evaluation.groups import Groups, Sorted, grouped, sorted_parts
from harness.simulation.truth import Truth
from harness.stereo.panorama import Grid

Mask = NDArray[np.bool_]

ALPHA_1_EDGES_DEG = (30.0, 50.0, 70.0, 90.0, 110.0, 130.0, 150.0)
"""The domain, sin(alpha_1) >= 0.5, in six parts."""

ELEVATION_EDGES_DEG = (-90.0, -40.0, -20.0, 0.0, 90.0)
RANGE_EDGES_M = (0.0, 1.5, 2.0, 3.0, 4.0, 6.0, np.inf)

SLANTED_DEG = 60.0
"""A surface is slanted where its normal is farther than this from the line of sight."""

RANGE_RATIO = 2**0.5
"""Cells bin ranges by powers of this. With baselines that are such powers too, so is |t|/d, the same for all."""


SURFACES = ("wall", "floor")
"""`floor` stands for ceilings too."""


@dataclass(frozen=True)
class Region:
    """Some pixels, and their name."""

    split: str
    part: str
    pixels: NDArray[np.intp]
    """Flat indices into `[height, width]`."""


@dataclass(frozen=True)
class CellPixels:
    """The pixels of one cell: a surface, a sixth of the directions, a band of ranges."""

    surface: str
    alpha_bin: int
    range_bin: int
    pixels: NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """All that scoring needs of the truth but the truth itself, ready for many trials of one geometry.

    Arrays `[n]` are of the pixels of `groups`.
    """

    regions: tuple[Region, ...]
    cells: tuple[CellPixels, ...]
    groups: Groups
    """The regions, then the cells."""
    surface: NDArray[np.int8]
    """`[n]`: index into `SURFACES`; -1 outside the domain."""
    solid_angle: Array
    """`[n]`: what a pixel covers of the sphere, in pixels at the horizon."""
    range_m: Array
    """`[n]`: the truth."""
    by_range: Sorted
    by_law: Sorted
    """True range, and the law, cell by cell."""


def layout(reference: Reference, truth: Truth, grid: Grid, directions_world: Array) -> Layout:
    """Divide a picture into regions and cells; see `regions` and `cell_pixels`."""
    parts, cells = regions(reference, truth, grid, directions_world), cell_pixels(reference)
    groups = grouped([[part.pixels for part in each] for each in (parts, cells)], reference.domain.size)
    pixels = groups.pixels
    domain, wall = (mask.ravel()[pixels] for mask in (reference.domain, reference.wall))
    range_m, law = (values.ravel()[pixels] for values in (reference.range_m, reference.law))
    # The domain is divided up between the cells, which are the last layer.
    cell = np.where(domain, groups.labels[groups.classes, -1] - len(parts), -1)
    return Layout(
        regions=parts,
        cells=cells,
        groups=groups,
        surface=np.where(domain, np.where(wall, np.int8(0), np.int8(1)), np.int8(-1)),
        solid_angle=((1 + grid.z**2) ** -1.5)[pixels // grid.width_px],
        range_m=range_m,
        by_range=sorted_parts(cell, len(cells), range_m),
        by_law=sorted_parts(cell, len(cells), law),
    )


def regions(reference: Reference, truth: Truth, grid: Grid, directions_world: Array) -> tuple[Region, ...]:
    """The splits of a picture; empty parts are left out.

    Parameters
    ----------
    directions_world
        `[height, width, 3]`, unit directions of the pixels in the world's orientation, for the slant.
    """
    named = _masks(reference, truth, grid, directions_world)
    found = [Region(split, part, np.flatnonzero(mask)) for split, part, mask in named]
    return tuple(region for region in found if region.pixels.size)


def _masks(reference: Reference, truth: Truth, grid: Grid, directions_world: Array) -> Iterator[tuple[str, str, Mask]]:
    domain = reference.domain
    looked_at = (np.sin(reference.alpha_1) >= MIN_SINE_ALPHA_1) & np.isfinite(truth.range_m)
    yield "visibility", "visible in both views", domain
    # Outside the domain: there is no true match, and an estimate is an invention.
    yield "visibility", "occluded in view 2", looked_at & truth.in_field_2 & ~truth.unoccluded
    yield "surface", "wall", domain & reference.wall
    yield "surface", "floor or ceiling", domain & ~reference.wall
    with np.errstate(invalid="ignore"):
        slanted = np.abs(np.sum(truth.normal * directions_world, axis=-1)) < np.cos(np.radians(SLANTED_DEG))
    yield "kind", "discontinuity", domain & truth.discontinuity
    yield "kind", "textureless", domain & truth.textureless
    yield "kind", f"slanted by more than {SLANTED_DEG:.0f}°", domain & slanted
    yield "kind", "none of these", domain & ~truth.discontinuity & ~truth.textureless & ~slanted
    elevation = np.broadcast_to(np.degrees(np.arctan(grid.z))[:, None], grid.shape)
    for split, values, edges, unit in (
        ("alpha_1", np.degrees(reference.alpha_1), ALPHA_1_EDGES_DEG, "°"),
        ("elevation", elevation, ELEVATION_EDGES_DEG, "°"),
        ("range", reference.range_m, RANGE_EDGES_M, " m"),
    ):
        for low, high in pairwise(edges):
            with np.errstate(invalid="ignore"):
                yield split, f"{low:g} to {high:g}{unit}", domain & (values >= low) & (values < high)


def cell_pixels(reference: Reference) -> tuple[CellPixels, ...]:
    """The cells that the domain falls into, in a fixed order."""
    domain = np.flatnonzero(reference.domain)
    alpha_deg = np.degrees(reference.alpha_1.ravel()[domain])
    alpha_bin = np.clip(np.digitize(alpha_deg, ALPHA_1_EDGES_DEG) - 1, 0, len(ALPHA_1_EDGES_DEG) - 2)
    range_bin = np.floor(np.log(reference.range_m.ravel()[domain]) / np.log(RANGE_RATIO)).astype(np.int64)
    wall = reference.wall.ravel()[domain]
    order = np.lexsort((wall, alpha_bin, range_bin))
    keys = np.stack([range_bin, alpha_bin, wall])[:, order]
    starts = np.flatnonzero(np.any(np.diff(keys, axis=1, prepend=keys[:, :1] - 1) != 0, axis=0))
    return tuple(
        CellPixels("wall" if is_wall else "floor", int(alpha), int(distance), members)
        for (distance, alpha, is_wall), members in zip(
            keys[:, starts].T, np.split(domain[order], starts[1:]), strict=False
        )
    )
