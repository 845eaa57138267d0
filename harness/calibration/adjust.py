"""Bundle adjustment: the sensor and the boards' poses that minimise the reprojection errors of corners.

Levenberg-Marquardt on the normal equations. Each corner depends on the sensor and on the pose of its own board alone,
so that poses are eliminated board by board (Schur complement): the cost of a step is linear in the corners, not cubic
in all unknowns. `scipy.optimize.least_squares`, which decomposes the whole matrix, takes a hundred times as long on
twenty boards.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from harness.calibration.corners import Corners
from harness.calibration.parameters import Parameters, intrinsic_jacobian
from harness.calibration.poses import BoardPoses, pose_jacobian, residuals_of
from harness.display import OneLine
from harness.geometry.angles import Array

_MOST_ROUNDS = 200
_SMALLEST_PX = 1e-9
"""RMS below which residuals are rounding errors, as with noise-free corners."""


@dataclass(frozen=True, repr=False, eq=False)
class Adjusted(OneLine):
    """The result of an adjustment."""

    parameters: Parameters
    vector: Array
    """`[n]`."""
    poses: BoardPoses
    residuals: Array
    """`[m, 2]`: residuals, predicted minus measured, pixels."""
    normal: Array
    """`[n, n]`: reduced normal matrix of the vector, with the poses eliminated, pixels⁻²: the covariance is its inverse
    times the variance of a corner's coordinate."""
    diagonal: Array
    """`[n]`: the diagonal of that matrix for known poses: rounding errors of `normal` are in proportion to it."""
    pose_normal: Array
    """`[boards, 6, 6]`: normal matrices of the poses for a known sensor."""
    cost: float
    rounds: int
    converged: bool


def adjust(
    parameters: Parameters,
    corners: Corners,
    vector: Array,
    poses: BoardPoses,
    *,
    robust_px: float | None = None,
    rounds: int = _MOST_ROUNDS,
    tell: Callable[[int, float], None] | None = None,
) -> Adjusted | None:
    """Minimise the sum of squared residuals from an initial sensor and poses.

    A step to an invalid sensor, or one that takes a corner out of the model's domain, is rejected.

    Parameters
    ----------
    vector
        `[n]`, in the coordinates of `parameters`.
    robust_px
        Scale of Cauchy's robust loss, pixels; plain least squares when None.
    tell
        Called with the round and the RMS in pixels.

    Returns
    -------
    Adjusted
        None when the initial sensor cannot project all corners.
    """
    state = _evaluated(parameters, corners, vector, poses, robust_px)
    if state is None:
        return None
    steps = parameters.steps.copy()
    damping, growth = 1e-4, 2.0
    converged = False
    done = 0
    system = None
    for done in range(1, rounds + 1):
        system = system or _linearised(parameters, corners, state, steps, robust_px)
        rms = float(np.sqrt(np.mean(np.sum(state.residuals**2, axis=-1))))
        if tell is not None:
            tell(done, rms)
        if rms < _SMALLEST_PX:
            converged = True
            break
        step, pose_step, expected = system.step(damping)
        tried = _evaluated(parameters, corners, state.vector + step, state.poses.moved(pose_step), robust_px)
        gain = -1.0 if tried is None else state.cost - tried.cost
        if tried is not None and gain > 0:
            ratio = gain / max(expected, 1e-300)
            damping *= max(1 / 5, 1 - (2 * min(ratio, 1.0) - 1) ** 3)
            damping, growth = max(damping, 1e-12), 2.0
            converged = gain <= 1e-10 * state.cost and expected <= 1e-9 * state.cost
            state, system = tried, None
        else:
            # The expected decrease is below rounding.
            converged = tried is not None and expected <= 1e-12 * state.cost
            damping, growth = damping * growth, growth * 2
        if converged or damping > 1e12:
            break
    final = _linearised(parameters, corners, state, steps, None)
    return replace(
        state,
        normal=final.reduced(),
        diagonal=np.diag(final.sensor),
        pose_normal=final.poses,
        rounds=done,
        converged=converged,
    )


