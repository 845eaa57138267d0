"""Least squares of the Sampson distances of bearing vectors with Cauchy's loss, and its covariance."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from harness.display import OneLine
from harness.geometry.angles import Array, normalise
from harness.motion.features import Correspondences
from harness.motion.residuals import Turn, lies_before, rotation_distance, sampson, sampson_jacobian

Freedom = Literal["free", "upright", "planar"]
"""Constraints on a motion: none; a rotation about z with any t; the same with t perpendicular to z."""

CAUCHY = 2.385
"""Scale of Cauchy's loss in standard deviations of the residual: 95 % efficiency for normal ones (Holland, Welsch)."""
_FAR = 5.0
"""Residuals beyond so many standard deviations are ignored."""
_CELL_PX = 24.0
"""Side of the cells of view 1's image, pixels, within which residuals are treated as correlated: keypoints of several
scales coincide, and share their noise."""
_LEVERAGE = 2.0
"""Largest leverage of a pair relative to the mean."""
_ROUNDS = 3
"""Number of fits, each with the residual scale and the tangents of the previous one."""


def tangents(turn: Turn, freedom: Freedom) -> tuple[Array, Array]:
    """Bases of the allowed changes of a motion: of the rotation omega `[3, k]`, and of t `[3, k]`."""
    z = np.array([0.0, 0.0, 1.0])
    if freedom == "planar":
        return np.stack([z, np.zeros(3)], axis=1), np.stack([np.zeros(3), normalise(np.cross(z, turn.t))], axis=1)
    other = np.eye(3)[np.argmin(np.abs(turn.t))]
    b_1 = normalise(np.cross(turn.t, other))
    across = np.stack([b_1, np.cross(turn.t, b_1)], axis=1)
    turns = np.eye(3) if freedom == "free" else z[:, None]
    m = turns.shape[1]
    return np.hstack([turns, np.zeros((3, 2))]), np.hstack([np.zeros((3, m)), across])


def moved(turn: Turn, omega: Array, tau: Array) -> Turn:
    """The motion with R exp([omega]×), and t + tau normalised."""
    R = turn.R @ Rotation.from_rotvec(omega).as_matrix()
    U, _, Vt = np.linalg.svd(R)  # rounding errors do not accumulate
    return Turn(U @ Vt, normalise(turn.t + tau))


@dataclass(frozen=True, repr=False)
class Fit(OneLine):
    """A motion fitted to pairs of bearing vectors."""

    turn: Turn
    covariance: Array
    """`[6, 6]`: covariance of the rotation omega (radians, R exp([omega]×), in v1's frame) and of the change of unit t
    (in v1's frame); singular along t, and along fixed directions."""
    scale_px: float
    """Standard deviation of the inliers' Sampson distances, from their median, pixels."""
    inlier: NDArray[np.bool_]
    """`[n]`: within 5 standard deviations, and in front of both views."""

    @property
    def sigma_rotation(self) -> float:
        """Standard deviation of the angle by which the rotation is off, radians (root of the mean square)."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def sigma_direction(self) -> float:
        """Standard deviation of the angle by which the direction of t is off, radians."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


def fit(pairs: Correspondences, start: Turn, freedom: Freedom = "free", *, limit_px: float = 2.0) -> Fit:
    """Minimise Cauchy's loss of the Sampson distances, starting near the solution.

    Parameters
    ----------
    limit_px
        Sampson distance above which a pair is an outlier of `start`.
    """
    turn = start
    scale = _scale(pairs, turn, limit_px)
    for _ in range(_ROUNDS):
        turn = _minimised(pairs, turn, freedom, scale, limit_px)
        scale = _scale(pairs, turn, limit_px)
    e = sampson(pairs, turn)
    inlier = (np.abs(e) < min(_FAR * scale, limit_px)) & lies_before(pairs, turn)
    return Fit(turn, _covariance(pairs.at(inlier), turn, freedom, scale), scale, inlier)


def _scale(pairs: Correspondences, turn: Turn, limit_px: float) -> float:
    """Robust standard deviation of the Sampson distances, pixels: from the median of those below the limit."""
    size = np.abs(sampson(pairs, turn))[lies_before(pairs, turn)]
    size = size[size < limit_px]
    scale = limit_px / 2.0
    for _ in range(5):
        near = size[size < _FAR * scale]
        if near.size == 0:
            break
        scale = 1.4826 * float(np.median(near))
    return max(scale, 1e-6)


