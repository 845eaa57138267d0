"""The misalignment of a camera relative to its hyperboloid mirror: displacement and rotation.

The frame is the mirror's own (`harness.camera.models.hyperboloid`): x along u, y along v, z along the mirror's axis
from the camera to the mirror. Without misalignment the camera centre is at the outer focus F1 = (0, 0, -2e), looking
along z.
"""

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from harness.geometry.angles import Array
from harness.spec import Spec

Millimetres = Annotated[float, Field(ge=-1000, le=1000)]
Degrees = Annotated[float, Field(ge=-90, le=90)]


class Misalignment(Spec):
    """Displacement and rotation of a camera relative to its hyperboloid mirror; zero for a perfect sensor.

    Unless all six are zero, the rays of the sensor have no viewpoint in common.
    """

    x_mm: Millimetres = 0.0
    """Displacement of the camera centre from the mirror's outer focus along u, millimetres."""
    y_mm: Millimetres = 0.0
    """Displacement of the camera centre from the mirror's outer focus along v, millimetres."""
    z_mm: Millimetres = 0.0
    """Displacement of the camera centre from the mirror's outer focus along the mirror's axis, millimetres; positive
    towards the mirror."""
    rotation_x_deg: Degrees = 0.0
    """Rotation of the camera about x, degrees; positive turns its optical axis against y. Applied first."""
    rotation_y_deg: Degrees = 0.0
    """Rotation of the camera about y, degrees; positive turns its optical axis towards x."""
    rotation_z_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Rotation of the camera about the mirror's axis, degrees; applied last. As the mirror is rotationally symmetric,
    it only rotates the image."""

    @property
    def is_zero(self) -> bool:
        """Whether camera and mirror are aligned."""
        return not any(getattr(self, name) for name in Misalignment.model_fields)

    @property
    def offset_m(self) -> Array:
        """`[3]`: the camera centre minus the outer focus, in the mirror's frame, metres."""
        return np.array([self.x_mm, self.y_mm, self.z_mm]) / 1000

    @property
    def R_mirror_from_camera(self) -> Array:
        """`[3, 3]`, `R_z R_y R_x`: turns directions of the camera's frame, z along its axis, into the mirror's."""
        angles = [self.rotation_z_deg, self.rotation_y_deg, self.rotation_x_deg]
        return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())

    @property
    def rotation_axes(self) -> Array:
        """`[3, 3]`: the axes about which the camera rotates when the rotation about x, y or z changes by a small angle.

        In the mirror's frame, a row each: `R_z R_y e_x`, `R_z e_y`, `e_z`.
        """
        R_z = Rotation.from_euler("z", self.rotation_z_deg, degrees=True)
        R_y = Rotation.from_euler("y", self.rotation_y_deg, degrees=True)
        return np.stack([(R_z * R_y).apply([1.0, 0, 0]), R_z.apply([0, 1.0, 0]), np.array([0, 0, 1.0])])
