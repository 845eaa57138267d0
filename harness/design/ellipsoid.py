"""The covariance of a triangulated point's position in space, from a rig's error budget.

A point p is seen at a pixel of view 1, whose believed direction is x_1, and found at `p̂ = d_1 x_1`. The range's part of
its error is the budget's: noise and matching along x_1, by the law. Across x_1 the point is off

- by the pixel: how finely the noise, and what is aliased, let the place of a window in image 1 be known, the same in
  both of the image's directions; `A` being the projection's derivative on the tangent plane, `B` that plane's basis,
  the part is `d_1² sigma_px² B (Aᵀ A)⁻¹ Bᵀ`;
- by the calibration and the alignment of camera and mirror, which turn x_1 as well as they change d_1.

The parts of what is believed of the rig are `J C Jᵀ`, J the derivative of p̂ by its parameters, so that errors of the
range and of the direction are correlated as they are. Errors of the motion are along x_1 alone: positions are view 1's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from harness.camera.sensor import jacobian
from harness.design.budget import budget, pixel_sigma
from harness.design.rig import RigDesign
from harness.display import OneLine
from harness.evaluation.propagation import point_sensitivities
from harness.evaluation.rig_uncertainty import covariances
from harness.geometry.angles import Array, normalise


@dataclass(frozen=True, eq=False, repr=False)
class Ellipsoid(OneLine):
    """The uncertainty of one point's position."""

    point_m: Array
    """`[3]`, in view 1's frame."""
    covariance_m2: Array
    """`[3, 3]`, in view 1's frame; NaN where a view does not see the point."""
    sigma_range_m: float
    """The standard deviation of the range alone, of all causes; infinite where a view does not see the point."""

    @property
    def is_seen(self) -> bool:
        """Whether both views see the point."""
        return bool(np.isfinite(self.covariance_m2).all())

    @property
    def semi_axes_m(self) -> Array:
        """`[3]`: the semi-axes at one standard deviation, the longest first; NaN where the point is not seen."""
        return self._principal[0]

    @property
    def directions(self) -> Array:
        """`[3, 3]`: the unit direction of each of them, a row each, away from view 1; its largest part positive where
        an axis points neither away nor back.
        """
        return self._principal[1]

    @cached_property
    def _principal(self) -> tuple[Array, Array]:
        if not self.is_seen:
            return np.full(3, np.nan), np.full((3, 3), np.nan)
        variances, columns = np.linalg.eigh(self.covariance_m2)
        rows = columns.T[::-1]
        away = rows @ normalise(self.point_m)
        largest = rows[np.arange(3), np.argmax(np.abs(rows), axis=1)]
        signs = np.where(np.abs(away) > _SIDEWAYS, np.sign(away), np.sign(largest))
        return np.sqrt(np.maximum(variances[::-1], 0.0)), rows * signs[:, None]


_SIDEWAYS = 0.1
"""Cosine to the ray below which an axis points neither away nor back: the sign would be chance."""


def abeam(rig: RigDesign, ranges_m: Sequence[float]) -> Array:
    """`[n, 3]`: points at some ranges from view 1, at right angles to the baseline and level.

    Where the sensor does not see the horizon, on its elevation that is nearest.
    """
    t = rig.believed.motion.t_v1
    flat = np.cross([0.0, 0.0, 1.0], t)
    side = normalise(flat) if np.linalg.norm(flat) > 1e-6 * rig.baseline_m else np.array([0.0, 1.0, 0.0])
    elevation = np.radians(level_elevation_deg(rig))
    return np.asarray(ranges_m, dtype=np.float64)[:, None] * (
        np.cos(elevation) * side + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    )


def level_elevation_deg(rig: RigDesign) -> float:
    """The elevation nearest to the horizon that is half a degree inside the sensor's field, degrees."""
    low, high = rig.sensor.field.elevation_min_deg, rig.sensor.field.elevation_max_deg
    return float(min(max(0.0, low + 0.5), high - 0.5))


def ellipsoids(rig: RigDesign, points_m: Array) -> tuple[Ellipsoid, ...]:
    """The uncertainty of the positions of points, on surfaces that face view 1.

    Parameters
    ----------
    points_m
        `[n, 3]`, in view 1's frame.
    """
    points = np.asarray(points_m, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):  # of points that a view does not see
        parts = budget(rig, points)
        along = normalise(points)
        matching = parts.sigma_m["noise"] ** 2 + parts.sigma_m["matching"] ** 2
        covariance = matching[:, None, None] * along[:, :, None] * along[:, None, :]
        covariance = covariance + _of_pixel(rig, points)
        for _, parameters, known in covariances(rig.sensor, rig.uncertainty, rig.believed.motion):
            if known.any():
                J = point_sensitivities(points, rig.believed, parameters)
                covariance = covariance + J @ known @ np.swapaxes(J, -1, -2)
    total = parts.total_m
    covariance[~np.isfinite(total)] = np.nan
    return tuple(Ellipsoid(*each) for each in zip(points, covariance, total.tolist(), strict=True))


def _of_pixel(rig: RigDesign, points_m: Array) -> Array:
    """`[n, 3, 3]`: the covariance of points across their rays, by where in image 1 they are seen."""
    x = normalise(points_m)
    helper = np.eye(3)[np.argmin(np.abs(x), axis=-1)]
    first = normalise(np.cross(x, helper))
    basis = np.stack([first, np.cross(x, first)], axis=-1)
    A = jacobian(rig.sensor, x) @ basis
    finite = np.isfinite(A).all(axis=(-1, -2))
    angles = np.full(A.shape, np.nan)
    angles[finite] = np.linalg.inv(np.swapaxes(A[finite], -1, -2) @ A[finite])
    size = np.linalg.norm(points_m, axis=-1) * pixel_sigma(rig, points_m)
    return np.asarray(size[:, None, None] ** 2 * (basis @ angles @ np.swapaxes(basis, -1, -2)))