def _minimised(pairs: Correspondences, start: Turn, freedom: Freedom, scale: float, limit_px: float) -> Turn:
    """The motion of least Cauchy loss in the tangent space at the start."""
    from scipy.optimize import least_squares  # loading it takes long, and few runs need it

    e = sampson(pairs, start)
    near = pairs.at((np.abs(e) < max(limit_px, _FAR * scale)) & lies_before(pairs, start))
    turns, steps = tangents(start, freedom)
    if len(near) < turns.shape[1]:
        return start

    basis = np.vstack([turns, steps])
    weight = np.sqrt(leverage_weight(sampson_jacobian(near, start)[1] @ basis))

    def at(p: Array) -> Turn:
        return moved(start, turns @ p, steps @ p)

    def jacobian(p: Array) -> Array:
        return np.asarray(weight[:, None] * (sampson_jacobian(near, at(p))[1] @ basis))

    minimum = least_squares(
        lambda p: weight * sampson(near, at(p)),
        np.zeros(turns.shape[1]),
        jac=jacobian,
        loss="cauchy",
        f_scale=CAUCHY * scale,
        x_scale="jac",
        max_nfev=30,
    )
    return at(minimum.x)


def leverage_weight(J: Array) -> Array:
    """Weights `[n]` that bound the influence of a pair on the motion, whatever its residual.

    An outlier that lies near its epipolar line by chance may have any parallax, to which its derivative by t is
    proportional: where true parallaxes are small, a dozen such pairs outweigh a thousand inliers.
    """
    h = np.sum(J * np.linalg.solve(J.T @ J + 1e-12 * np.trace(J.T @ J) * np.eye(J.shape[1]), J.T).T, axis=1)
    return np.asarray(np.minimum(1.0, _LEVERAGE * J.shape[1] / len(J) / np.maximum(h, 1e-300)))


def _covariance(pairs: Correspondences, turn: Turn, freedom: Freedom, scale: float) -> Array:
    """The sandwich covariance of an M-estimator: A^-1 B A^-1, with B summed over cells of view 1's image.

    Infinite where there are too few pairs.
    """
    basis = np.vstack(tangents(turn, freedom))
    e, full = sampson_jacobian(pairs, turn)
    J = full @ basis
    ratio = (e / (CAUCHY * scale)) ** 2
    weight = leverage_weight(J) if len(e) else np.zeros(0)
    psi = weight * e / (1 + weight * ratio)
    slope = weight * (1 - weight * ratio) / (1 + weight * ratio) ** 2
    A = (slope[:, None] * J).T @ J
    cell = np.unique(np.floor(pairs.pixels_1 / _CELL_PX), axis=0, return_inverse=True)[1].ravel()
    scores = np.zeros((cell.max(initial=-1) + 1, basis.shape[1]))
    np.add.at(scores, cell, psi[:, None] * J)
    few = len(scores) <= basis.shape[1]
    if few or not np.linalg.cond(A) < 1e14:
        return np.full((6, 6), np.inf)
    inverse = np.linalg.inv(A) * np.sqrt(len(scores) / (len(scores) - basis.shape[1]))
    return np.asarray(basis @ inverse @ scores.T @ scores @ inverse @ basis.T)


def fit_rotation(pairs: Correspondences, R: Array) -> tuple[Array, float]:
    """The pure rotation that best maps x_1 to x_2, and its median residual, pixels of one axis.

    Weighted Procrustes (Kabsch), with weights from the mean variance of a pair's bearings and Cauchy's loss.
    """
    sharp = 1 / sum(np.sum(each**2, axis=(1, 2)) for each in (pairs.spreads_1, pairs.spreads_2))
    for _ in range(20):
        size = rotation_distance(pairs, R)
        scale = 1.4826 * float(np.median(size)) + 1e-9
        weight = sharp / (1 + (size / (CAUCHY * scale)) ** 2)
        R = np.asarray(Rotation.align_vectors(pairs.x_2, pairs.x_1, weights=weight)[0].as_matrix())
    return R, float(np.median(rotation_distance(pairs, R)))
