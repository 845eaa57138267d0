"""Poses of boards: a linear estimate from the bearing vectors of their corners, refined for a known camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from harness.calibration.corners import Corners
from harness.camera._projection_kernels import differentiate_all, project_all
from harness.display import OneLine
from harness.geometry.angles import Array


@dataclass(frozen=True, repr=False, eq=False)
class BoardPoses(OneLine):
    """`p = R (x, y, 0) + t` takes a point of the board into the sensor's frame.

    R is a rotation in every model. Images of a planar board do not determine whether the sensor mirrors it: instead, R
    and t turn the board over, with the same corners.
    """

    R: Array
    """`[n, 3, 3]`."""
    t: Array
    """`[n, 3]`, metres."""

    def of(self, chosen: Sequence[int]) -> "BoardPoses":
        """The poses of some of the boards, by index."""
        return BoardPoses(self.R[chosen], self.t[chosen])

    def in_frame(self, M: Array) -> "BoardPoses":
        """The same boards in another frame, `p' = M p`, M orthogonal; a reflection turns boards over."""
        hand = np.array([1.0, 1.0, np.sign(np.linalg.det(M))])
        return BoardPoses(M @ self.R * hand, self.t @ M.T)

    def apply(self, corners: Corners) -> tuple[Array, Array]:
        """Corners `[m, 3]` in the sensor's frame: rotated only, and rotated and translated."""
        turned = np.einsum("mij,mj->mi", self.R[corners.image, :, :2], corners.points_m)
        return turned, turned + self.t[corners.image]

    def moved(self, step: Array) -> "BoardPoses":
        """The poses after a small rotation (radians) and translation (metres) each, `[n, 6]`, in the sensor's frame.

        The rotation is about a board's own origin.
        """
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        return BoardPoses(turn @ self.R, self.t + step[:, 3:])


def poses_from_bearings(corners: Corners, bearings: Array) -> BoardPoses:
    """Poses of planar boards from the bearing vectors of their corners, by linear least squares.

    A bearing b and its corner (x, y) satisfy `b × (H (x, y, 1)) = 0` with `H = [r_1 r_2 t]` up to a factor, in any
    direction of the sphere. H is the singular vector of the smallest singular value, with the sign for which
    `b · H (x, y, 1) > 0`; R is the nearest rotation to `[r_1 r_2 r_1 × r_2]` (Zhang 2000, for bearings instead of a
    perspective image).

    Parameters
    ----------
    bearings
        `[m, 3]`, unit length. A corner whose bearing is NaN is ignored.

    Returns
    -------
    BoardPoses
        NaN for a board with fewer than 4 corners left.
    """
    count = len(corners.images)
    R, t = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan)
    ends = [*corners.starts.tolist(), len(corners.image)]
    for board in range(count):
        of_board = slice(ends[board], ends[board + 1])
        known = np.isfinite(bearings[of_board]).all(axis=-1)
        if known.sum() >= 4:
            R[board], t[board] = _pose(corners.points_m[of_board][known], bearings[of_board][known])
    return BoardPoses(R, t)


def _pose(points: Array, b: Array) -> tuple[Array, Array]:
    centre = points.mean(axis=0)
    scale = 1 / np.abs(points - centre).max()
    x = np.concatenate([(points - centre) * scale, np.ones((len(points), 1))], axis=1)
    zero = np.zeros_like(x)
    rows = np.concatenate(
        [
            np.concatenate([zero, -b[:, 2:] * x, b[:, 1:2] * x], axis=1),
            np.concatenate([b[:, 2:] * x, zero, -b[:, :1] * x], axis=1),
            np.concatenate([-b[:, 1:2] * x, b[:, :1] * x, zero], axis=1),
        ]
    )
    H = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    if np.sum(np.einsum("ij,ij->i", b, x @ H.T)) < 0:
        H = -H
    H = H * [scale, scale, 1.0]
    size = np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    H = H / max(size, 1e-300)
    left, _, right = np.linalg.svd(np.stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])], axis=1))
    R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return R, H[:, 2] - R[:, :2] @ centre


