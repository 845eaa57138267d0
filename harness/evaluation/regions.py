"""The parts of the picture that errors are reported by. They depend on the truth alone: trials share them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.evaluation.groups import Groups, Sorted, bins, grouped, members, sorted_parts
from harness.evaluation.pixel_errors import Reference
from harness.evaluation.shape_scores import Shape, shape_of
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.simulation.truth import Truth

Labels = NDArray[np.int16]
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

VISIBLE, OCCLUDED = "visible in both views", "occluded in view 2"
WALL, FLOOR = "wall", "floor or ceiling"
"""Parts of the splits `visibility` and `surface`."""
NEAR_BASELINE = "within 30° of the baseline"
"""The part of the split `left out`: outside the domain, so that no other figure counts it."""


@dataclass(frozen=True)
class Region:
    """A named part of the picture."""

    split: str
    """The division of the picture that it belongs to: `surface`, `alpha_1`, ..."""
    part: str
    """Unique within the split."""
    pixels: NDArray[np.intp]
    """Flat indices into `[height, width]`."""
    low: float | None = None
    """The lower edge, for a split by values, in the unit of the split: degrees, or metres for `range`."""


@dataclass(frozen=True)
class CellPixels:
    """The pixels of one cell: a surface, a sixth of the directions, a band of ranges."""

    surface: str
    alpha_bin: int
    range_bin: int
    pixels: NDArray[np.intp]


@dataclass(frozen=True, repr=False)
class Layout(OneLine):
    """The part of scoring that depends on the truth alone, for many trials of one geometry.

    Arrays `[n]` are of the pixels of `groups`.
    """

    regions: tuple[Region, ...]
    cells: tuple[CellPixels, ...]
    groups: Groups
    """The regions, then the cells."""
    surface: NDArray[np.int8]
    """`[n]`: index into `SURFACES`; -1 outside the domain."""
    solid_angle: Array
    """`[n]`: the solid angle of a pixel, in units of a pixel's at the horizon."""
    range_m: Array
    """`[n]`: the truth."""
    by_range: Sorted
    by_law: Sorted
    """True range, and the law, cell by cell."""
    shape: Shape


