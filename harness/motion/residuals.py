"""Residuals of pairs of bearing vectors for a motion, and their derivatives."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.motion import _bearing_kernels as _kernels
from harness.motion.features import Correspondences

SLACK_PX = 3.0
"""Tolerance, pixels of both views together, of the test that a point is in front of the views: noise puts every second
far point behind one."""


class Turn(NamedTuple):
    """A motion up to scale: `p_v2 = R_v2_from_v1 (p_v1 - t_v1)` with |t_v1| = 1."""

    R: Array
    """`[3, 3]`, R_v2_from_v1."""
    t: Array
    """`[3]`, unit direction of t_v1."""


def sampson(pairs: Correspondences, turn: Turn) -> Array:
    """The signed Sampson distance `[n]` of each pair from the epipolar constraint, pixels.

    For pixels of standard deviation 1 in both views its standard deviation is 1, to first order.
    """
    return _distances(pairs, turn)[0]


def lies_before(pairs: Correspondences, turn: Turn) -> NDArray[np.bool_]:
    """Whether each pair's point lies in front of both views, within the tolerance `SLACK_PX` `[n]`."""
    return _distances(pairs, turn)[1] > -slack(pairs)


def slack(pairs: Correspondences) -> Array:
    """The angle `[n]`, radians, of `SLACK_PX` pixels in both views together."""
    squares = sum(np.sum(each**2, axis=(1, 2)) / 2 for each in (pairs.spreads_1, pairs.spreads_2))
    return np.asarray(SLACK_PX * np.sqrt(squares))


def sampson_jacobian(pairs: Correspondences, turn: Turn) -> tuple[Array, Array]:
    """The Sampson distances `[n]`, and their derivatives `[n, 6]` by a rotation omega and a change of t.

    The rotation becomes R exp([omega]×), so that y = R^T x_2 changes by y × omega.
    """
    R, t = turn
    x, y = pairs.x_1, pairs.x_2 @ R
    s_1, s_2 = pairs.spreads_1, np.einsum("ji,njk->nik", R, pairs.spreads_2)
    n, k = np.cross(t, x), np.cross(t, y)
    a, b = np.einsum("nik,ni->nk", s_1, k), np.einsum("nik,ni->nk", s_2, n)
    s = np.sqrt(np.sum(a * a + b * b, axis=1))
    c = np.sum(y * n, axis=1)
    # v · (y × omega) = (v × y) · omega
    c_omega = np.cross(n, y)
    c_t = np.cross(x, y)
    # s² = |S_1^T k|² + |S_2^T n|²; k = t × y moves with both, n with t, and S_2, given in view 1's orientation, as y.
    q_1, q_2 = np.einsum("nik,nk->ni", s_1, a), np.einsum("nik,nk->ni", s_2, b)
    s_omega = np.cross(np.cross(q_1, t), y) + np.cross(n, q_2)
    s_t = np.cross(y, q_1) + np.cross(x, q_2)
    e = c / s
    return e, np.hstack([c_omega - (e / s)[:, None] * s_omega, c_t - (e / s)[:, None] * s_t]) / s[:, None]


def rotation_distance(pairs: Correspondences, R: Array) -> Array:
    """The distance `[n]` of x_1 and x_2 after a pure rotation, in standard deviations of one axis, pixels.

    The length of the difference on the tangent plane, weighted by its inverse covariance, over sqrt(2) for two axes.
    """
    y = pairs.x_2 @ R
    s_2 = np.einsum("ji,njk->nik", R, pairs.spreads_2)
    covariance = pairs.spreads_1 @ pairs.spreads_1.transpose(0, 2, 1) + s_2 @ s_2.transpose(0, 2, 1)
    difference = y - pairs.x_1
    solved = np.einsum("nij,nj->ni", np.linalg.pinv(covariance, rcond=1e-6, hermitian=True), difference)
    return np.asarray(np.sqrt(np.sum(difference * solved, axis=1) / 2))


def _distances(pairs: Correspondences, turn: Turn) -> tuple[Array, Array]:
    distance, before = np.empty(len(pairs)), np.empty(len(pairs))
    _kernels.distances(*bearings_of(pairs), *turn, distance, before)
    return distance, before


def bearings_of(pairs: Correspondences) -> tuple[Array, Array, Array, Array]:
    """The kernels' arguments: bearings and spreads of both views, contiguous."""
    x_1, x_2, s_1, s_2 = (
        np.ascontiguousarray(each, dtype=np.float64)
        for each in (pairs.x_1, pairs.x_2, pairs.spreads_1, pairs.spreads_2)
    )
    return x_1, x_2, s_1, s_2
