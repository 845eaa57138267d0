"""The uncertainty of a calibration: of its parameters, and of its rays.

Parameters trade off with each other (xi with k1 and the focal length), rays do not: compare rays. A rotation of the
sensor's frame is removed from them, since it rotates all later measurements alike and the boards determine it least.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from harness.calibration.adjust import Adjusted
from harness.calibration.parameters import intrinsic_jacobian
from harness.camera._projection_kernels import differentiate_all, project_all
from harness.camera.reflection import camera_of_points, reflect
from harness.camera.sensor import Sensor, field_of, unproject
from harness.display import OneLine
from harness.geometry.angles import Array

_UNDETERMINED = 1e-13
"""Eigenvalues of the normal matrix below this are rounding errors, if it has a unit diagonal while poses are known:
what boards leave undetermined has some 1e-15 once the poses are eliminated, what they hardly determine 1e-11."""


@dataclass(frozen=True, repr=False, eq=False)
class Uncertainty(OneLine):
    """Standard deviations and covariances from the scatter of the corners."""

    sigma_px: float
    """Standard deviation of a coordinate of a corner, pixels, from the residuals and their degrees of freedom."""
    values: Array
    """`[n]`: the values of the keys."""
    covariance: Array
    """`[n, n]`: covariance of the values, in their units; infinite on the diagonal, and NaN off it, for parameters that
    the corners do not determine."""
    vector_covariance: Array
    """`[n, n]`: covariance of the adjusted coordinates."""
    undetermined: tuple[str, ...]
    """Keys that the corners do not determine."""

    @property
    def sigma(self) -> Array:
        """`[n]`: standard deviations of the values."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the values, `[n, n]`."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / np.outer(self.sigma, self.sigma))


def uncertainty_of(adjusted: Adjusted) -> Uncertainty:
    """The uncertainty of the parameters of a plain least-squares adjustment."""
    parameters, n = adjusted.parameters, len(adjusted.vector)
    freedom = adjusted.residuals.size - n - 6 * len(adjusted.poses.t)
    variance = float(np.sum(adjusted.residuals**2)) / max(freedom, 1)
    scale = np.sqrt(np.maximum(adjusted.diagonal, 1e-300))
    eigenvalue, eigenvector = np.linalg.eigh(adjusted.normal / np.outer(scale, scale))
    weak = eigenvalue < _UNDETERMINED
    strong = eigenvector[:, ~weak] / np.sqrt(eigenvalue[~weak])
    covariance = variance * (strong @ strong.T) / np.outer(scale, scale)
    # An undetermined direction affects those keys that have a component along it.
    lost = (np.abs(eigenvector[:, weak]) > 1e-3).any(axis=1)
    J = parameters.derivatives_of_values(adjusted.vector)
    of_values = J @ covariance @ J.T
    touched = (np.abs(J[:, lost]) > 0).any(axis=1) if lost.any() else lost
    of_values[touched] = np.nan
    of_values[:, touched] = np.nan
    of_values[touched, touched] = np.inf
    keys = tuple(parameters.keys[i] for i in np.flatnonzero(touched))
    return Uncertainty(variance**0.5, parameters.values(adjusted.vector), of_values, covariance, keys)


@dataclass(frozen=True, repr=False, eq=False)
class RayGrid(OneLine):
    """A lattice of pixels over the field, at whose rays a sensor is evaluated."""

    u: Array
    """`[columns]`."""
    v: Array
    """`[rows]`."""
    inside: NDArray[np.bool_]
    """`[rows, columns]`: whether a pixel is in the field."""
    directions: Array
    """`[k, 3]`: unit directions of those inside, row by row; for a misaligned sensor points on their rays, metres."""

    def spread(self, values: Array) -> Array:
        """Values `[k]` of the pixels inside as a map `[rows, columns]`, NaN outside."""
        out = np.full(self.inside.shape, np.nan)
        out[self.inside] = values
        return out


def ray_grid(sensor: Sensor, step_px: float | None = None, distance_m: float = 1.0) -> RayGrid:
    """A lattice of pixels over a sensor's field, about 60 along its longer side unless a step is given.

    Parameters
    ----------
    distance_m
        Distance along its rays at which a misaligned sensor is evaluated, as its rays meet in no viewpoint.
    """
    camera = sensor.camera
    step = step_px or max(camera.width_px, camera.height_px) / 60
    u, v = (np.arange(0.5 * (size - 1) % step, size, step) for size in (camera.width_px, camera.height_px))
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    if sensor.is_central:
        points, inside = unproject(sensor, pixels)
    else:
        origins, directions, inside = reflect(sensor, pixels)
        points = origins + distance_m * directions
    return RayGrid(u, v, inside, np.ascontiguousarray(points[inside]))