def turned_over(poses: BoardPoses, corners: Corners) -> BoardPoses:
    """The second solution for the pose of a small board: reflected in the plane normal to the line of sight.

    A small planar board has nearly the same image in both poses (Schweighofer and Pinz 2006).
    """
    _, p = poses.apply(corners)
    count = np.add.reduceat(np.ones(len(p)), corners.starts)[:, None]
    middle = np.add.reduceat(p, corners.starts) / count
    sight = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    mirror = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
    R = mirror @ poses.R * [1.0, 1.0, -1.0]
    point = (
        np.add.reduceat(corners.points_m, corners.starts) / np.add.reduceat(np.ones(len(p)), corners.starts)[:, None]
    )
    return BoardPoses(R, middle - np.einsum("nij,nj->ni", R[:, :, :2], point))


def pose_jacobian(camera: object, turned: Array, p: Array) -> Array:
    """Derivatives `[m, 2, 6]` of pixels by the step of `BoardPoses.moved`, pixels per radian and per metre.

    A small rotation w moves `p = a + t`, a = R (x, y, 0), by `w × a`, so that the pixel moves by
    `D (w × a) = (a × D) w` for each row of D, the derivative of the pixel by p.
    """
    D = np.empty((len(p), 2, 3))
    differentiate_all(np.ascontiguousarray(p), camera, D)
    return np.concatenate([np.cross(turned[:, None, :], D), D], axis=-1)


def residuals_of(camera: object, corners: Corners, poses: BoardPoses) -> Array:
    """Residuals `[m, 2]`, predicted minus measured, pixels; NaN outside the model's domain."""
    pixels = np.empty((len(corners.image), 2))
    project_all(np.ascontiguousarray(poses.apply(corners)[1]), camera, pixels)
    return pixels - corners.pixels


def refine_poses(camera: object, corners: Corners, poses: BoardPoses, *, rounds: int = 30) -> tuple[BoardPoses, Array]:
    """Poses that minimise each board's squared residuals for a known camera (Levenberg-Marquardt, board by board).

    Parameters
    ----------
    camera
        The argument of the compiled projections, `camera_of_points(sensor)`.

    Returns
    -------
    poses
        The pose of a board with corners outside the model's domain is unchanged.
    cost
        `[n]`, sums of squared residuals, square pixels; infinite for such a board.
    """
    starts = corners.starts
    cost = _costs(camera, corners, poses)
    damping = np.full(len(cost), 1e-3)
    for _ in range(rounds):
        turned, p = poses.apply(corners)
        J = pose_jacobian(camera, turned, p)
        r = residuals_of(camera, corners, poses)
        bad = ~np.isfinite(cost)[corners.image]
        J[bad], r[bad] = 0.0, 0.0
        normal = np.add.reduceat(np.einsum("mki,mkj->mij", J, J), starts)
        gradient = np.add.reduceat(np.einsum("mki,mk->mi", J, r), starts)
        diagonal = np.einsum("nii->ni", normal)
        normal[:, range(6), range(6)] = diagonal * (1 + damping[:, None]) + 1e-30 * (diagonal.max() + 1)
        tried = poses.moved(-np.linalg.solve(normal, gradient[..., None])[..., 0])
        new = _costs(camera, corners, tried)
        better = new < cost
        poses = BoardPoses(
            np.where(better[:, None, None], tried.R, poses.R), np.where(better[:, None], tried.t, poses.t)
        )
        gain = np.where(better, cost, 0.0) - np.where(better, new, 0.0)
        cost = np.where(better, new, cost)
        damping = np.where(better, damping * 0.2, damping * 10)
        if not (better & (gain > 1e-9 * cost + 1e-20)).any() and (damping > 1e-3).all():
            break
    return poses, cost


def _costs(camera: object, corners: Corners, poses: BoardPoses) -> Array:
    r = residuals_of(camera, corners, poses)
    with np.errstate(invalid="ignore"):
        cost = np.add.reduceat(np.einsum("mk,mk->m", r, r), corners.starts)
    return np.where(np.isfinite(cost), cost, np.inf)