def _evaluated(
    parameters: Parameters, corners: Corners, vector: Array, poses: BoardPoses, robust_px: float | None
) -> Adjusted | None:
    camera = parameters.compiled(vector)
    if camera is None:
        return None
    r = residuals_of(camera, corners, poses)
    if not np.isfinite(r).all():
        return None
    squares = np.sum(r * r, axis=-1)
    cost = squares.sum() if robust_px is None else (np.log1p(squares / robust_px**2) * robust_px**2).sum()
    nothing = np.zeros((0, 0))
    return Adjusted(parameters, vector, poses, r, nothing, np.zeros(0), nothing, float(cost), 0, converged=False)


@dataclass(frozen=True)
class _Normal:
    """Normal equations: the blocks of the sensor, of the poses and between them, and the right-hand sides."""

    sensor: Array
    between: Array
    """`[boards, 6, n]`."""
    poses: Array
    """`[boards, 6, 6]`."""
    right: Array
    pose_right: Array
    """`[boards, 6]`."""

    def step(self, damping: float) -> tuple[Array, Array, float]:
        """The steps `[n]` and `[boards, 6]` for a damping factor, and the expected decrease of the cost."""
        poses = _enlarged(self.poses, damping)
        solved = np.linalg.solve(poses, np.concatenate([self.between, self.pose_right[..., None]], axis=-1))
        n = len(self.right)
        reduced = _enlarged(self.sensor[None], damping)[0] - np.einsum("bij,bik->jk", self.between, solved[..., :n])
        right = self.right - np.einsum("bij,bi->j", self.between, solved[..., n])
        # Parameters differ in their units: the terms of a polynomial by ten orders of magnitude.
        scale = 1 / np.sqrt(np.maximum(np.diag(self.sensor), 1e-300))
        step = -scale * np.linalg.lstsq(reduced * np.outer(scale, scale), right * scale, rcond=None)[0]
        pose_step = -(solved[..., n] + solved[..., :n] @ step)
        # The decrease of |J step + r|²: -2 gradient · step - step · (J^T J) step.
        full = (
            step @ self.sensor @ step
            + 2 * np.einsum("bi,bij,j->", pose_step, self.between, step)
            + np.einsum("bi,bij,bj->", pose_step, self.poses, pose_step)
        )
        expected = -2 * (self.right @ step + np.sum(self.pose_right * pose_step)) - full
        return step, pose_step, float(expected)

    def reduced(self) -> Array:
        """The sensor's block `[n, n]` after elimination of the poses."""
        solved = np.linalg.solve(_enlarged(self.poses, 0.0), self.between)
        reduced = self.sensor - np.einsum("bij,bik->jk", self.between, solved)
        return np.asarray(0.5 * (reduced + reduced.T))


def _enlarged(matrices: Array, damping: float) -> Array:
    out = matrices.copy()
    diagonal = np.einsum("nii->ni", out)
    diagonal *= 1 + damping
    diagonal += 1e-300
    return out


def _linearised(
    parameters: Parameters, corners: Corners, state: Adjusted, steps: Array, robust_px: float | None
) -> _Normal:
    turned, p = state.poses.apply(corners)
    J = intrinsic_jacobian(parameters, state.vector, p, steps)
    J_pose = pose_jacobian(parameters.compiled(state.vector), turned, p)
    r = state.residuals
    J = np.where(np.isfinite(J), J, 0.0)
    weight: NDArray[np.float64] = np.ones(len(r))
    if robust_px is not None:
        weight = 1 / (1 + np.sum(r * r, axis=-1) / robust_px**2)
    starts = corners.starts
    weighted, weighted_pose = J * weight[:, None, None], J_pose * weight[:, None, None]
    flat, flat_weighted = J.reshape(-1, J.shape[-1]), weighted.reshape(-1, J.shape[-1])
    return _Normal(
        sensor=flat.T @ flat_weighted,
        between=np.add.reduceat(np.swapaxes(weighted_pose, 1, 2) @ J, starts),
        poses=np.add.reduceat(np.swapaxes(weighted_pose, 1, 2) @ J_pose, starts),
        right=flat_weighted.T @ r.ravel(),
        pose_right=np.add.reduceat((np.swapaxes(weighted_pose, 1, 2) @ r[..., None])[..., 0], starts),
    )
