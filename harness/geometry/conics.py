"""Epipolar curves in the image itself: for cameras of the unified model they are conics (the paper's ref. 11).

The frame is the lens's: Z along the optical axis, a direction (X, Y, Z) of unit length seen at the normalised
coordinates `m = (X, Y)/(Z + xi)`. All directions of one plane, n · (X, Y, Z) = 0, are seen on

    m~^T C m~ = 0,   m~ = (m, 1),   C = n_Z² xi² I - xi² n_Z (n e_3^T + e_3 n^T) + (xi² - 1) n n^T:

with s = Z + xi the plane says `s n·m~ = n_Z xi`, the sphere `s² |m~|² - 2 s xi + xi² - 1 = 0`, and s drops out.

Source: T. Svoboda and T. Pajdla, Epipolar geometry for central catadioptric cameras, IJCV 2002, in the unified form.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from harness.display import OneLine
from harness.geometry.angles import Array, normalise

Kind = Literal["ellipse", "hyperbola", "parabola", "line"]

_NEARLY = 1e-12
"""Quantities below this are 0 up to rounding: they are differences of numbers up to 1."""
_STARTS = 720
"""Directions of the plane from which the nearest point is looked for."""
_MINIMA = 4
"""A point has at most four feet on a conic."""
_ZOOM = 9
"""Directions about the nearest so far, in each of several rounds, each with a fourth of the width."""


@dataclass(frozen=True, repr=False)
class Conic(OneLine):
    """The image of a plane through the viewpoint."""

    kind: Kind
    """A circle is an ellipse."""
    matrix: Array
    """`[3, 3]`, symmetric, of Frobenius norm 1: `(u, v, 1) C (u, v, 1)^T = 0`."""
    normal: Array
    """`[3]`, the plane's unit normal in the lens's frame."""
    xi: float
    image_from_normalised: Array
    """`[3, 3]`, affine: what normalised coordinates (m, 1) are multiplied by."""

    def residual(self, points: ArrayLike) -> Array:
        """`p^T C p / |p|²`, p = (u, v, 1), of points `[..., 2]`: 0 on the conic, at most 1."""
        points = np.asarray(points, dtype=np.float64)
        p = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
        return np.asarray(np.einsum("...i,ij,...j", p, self.matrix, p) / np.sum(p * p, axis=-1))

    def points(self, angles: ArrayLike) -> Array:
        """Image points `[..., 2]` of directions in the plane; NaN for a direction that is not visible.

        Parameters
        ----------
        angles
            `[...]`, radians: from the plane's horizontal direction, `e_3 × n`, towards its highest along Z.
        """
        angles = np.asarray(angles, dtype=np.float64)
        across = np.cross([0.0, 0.0, 1.0], self.normal)
        level = normalise(across) if np.linalg.norm(across) > _NEARLY else np.array([1.0, 0.0, 0.0])
        d = np.cos(angles)[..., None] * level + np.sin(angles)[..., None] * np.cross(self.normal, level)
        ahead = d[..., 2:] + self.xi
        m = np.where(ahead > _NEARLY, d[..., :2] / np.where(ahead > _NEARLY, ahead, 1.0), np.nan)
        A = self.image_from_normalised
        return np.asarray(m @ A[:2, :2].T + A[:2, 2])

    def distance(self, points: ArrayLike) -> Array:
        """Distances of points `[..., 2]` from the plane's image, in the points' unit; not negative.

        The direction seen nearest is looked for: that leaves out a hyperbola's other branch, which shows nothing.
        """
        points = np.asarray(points, dtype=np.float64)
        flat = points.reshape(-1, 1, 2)
        width = 2 * np.pi / _STARTS
        apart = self._distances(flat, np.asarray(np.arange(_STARTS) * width, dtype=np.float64))
        # An ellipse may be so thin that its other side is nearer than the next start: every minimum is followed.
        lowest = (apart <= np.roll(apart, 1, axis=1)) & (apart <= np.roll(apart, -1, axis=1))
        best = width * np.argsort(np.where(lowest, apart, np.inf), axis=1)[:, :_MINIMA]
        while width > 1e-15:
            angles = best[..., None] + width * np.linspace(-1, 1, _ZOOM)
            apart = self._distances(flat[:, None], angles)
            best = np.take_along_axis(angles, np.argmin(apart, axis=-1)[..., None], -1)[..., 0]
            width *= 0.25
        return np.asarray(np.min(apart, axis=(-2, -1)).reshape(points.shape[:-1]))

    def _distances(self, points: Array, angles: Array) -> Array:
        """Distances of points from the images of directions; infinite for a direction that is not visible."""
        return np.nan_to_num(np.linalg.norm(self.points(angles) - points, axis=-1), nan=np.inf)

    def in_image(self, K: ArrayLike) -> "Conic":
        """The conic of the points `K (u, v, 1)`.

        Parameters
        ----------
        K
            `[3, 3]`, affine: its last row is (0, 0, 1). The camera matrix makes pixels of normalised coordinates,
            where no lens bends them.
        """
        K = np.asarray(K, dtype=np.float64)
        inverse = np.linalg.inv(K)
        C = inverse.T @ self.matrix @ inverse
        return Conic(self.kind, C / np.linalg.norm(C), self.normal, self.xi, K @ self.image_from_normalised)


def epipolar_conic(normal: ArrayLike, xi: float) -> Conic:
    """The image of a plane through the viewpoint, in normalised coordinates.

    Parameters
    ----------
    normal
        `[3]`, of the plane, in the lens's frame, of any length: the epipolar plane's is `t × x_1`, turned there.
    xi
        Of the unified model; 0 for a pinhole.

    Returns
    -------
    Conic
        Its kind follows from the eigenvalues of the leading 2x2 block, `n_Z² xi²` and `n_Z² + xi² - 1`: both of one
        sign make an ellipse, one that is 0 a parabola. Planes through the axis, and all of a pinhole, show as lines.

    Raises
    ------
    ValueError
        When the normal is zero or xi is negative.
    """
    n = np.asarray(normal, dtype=np.float64)
    if not (xi >= 0 and np.isfinite(n).all() and np.linalg.norm(n) > 0):
        raise ValueError("the normal must not be zero, nor xi negative")
    n = normalise(n)
    kind: Kind
    if abs(n[2]) < _NEARLY or xi == 0:
        kind, matrix = "line", np.outer(n, n)  # a line is a conic twice
    else:
        mixed = np.outer(n, [0.0, 0.0, 1.0])
        matrix = n[2] ** 2 * xi**2 * np.eye(3) - xi**2 * n[2] * (mixed + mixed.T) + (xi**2 - 1) * np.outer(n, n)
        other = n[2] ** 2 + xi**2 - 1
        kind = "parabola" if abs(other) < _NEARLY else "ellipse" if other > 0 else "hyperbola"
    return Conic(kind, matrix / np.linalg.norm(matrix), n, float(xi), np.eye(3))
