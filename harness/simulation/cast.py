"""Exact ray casting, from one viewpoint or from a point for each ray.

Embree finds the triangle in float32; the point is then computed, and the triangle verified, in float64. Only for a ray
within about 1e-7 of an occluder's outline does float32 still decide which surface it hits.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.simulation._rendering_kernels import verify_hits
from harness.simulation.coincident import settle, visible_pairs
from harness.simulation.scene_geometry import Geometry, Ints
from harness.threads import in_threads

_CHUNK = 1 << 15


@dataclass(frozen=True)
class Hits:
    """The first surface along each ray."""

    triangle: Ints
    """`[...]`: index into the geometry's triangles, -1 where the ray hits nothing (open scenes only)."""
    range_m: Array
    """`[...]`: metres along the ray; NaN where it hits nothing."""


def cast(geometry: Geometry, viewpoint: ArrayLike, directions: ArrayLike, *, threads: int | None = None) -> Hits:
    """The first surface along each ray.

    Parameters
    ----------
    viewpoint
        `[3]`, metres, from the geometry's centre; or `[..., 3]`, where each ray begins.
    directions
        `[..., 3]`, unit length, in the world.
    threads
        Number of threads; by default all available CPUs. The result does not depend on it.

    Raises
    ------
    InputError
        When a ray escapes from a scene that is declared closed.
    ValueError
        When a direction is not of unit length.
    """
    directions = np.asarray(directions, dtype=np.float64)
    flat = np.ascontiguousarray(directions.reshape(-1, 3))
    if not np.allclose(np.einsum("ij,ij->i", flat, flat), 1.0, rtol=0, atol=1e-9):
        raise ValueError("directions must be of unit length: a range is measured along them")
    origins = np.ascontiguousarray(np.asarray(viewpoint, dtype=np.float64).reshape(-1, 3))
    triangle = np.empty(len(flat), dtype=np.int32)
    range_m = np.empty(len(flat))

    def work(start: int) -> None:
        part = slice(start, start + _CHUNK)
        begin = origins if len(origins) == 1 else origins[part]
        triangle[part] = nearest_triangles(geometry, begin, flat[part].astype(np.float32))
        # In a closed scene a miss is Embree's slip through a crack; many misses are a hole, not worth a search.
        few_misses = np.count_nonzero(triangle[part] < 0) <= 100
        verify_hits(
            geometry.corners,
            geometry.normals,
            geometry.offsets,
            geometry.face_of_triangle,
            begin,
            flat[part],
            geometry.closed and few_misses,
            triangle[part],
            range_m[part],
        )
        settled = _settled(geometry, begin, flat[part], triangle[part])
        changed = np.flatnonzero(settled != triangle[part])
        if changed.size:
            face = geometry.face_of_triangle[settled[changed]]
            if len(begin) == 1:
                distance = geometry.offsets[face] - geometry.normals[face] @ begin[0]
            else:
                distance = geometry.offsets[face] - np.einsum("ij,ij->i", geometry.normals[face], begin[changed])
            towards = np.einsum("ij,ij->i", geometry.normals[face], flat[part][changed])
            range_m[part][changed] = distance / towards
            triangle[part] = settled

    in_threads(work, range(0, len(flat), _CHUNK), threads)
    refuse_escapes(geometry, origins, flat, triangle)
    return Hits(triangle.reshape(directions.shape[:-1]), range_m.reshape(directions.shape[:-1]))


def rotated(directions: Array, rotation: Array) -> Array:
    """Directions `[n, 3]` rotated by `rotation`.

    Not with `@`: BLAS would start threads of its own, which stall when ours already use every CPU.
    """
    return np.asarray(np.einsum("ij,kj->ik", directions, rotation))


def nearest_triangles(geometry: Geometry, origins: NDArray[np.floating], directions: NDArray[np.float32]) -> Ints:
    """Triangles `[n]` hit in directions `[n, 3]` of any length, with the rule for coincident faces; -1 for a miss.

    `origins` are `[n, 3]`, or `[3]` or `[1, 3]` if all rays begin in one point.
    """
    begin = np.broadcast_to(origins.astype(np.float32, copy=False), directions.shape)
    triangle = np.asarray(geometry.embree.run(begin, directions), dtype=np.int32)
    return _settled(geometry, origins.reshape(-1, 3), directions, triangle)


def _settled(geometry: Geometry, origins: NDArray[np.floating], directions: NDArray[Any], triangle: Ints) -> Ints:
    """The visible triangles where faces coincide; see `coincident`."""
    rivals = geometry.rivals
    if not len(rivals.pairs):
        return triangle
    # Rays that begin apart do so on one mirror, and see the same sides of a scene's faces.
    first = np.asarray(origins[0], dtype=np.float64)
    pairs = visible_pairs(rivals, geometry.normals, geometry.offsets, first)
    if not len(pairs):
        return triangle
    settled = triangle.copy()
    settle(
        pairs,
        geometry.corners,
        geometry.face_of_triangle,
        geometry.normals,
        geometry.offsets,
        rivals.tolerance_m,
        np.asarray(origins, dtype=np.float64),
        directions,
        settled,
    )
    return settled


def refuse_escapes(geometry: Geometry, origins: Array, directions: ArrayLike, triangle: Ints) -> None:
    """Raise InputError when the scene is closed and any ray has no triangle."""
    escaped = np.flatnonzero(triangle < 0)
    if geometry.closed and escaped.size:
        d = np.asarray(directions)[escaped[0]]
        x, y, z = origins[escaped[0] if len(origins) > 1 else 0] + geometry.centre
        raise InputError(
            f"{escaped.size} rays or more escape, one from ({x:.10g}, {y:.10g}, {z:.10g}) m "
            f"in direction ({d[0]:.4f}, {d[1]:.4f}, {d[2]:.4f}): close the scene or set closed = false",
            file=geometry.name,
        )
