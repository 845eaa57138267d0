"""The effect of calibration errors on the motion: they leave hardly any residual, and no covariance shows them.

An error of one pixel in the principal point shifts every bearing by one pixel, which is the bearing's spread; errors of
focal length and lens shift pixels along the radius. To first order they shift the least-squares solution by
`-(J^T W J)^-1 J^T W de`, for any camera model.
"""

import numpy as np

from harness.camera.sensor import Sensor
from harness.geometry.angles import Array
from harness.motion.features import Correspondences, spreads
from harness.motion.residuals import Turn, sampson, sampson_jacobian
from harness.motion.sparse import CAUCHY, Fit, Freedom, leverage_weight, tangents

REPORTED_PX = 0.5
"""The calibration error, pixels, whose effect is reported: typical of calibrations of real mirrors and fisheyes."""
_STEP = 1e-3


def calibration_effects(
    pairs: Correspondences, sensors: tuple[Sensor, Sensor], fit: Fit, turn: Turn, freedom: Freedom = "free"
) -> Array:
    """Derivatives of the motion by errors of the calibration, `[6, k]`, radians per pixel.

    Parameters
    ----------
    fit
        The motion fitted to the pairs.
    turn
        The motion at which the derivatives are taken.

    Returns
    -------
    Array
        Rows as in `Fit.covariance`. Columns: the centre along u and along v, a focal length and a radial lens term
        (r³) that move the outermost pair by 1 px; once where both views have one sensor, else for each view.
    """
    true = pairs.at(fit.inlier)
    e, full = sampson_jacobian(true, turn)
    basis = np.vstack(tangents(turn, freedom))
    J = full @ basis
    leverage = leverage_weight(J)
    weighted = J * (leverage / (1 + leverage * (e / (CAUCHY * fit.scale_px)) ** 2))[:, None]
    views = [
        _changes(true, sensors[0], "x_1", true.pixels_1, turn),
        _changes(true, sensors[1], "x_2", true.pixels_2, turn),
    ]
    changes = views[0] + views[1] if sensors[0] == sensors[1] else np.hstack(views)
    return np.asarray(-basis @ np.linalg.pinv(weighted.T @ J) @ weighted.T @ changes)


def moved_by(effects: Array, pixels: float = REPORTED_PX) -> tuple[float, float]:
    """Angles, radians, by which rotation and direction of t change if each calibration parameter is off by `pixels`.

    The root of the sum of their squares.
    """
    rotation, direction = np.sqrt(np.sum(effects[:3] ** 2)), np.sqrt(np.sum(effects[3:] ** 2))
    return float(pixels * rotation), float(pixels * direction)


def _changes(pairs: Correspondences, sensor: Sensor, name: str, pixels: Array, turn: Turn) -> Array:
    """Derivatives `[n, 4]` of the Sampson distances by each calibration parameter of one view, per pixel."""
    radius = pixels - [sensor.camera.cx_px, sensor.camera.cy_px]
    radius = radius / max(float(np.linalg.norm(radius, axis=1).max()), 1.0)
    along_u, along_v = (np.broadcast_to(axis, radius.shape) for axis in np.eye(2))
    cubed = radius * np.sum(radius**2, axis=1, keepdims=True)
    bearings = getattr(pairs, name)
    S = spreads(sensor, bearings)
    changes = []
    for shift in (along_u, along_v, radius, cubed):
        # The calibration takes the pixel for one that lies back by as much.
        step = -_STEP * np.einsum("nij,nj->ni", S, shift)
        ahead, behind = (
            sampson(Correspondences(**{**vars(pairs), name: bearings + sign * step}), turn) for sign in (1, -1)
        )
        changes.append((ahead - behind) / (2 * _STEP))
    return np.stack(changes, axis=1)
