"""Position and rotation of a view; the relative pose of two views."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from harness.display import OneLine
from harness.geometry.angles import Array
from harness.spec import Finite, Spec, Vector3


class Pose(Spec):
    """A view in the world: right-handed, z up. The rotation is yaw about z, then pitch about y, then roll about x."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    """Position (x, y, z) of the viewpoint in the world, metres."""
    yaw_deg: Finite = 0.0
    """Rotation about z, degrees, counter-clockwise seen from above; applied last."""
    pitch_deg: Finite = 0.0
    """Rotation about y, degrees; positive turns x down."""
    roll_deg: Finite = 0.0
    """Rotation about x, degrees; applied first."""

    @property
    def R_world_from_view(self) -> Array:
        """Rotation matrix `[3, 3]` that turns a direction of the view's frame into the world's."""
        angles = [self.yaw_deg, self.pitch_deg, self.roll_deg]
        return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())


@dataclass(frozen=True, repr=False)
class Motion(OneLine):
    """The motion from view 1 to view 2: `p_v2 = R_v2_from_v1 @ (p_v1 - t_v1)`.

    The paper's eq. 1, `R p + t`, contradicts its own eqs. 2 and 5-8, which need t as the position of viewpoint 2 seen
    from viewpoint 1.
    """

    R_v2_from_v1: Array
    """`[3, 3]`."""
    t_v1: Array
    """`[3]`, metres: viewpoint 2 in v1's frame."""

    @property
    def baseline_m(self) -> float:
        """|t| in metres."""
        return float(np.linalg.norm(self.t_v1))

    def apply(self, p_v1: ArrayLike) -> Array:
        """Points `[..., 3]` of v1's frame in v2's (eq. 1, corrected)."""
        return (np.asarray(p_v1, dtype=np.float64) - self.t_v1) @ self.R_v2_from_v1.T


AT_REST = Motion(R_v2_from_v1=np.eye(3), t_v1=np.zeros(3))
"""The motion from a view to itself."""


def relative_motion(view_1: Pose, view_2: Pose) -> Motion:
    """The motion that takes view 1 to view 2."""
    R_1, R_2 = view_1.R_world_from_view, view_2.R_world_from_view
    # Views that are turned alike have no rotation between them, whichever way they look: not even a rounding.
    alike = np.array_equal(R_1, R_2)
    return Motion(
        R_v2_from_v1=np.eye(3) if alike else R_2.T @ R_1,
        t_v1=R_1.T @ np.subtract(view_2.position_m, view_1.position_m),
    )


def translated(view: Pose, offset_m: Vector3) -> Pose:
    """The same view moved by an offset in the world's frame, metres."""
    x, y, z = np.add(view.position_m, offset_m).tolist()
    return view.model_copy(update={"position_m": (x, y, z)})
