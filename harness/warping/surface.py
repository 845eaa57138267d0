"""A map of ranges as a surface that rays can meet from anywhere: each pixel is a patch, joined to those beside it that
lie on the same surface, and torn from the others.

Between the pixels of a plane, 1/s is nearly linear, where s = d / |x| is the range in units of the cylinder's point x:
with n . p = h on the plane, 1/s = n . x / h. So patches meet where the mean of 1/s puts them, and a plane has no gaps.
What is torn apart leaves a gap, which is what the view has not seen behind an outline: it is spanned by a second
surface, the *membrane*, so that rays through it can be told from rays that pass where the matcher had no answer.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from harness.camera.fill import nearest_known
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, cylinder

Mask = NDArray[np.bool_]

JUMP = 0.02
"""Share of 1/s by which neighbours on one surface may differ beyond what their slopes and sigmas explain."""
SIGMAS = 3.0
"""Differences within so many standard deviations are no jump."""


_ASIDE_RAD = 1e-5
"""A hundredth of a pixel of any panorama, and a hundred times the rounding of single precision."""
_FAN = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.int32)
_QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


class _Cells(NamedTuple):
    """Surfaces of several triangles each, in Embree."""

    scene: Any
    each: int
    """Triangles of one."""


@dataclass(frozen=True, repr=False, eq=False)
class RangeSurface(OneLine):
    """The surface of a map of ranges, in the frame of its viewpoint."""

    grid: Grid
    range_m: Array
    """`[height, width]`, metres; NaN where there is no range."""
    sigma_m: Array
    """`[height, width]`: standard deviation of the range, metres; NaN where it is not known."""
    _patches: Any = field(init=False)

    def __post_init__(self) -> None:
        """Build the patches, which needs a range somewhere."""
        if self.range_m.shape != self.grid.shape or self.sigma_m.shape != self.grid.shape:
            raise ValueError(f"ranges and sigmas must be {self.grid.shape}; found {self.range_m.shape}")
        if not self.known.any():
            raise ValueError("there is no range in the map")
        object.__setattr__(self, "_patches", _embree(self._fans()[self.known], _FAN))

    @cached_property
    def known(self) -> Mask:
        """Pixels with a range."""
        return np.isfinite(self.range_m)

    @cached_property
    def _inverse(self) -> Array:
        """1/s of the pixels; NaN without a range."""
        return np.asarray(np.linalg.norm(cylinder(self.grid), axis=-1) / self.range_m)

    @cached_property
    def _slack(self) -> Array:
        """The largest difference of 1/s between pixels of one surface: from a pixel's error, and from `JUMP`."""
        relative = SIGMAS * np.where(np.isfinite(self.sigma_m), self.sigma_m, 0.0) / self.range_m
        return np.asarray(self._inverse * np.hypot(relative, JUMP))

    def joined(self, rows: int, columns: int) -> Mask:
        """Whether each pixel is on one surface with the pixel so many rows below and columns to the right of it.

        It is when the step of 1/s between them lies between the steps before and after it, up to the slack: on a
        plane all three are alike, and across a crease the step is some of both. At an outline it is outside.
        """
        there = _moved(self._inverse, rows, columns)
        step = there - self._inverse
        before = self._inverse - _moved(self._inverse, -rows, -columns)
        after = _moved(self._inverse, 2 * rows, 2 * columns) - there
        # An unknown neighbouring step sets no limit; where neither is known, only a small step joins.
        low, high = (np.nan_to_num(each(before, after)) for each in (np.fmin, np.fmax))
        beyond = np.maximum(low - step, step - high)
        return np.asarray(beyond <= np.hypot(self._slack, _moved(self._slack, rows, columns)))

    def _slope(self, rows: int, columns: int) -> Array:
        """Growth of 1/s to the next row or column on the same surface: the mean over the sides that are joined to the
        pixel; 0 if none is.
        """
        ahead, behind = self.joined(rows, columns), self.joined(-rows, -columns)
        to, back = _moved(self._inverse, rows, columns), _moved(self._inverse, -rows, -columns)
        total = np.where(ahead, to - self._inverse, 0.0) + np.where(behind, self._inverse - back, 0.0)
        return np.asarray(total / np.maximum(ahead.astype(float) + behind, 1.0))

    def _fans(self) -> Array:
        """`[height, width, 5, 3]`: the middle of each pixel's patch and its corners, clockwise from the upper left.

        A corner is where the planes of the pixels that meet there, and are joined, put it on average.
        """
        down_slope, right_slope = self._slope(1, 0), self._slope(0, 1)
        fans = [cylinder(self.grid) / self._inverse[..., None]]
        for down, right in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
            total, count = self._inverse + (down * down_slope + right * right_slope) / 2, np.ones(self.grid.shape)
            for rows, columns in ((down, 0), (0, right), (down, right)):
                joined = self.joined(rows, columns)
                # From there the corner is on the near side.
                at = down * (0.5 if not rows else -0.5), right * (0.5 if not columns else -0.5)
                there = self._inverse + at[0] * down_slope + at[1] * right_slope
                total += np.where(joined, _moved(there, rows, columns), 0.0)
                count += joined
            # A plane through the viewpoint would not be visible.
            inverse = np.maximum(total / count, 0.1 * self._inverse)
            fans.append(self._corner_points(down, right) / inverse[..., None])
        return np.stack(fans, axis=2)

    def _corner_points(self, down: int, right: int) -> Array:
        """`[height, width, 3]`: points of the cylinder at one corner of every pixel."""
        phi, z = self.grid.phi + right * self.grid.phi_pitch / 2, self.grid.z - down * self.grid.z_pitch / 2
        x = np.empty((*self.grid.shape, 3))
        x[..., 0], x[..., 1], x[..., 2] = np.cos(phi), np.sin(phi), z[:, None]
        return x

    @cached_property
    def _membrane(self) -> Any:
        """The surface over all pixels, without tears; pixels without a range have the nearest pixel's."""
        filled = self._inverse[nearest_known(self.known)]
        points = cylinder(self.grid) / filled[..., None]
        right, below = np.roll(points, -1, axis=1), points[1:]
        quads = np.stack([points[:-1], right[:-1], np.roll(below, -1, axis=1), below], axis=2)
        return _embree(quads.reshape(-1, 4, 3), _QUAD)

    def meet(self, viewpoint: Array, rays: Array) -> tuple[Array, NDArray[np.intp]]:
        """Distance along each ray to the first patch, metres, and the patch's pixel in the flattened map.

        Parameters
        ----------
        viewpoint
            `[3]`, metres, in the map's frame.
        rays
            `[n, 3]`, unit vectors, in the map's frame.

        Returns
        -------
        tuple
            NaN and -1 for rays that meet no patch.
        """
        distance, quad = _first(self._patches, viewpoint, rays)
        pixel = np.flatnonzero(self.known)
        return distance, np.where(quad < 0, -1, pixel[quad])

    def in_a_gap(self, viewpoint: Array, rays: Array) -> tuple[Array, Mask, Mask]:
        """For rays `[n, 3]` that meet no patch: the distance of the membrane, metres; whether they pass behind an
        outline, and whether between known patches there is one without a range. NaN and False beyond the map.
        """
        distance, quad = _first(self._membrane, viewpoint, rays)
        hit = quad >= 0
        row, column = np.divmod(np.where(hit, quad, 0), self.grid.width_px)
        known = [self.known[row + i, (column + j) % self.grid.width_px] for i in (0, 1) for j in (0, 1)]
        unknown = ~np.logical_and.reduce(known)
        return distance, hit & ~unknown, hit & unknown