def ray_sigma(adjusted: Adjusted, covariance: Array, grid: RayGrid) -> tuple[Array, Array]:
    """Standard deviations `[k]` of the pixels of rays (the root of the sum of both coordinates' variances), pixels.

    A direction d is projected to u(d; s), s the adjusted coordinates. To first order an error of s moves it by G ds,
    G = ∂u/∂s, and a rotation w of the frame by D (w × d). Errors of s are combined with the rotation that compensates
    most of them over the field, by least squares: what remains is `(G - M M⁺ G) ds`, M the effect of rotations.

    Returns
    -------
    turned
        Without the part that is a rotation of the whole sensor.
    fixed
        With it.
    """
    G = _ray_jacobian(adjusted, grid)
    M = _turn_jacobian(adjusted.parameters.compiled(adjusted.vector), grid.directions)
    flat, turns = G.reshape(-1, G.shape[-1]), M.reshape(-1, 3)
    left = (flat - turns @ np.linalg.lstsq(turns, flat, rcond=None)[0]).reshape(G.shape)
    return _root_trace(left, covariance), _root_trace(G, covariance)


def ray_difference(first: Sensor, second: Sensor, grid: RayGrid, *, turn: bool = True) -> Array:
    """Differences `[k, 2]`, pixels, of two sensors' projections of the directions of a grid over the first's field.

    NaN where a direction is outside the domain of the second sensor.

    Parameters
    ----------
    turn
        Rotate the second sensor first such that the sum of squares is minimal.
    """
    at = _project(camera_of_points(first), grid.directions)
    camera = camera_of_points(second)
    turned = grid.directions
    for _ in range(10 if turn else 0):
        r = _project(camera, turned) - at
        known = np.isfinite(r).all(axis=-1)
        M = _turn_jacobian(camera, turned[known])
        w = np.linalg.lstsq(M.reshape(-1, 3), -r[known].ravel(), rcond=None)[0]
        turned = turned @ Rotation.from_rotvec(w).as_matrix().T
        if np.linalg.norm(w) < 1e-12:
            break
    return _project(camera, turned) - at


def _ray_jacobian(adjusted: Adjusted, grid: RayGrid) -> Array:
    steps = adjusted.parameters.steps.copy()
    intrinsic_jacobian(
        adjusted.parameters, adjusted.vector, grid.directions[:: max(1, len(grid.directions) // 50)], steps
    )
    return intrinsic_jacobian(adjusted.parameters, adjusted.vector, grid.directions, steps)


def _turn_jacobian(camera: object, directions: Array) -> Array:
    """Derivatives `[k, 2, 3]` of pixels by a rotation of the directions."""
    D = np.empty((len(directions), 2, 3))
    differentiate_all(np.ascontiguousarray(directions), camera, D)
    return np.cross(directions[:, None, :], D)


def _root_trace(G: Array, covariance: Array) -> Array:
    return np.sqrt(np.maximum(np.einsum("kij,jl,kil->k", G, covariance, G), 0.0))


def _project(camera: object, directions: Array) -> Array:
    out = np.empty((len(directions), 2))
    project_all(np.ascontiguousarray(directions), camera, out)
    return out


def angles_off_axis(sensor: Sensor, pixels: Array) -> Array:
    """Angles `[m]` of the rays of pixels `[m, 2]` off the optical axis, radians; NaN where there is no ray.

    Of a misaligned sensor those of the mirror's points off the mirror's axis, as its field of view has them.
    """
    if not sensor.is_central:
        limits, (origins, _, _) = field_of(sensor), reflect(sensor, pixels)
        axis = np.array([limits.axis_x, limits.axis_y, limits.axis_z])
        return np.asarray(np.arctan2(np.linalg.norm(np.cross(origins, axis), axis=-1), origins @ axis))
    axis, _ = unproject(sensor, [sensor.camera.cx_px, sensor.camera.cy_px])
    directions, _ = unproject(sensor, pixels)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(directions, axis), axis=-1), directions @ axis))