def layout(reference: Reference, truth: Truth, grid: Grid, directions_world: Array) -> Layout:
    """Divide a picture into regions and cells; see `regions` and `cell_pixels`."""
    named, layers = _regions(reference, truth, grid, directions_world)
    parts = tuple(named)
    cells, of_cell = _cells(reference)
    layers.append(np.where(of_cell >= 0, of_cell + np.int16(len(parts)), np.int16(-1)).reshape(-1))
    groups = grouped(layers, len(parts) + len(cells))
    pixels = groups.pixels
    domain, wall = (mask.ravel()[pixels] for mask in (reference.domain, reference.wall))
    range_m, law = (values.ravel()[pixels] for values in (reference.range_m, reference.law))
    cell = of_cell[pixels].astype(np.int64)
    return Layout(
        regions=parts,
        cells=cells,
        groups=groups,
        surface=np.where(domain, np.where(wall, np.int8(0), np.int8(1)), np.int8(-1)),
        solid_angle=((1 + grid.z**2) ** -1.5)[pixels // grid.width_px],
        range_m=range_m,
        by_range=sorted_parts(cell, len(cells), range_m),
        by_law=sorted_parts(cell, len(cells), law),
        shape=shape_of(reference.range_m, reference.domain, directions_world, truth.discontinuity),
    )


def regions(reference: Reference, truth: Truth, grid: Grid, directions_world: Array) -> tuple[Region, ...]:
    """The splits of a picture; empty parts are left out.

    Parameters
    ----------
    directions_world
        `[height, width, 3]`, unit directions of the pixels in the world's orientation, for the slant.
    """
    return tuple(_regions(reference, truth, grid, directions_world)[0])


def _regions(
    reference: Reference, truth: Truth, grid: Grid, directions_world: Array
) -> tuple[list[Region], list[Labels]]:
    """The regions, and layers of labels `[pixels]`, which are numbers of regions, -1 for none."""
    named: list[Region] = []
    layers = []
    for split, parts, edges, labels in _splits(reference, truth, grid, directions_world):
        number = np.full(len(parts) + 1, -1, dtype=np.int16)
        for i, (part, pixels) in enumerate(zip(parts, members(labels, len(parts)), strict=True)):
            if pixels.size:
                number[i] = len(named)
                named.append(Region(split, part, pixels, edges[i] if edges else None))
        layers.append(number[labels.reshape(-1)])
    return named, layers


def _splits(
    reference: Reference, truth: Truth, grid: Grid, directions_world: Array
) -> Iterator[tuple[str, tuple[str, ...], tuple[float, ...], Labels]]:
    """Every split: its name, its parts, their edges if they are bins of values, and the part of each pixel or -1."""
    domain, wall = reference.domain, reference.wall
    looked_at = reference.sideways & np.isfinite(truth.range_m)
    # Outside the domain: there is no true match, and an estimate is an invention.
    occluded = looked_at & truth.in_field_2 & ~truth.unoccluded & ~domain
    yield "visibility", (VISIBLE, OCCLUDED), (), _labels(domain, occluded)
    yield "left out", (NEAR_BASELINE,), (), _labels(truth.visible & ~reference.sideways)
    yield "surface", (WALL, FLOOR), (), _labels(domain & wall, domain & ~wall)
    with np.errstate(invalid="ignore"):
        towards = np.einsum("ijk,ijk->ij", truth.normal, directions_world)
        slanted = np.abs(towards) < np.cos(np.radians(SLANTED_DEG))
    none = ~(truth.discontinuity | truth.textureless | slanted)
    yield "kind", ("discontinuity",), (), _labels(domain & truth.discontinuity)
    yield "kind", ("textureless",), (), _labels(domain & truth.textureless)
    yield (
        "kind",
        (f"slanted by more than {SLANTED_DEG:.0f}°", "none of these"),
        (),
        _labels(domain & slanted, domain & none),
    )
    elevation = np.broadcast_to(np.degrees(np.arctan(grid.z))[:, None], grid.shape)
    for split, values, edges, unit in (
        ("alpha_1", np.degrees(reference.alpha_1), ALPHA_1_EDGES_DEG, "°"),
        ("elevation", elevation, ELEVATION_EDGES_DEG, "°"),
        ("range", reference.range_m, RANGE_EDGES_M, " m"),
    ):
        parts = tuple(
            f"{low:g} to {high:g}{unit}" if np.isfinite(high) else f"over {low:g}{unit}"
            for low, high in pairwise(edges)
        )
        label = bins(values, edges)
        label[~domain] = -1
        yield split, parts, edges, label


def _labels(*masks: Mask) -> Labels:
    """Labels of parts that do not overlap."""
    labels = np.full(masks[0].shape, -1, dtype=np.int16)
    for i, mask in enumerate(masks):
        labels[mask] = i
    return labels


def middle_of_range(range_bin: int) -> float:
    """The geometric middle of a cell's band of ranges, metres."""
    return float(RANGE_RATIO ** (int(range_bin) + 0.5))


def middle_of_alpha(alpha_bin: int) -> float:
    """The middle of a part of the domain by alpha_1, degrees."""
    return (ALPHA_1_EDGES_DEG[alpha_bin] + ALPHA_1_EDGES_DEG[alpha_bin + 1]) / 2


def cell_pixels(reference: Reference) -> tuple[CellPixels, ...]:
    """The cells that the domain falls into, in a fixed order."""
    return _cells(reference)[0]


def _cells(reference: Reference) -> tuple[tuple[CellPixels, ...], Labels]:
    """The cells that the domain falls into, and the cell of each pixel `[pixels]`, -1 for none."""
    domain = np.flatnonzero(reference.domain)
    alpha_deg = np.degrees(reference.alpha_1.ravel()[domain])
    # Within the domain the sine is at least a half, except for rounding.
    alpha_bin = bins(np.clip(alpha_deg, 30.0, np.nextafter(150.0, 0)), ALPHA_1_EDGES_DEG)
    range_bin = np.floor(np.log(reference.range_m.ravel()[domain]) / np.log(RANGE_RATIO)).astype(np.int16)
    wall = reference.wall.ravel()[domain].astype(np.int16)
    # One number for range, direction and surface, in this order.
    nearest = int(range_bin.min(initial=0))
    label = ((range_bin - nearest) * len(ALPHA_1_EDGES_DEG) + alpha_bin) * 2 + wall
    cells: list[CellPixels] = []
    of_pixel = np.full(reference.domain.size, -1, dtype=np.int16)
    for number, part in enumerate(members(label, int(label.max(initial=-1)) + 1)):
        if part.size:
            of_pixel[domain[part]] = len(cells)
            rest, surface = divmod(number, 2)
            distance, direction = divmod(rest, len(ALPHA_1_EDGES_DEG))
            cells.append(CellPixels(SURFACES[1 - surface], direction, distance + nearest, domain[part]))
    return tuple(cells), of_pixel