def _moved(values: Array, rows: int, columns: int) -> Array:
    """Each pixel's neighbour so many rows below and columns to the right; NaN beyond the upper and lower border."""
    moved = np.roll(values, -columns, axis=1)
    if rows:
        moved = np.roll(moved, -rows, axis=0)
        moved[slice(-rows, None) if rows > 0 else slice(None, -rows)] = np.nan
    return moved


def _embree(cells: Array, triangles: NDArray[np.int32]) -> "_Cells":
    """An Embree scene of cells `[n, corners, 3]`, each of some triangles of its corners."""
    scene = EmbreeScene(robust=True)
    first = cells.shape[1] * np.arange(len(cells), dtype=np.int32)[:, None, None]
    TriangleMesh(scene, cells.reshape(-1, 3).astype(np.float32), (first + triangles).reshape(-1, 3))
    return _Cells(scene, len(triangles))


def _first(cells: "_Cells", viewpoint: Array, rays: Array) -> tuple[Array, NDArray[np.intp]]:
    """Distance to and index of the first cell along each ray; NaN and -1 without one.

    A ray that runs exactly through an edge or a corner may slip between the triangles that meet there, and so do those
    of the map's own viewpoint: what meets nothing is tried again a hair's breadth aside.
    """
    distance, cell = _run(cells, viewpoint, rays)
    for aside in np.array([[3.0, 1.0, 2.0], [-1.0, 2.0, -3.0]]) * _ASIDE_RAD:
        missed = np.flatnonzero(cell < 0)
        distance[missed], cell[missed] = _run(cells, viewpoint, rays[missed] + aside)
    return distance, cell


def _run(cells: "_Cells", viewpoint: Array, rays: Array) -> tuple[Array, NDArray[np.intp]]:
    origins = np.broadcast_to(np.asarray(viewpoint, dtype=np.float32), rays.shape)
    towards = np.ascontiguousarray(rays, dtype=np.float32)
    hits = cells.scene.run(np.ascontiguousarray(origins), towards, output=True)
    triangle = hits["primID"].astype(np.intp)
    missed = triangle < 0
    return np.where(missed, np.nan, hits["tfar"].astype(np.float64)), np.where(missed, -1, triangle // cells.each)
